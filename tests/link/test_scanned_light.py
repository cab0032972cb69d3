"""Light behind long scans, whose bursts outlast a bit: scans, turns, response, and frames read through all of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.link import scan_response, scans
from heliograph.link.contract import LinkFrame
from heliograph.link.cyclic import CyclicReceiver
from heliograph.link.cyclic_scans import ScanSearch
from heliograph.link.frames import SEED11_BITS, bits_of, seed11_code

CODE = seed11_code()
SAFE = [p for p in range(64) if p not in CODE.twins and p not in CODE.periodic]


def scanned(
    bit_rate: float,
    scan_us: float,
    frames: int,
    seed: int,
    ppm: float = 0.0,
    tail: float = 0.8,
    payload: int | None = None,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], list[int], float]:
    """Return events of a light with a payload of its own in every frame (or one), the payloads, and a bit's length.

    Pixels follow a rise at once and a fall with a time constant of `tail` bits; a scan shows each pixel's change by
    whole thresholds since it was read last, as its sign.
    """
    rng = np.random.default_rng(seed)
    payloads = [int(p) for p in rng.choice(SAFE, frames)] if payload is None else frames * [payload]
    bits = np.array([bit for p in payloads for bit in bits_of(CODE.words[p], SEED11_BITS)])
    bit_us = 1e6 / (bit_rate * (1.0 + ppm * 1e-6))
    begin_us = 3000.0 + float(rng.uniform(0.0, bit_us))
    pixels = 40
    seen, reference = np.zeros(pixels), np.zeros(pixels)
    slow = tail * bit_us * rng.uniform(0.8, 1.25, pixels)
    t: list[int] = []
    on: list[bool] = []
    end_us = begin_us + len(bits) * bit_us
    for k in range(int(end_us / scan_us)):
        t_us = k * scan_us
        at = int((t_us - begin_us) // bit_us)
        lit = bool(0 <= at < len(bits) and bits[at])
        seen = np.full(pixels, 10.0) if lit else seen * np.exp(-scan_us / slow)
        steps = np.trunc(seen - reference)
        reference = reference + steps
        moved = steps[steps != 0.0]
        t += [int(t_us)] * len(moved)
        on += [bool(up) for up in moved > 0.0]
    return np.array(t, np.int64), np.array(on, np.bool_), payloads, bit_us


def read(
    t_us: npt.NDArray[np.int64], on: npt.NDArray[np.bool_], bit_rate: float, step_us: int = 5000
) -> tuple[list[LinkFrame], CyclicReceiver]:
    receiver = CyclicReceiver(CODE, bit_rate)
    out, start = [], 0
    end_us = int(t_us[-1]) + 8_000
    for until_us in (*range(step_us, end_us, step_us), end_us):
        stop = int(np.searchsorted(t_us, until_us))
        out += receiver.feed(t_us[start:stop], on[start:stop], until_us)
        start = stop
    out += receiver.flush()
    return [frame for frame in out if isinstance(frame, LinkFrame)], receiver


@pytest.mark.parametrize("ppm", [-80.0, 80.0])
@pytest.mark.parametrize(("bit_rate", "scan_us"), [(2000.0, 199.0), (2500.0, 199.0), (5000.0, 65.0)])
def test_frames_are_read_though_falls_last_longer_than_a_bit(bit_rate: float, scan_us: float, ppm: float) -> None:
    t_us, on, payloads, bit_us = scanned(bit_rate, scan_us, 120, 1, ppm)
    frames, receiver = read(t_us, on, bit_rate)
    ends = t_us[-1] - (np.arange(len(payloads))[::-1] * SEED11_BITS * bit_us)
    nearest = [int(np.argmin(np.abs(ends - frame.t_us))) for frame in frames]
    # The response is learned on the way; and behind the last frame the light goes dark, as after no other.
    later = {i: frame.payload for i, frame in zip(nearest, frames, strict=True) if 20 <= i < 119}
    right = sum(payloads[i] == payload for i, payload in later.items())
    assert right >= 95
    assert len(later) - right <= 1
    quality = receiver.quality(int(t_us[-1]))
    assert quality.clock_ppm == pytest.approx(ppm, abs=400.0)


@pytest.mark.parametrize("payload", [3, 13, 22, 42, 53])
@pytest.mark.parametrize("seed", [5, 6])
def test_a_word_that_repeats_is_read_at_all_phases_of_the_scans(payload: int, seed: int) -> None:
    t_us, on, _, _ = scanned(2500.0, 199.0, 160, seed, 40.0 - 20.0 * seed, payload=payload)
    frames, _ = read(t_us, on, 2500.0)
    later = [frame.payload for frame in frames if frame.t_us > 90_000]
    assert len(later) >= 140
    assert sum(told != payload for told in later) <= 1


@settings(max_examples=6, deadline=None)
@given(st.integers(700, 30_000), st.integers(0, 99))
def test_nothing_depends_on_how_the_input_is_cut(step_us: int, seed: int) -> None:
    t_us, on, _, _ = scanned(2500.0, 199.0, 50, seed)
    whole, _ = read(t_us, on, 2500.0, 40_000)
    cut, _ = read(t_us, on, 2500.0, step_us)
    assert cut == whole


def test_scans_are_found_and_continuous_time_is_none() -> None:
    rng = np.random.default_rng(1)
    on_grid = np.flatnonzero(rng.random(200) < 0.6).astype(np.float64) * 0.4
    assert scans.quantum(on_grid) == pytest.approx(0.4)
    assert scans.quantum(on_grid + rng.uniform(0.0, 0.003, len(on_grid))) == pytest.approx(0.4, abs=0.01)
    assert scans.quantum(np.cumsum(rng.exponential(0.4, 300))) == 0.0
    assert scans.quantum(np.cumsum(rng.integers(1, 5, 300).astype(np.float64))) == 0.0
    assert scans.quantum(on_grid[:10]) == 0.0


def test_silent_scans_lie_between_those_with_events() -> None:
    at = np.array([0.0, 0.4, 1.6, 2.0])
    counts = np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 3.0], [0.0, 4.0]])
    rows = scans.all_scans(at, counts, 0.4, 3.0)
    assert rows[:, 0] == pytest.approx([0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4])
    assert rows[:, 1].tolist() == [1, 2, 0, 0, 0, 0, 0]
    assert rows[:, 2].tolist() == [0, 0, 0, 0, 3, 4, 0]


def test_the_light_turns_where_its_burst_begins() -> None:
    # Three scans of OFF after one of ON, by hand; single events of the other sign are no turns.
    t = np.repeat([0.0, 0.4, 2.0, 2.4, 2.8, 3.2], [20, 1, 30, 30, 20, 25])
    on = np.repeat([True, False, False, False, False, True], [20, 1, 30, 30, 20, 25])
    found_t, found_on = np.empty(64), np.empty(64, np.bool_)
    n = scans.turns(t, on, np.zeros(scans.FIELDS), found_t, found_on)
    assert found_t[:n].tolist() == [0.0, 2.0, 3.2]
    assert found_on[:n].tolist() == [True, False, True]


def test_a_rate_that_was_seen_explains_better_than_one_that_might_be_anything() -> None:
    rng = np.random.default_rng(3)
    bits = np.tile([1, 1, 0, 1, 0], 60)  # without 00
    rows = []
    for slot in range(2, 298):
        c, d = bits[slot], bits[slot + 1]
        rows.append((slot, 8, rng.poisson(30.0) if (c, d) == (1, 0) else 0, rng.poisson(30.0) if c < d else 0))
    rate, weight = np.zeros((16, 2, 16)), np.zeros((16, 16))
    mean, shape, least, scale = np.zeros((16, 2, 16)), np.zeros((16, 2, 16)), np.zeros((16, 2, 16)), np.zeros((16, 16))
    scan_response.guess(bits, 2, np.array(rows, np.float64), rate, weight)
    burst = scan_response.tabulate(rate, weight, 0.5, mean, shape, least, scale)
    out = np.empty(16)
    for off, on, best in ((31.0, 0.0, {0b0110, 0b1010}), (0.0, 28.0, {0b1101, 0b0101})):
        scan_response.likelihoods(np.array([[8.0, off, on]]), 1, shape, least, scale, burst, out)
        assert int(np.argmax(out)) in best
        assert max(out[[0b0000, 0b1000, 0b0100, 0b1100]]) < out.max() - 0.5


def test_a_response_is_learned_by_four_bits_and_shorter_ones_stand_in() -> None:
    rng = np.random.default_rng(2)
    bits = rng.integers(0, 2, 400)
    # A scan at sub-bin 8 of each slot shows ON at a rise, 50 events where it was dark for two bits and 20 otherwise.
    rows = []
    for slot in range(2, 399):
        _, b, c, d = bits[slot - 2 : slot + 2]
        lit = 0.0 if (c, d) != (0, 1) else (50.0 if b == 0 else 20.0)
        rows.append((slot, 8, 0.0, lit))
    rate, weight = np.zeros((16, 2, 16)), np.zeros((16, 16))
    scan_response.guess(bits, 2, np.array(rows), rate, weight)
    assert rate[0b0001, 1, 8] == pytest.approx(50.0, rel=0.1)
    assert rate[0b0101, 1, 8] == pytest.approx(20.0, rel=0.15)
    assert rate[0b0000, 1, 8] < 3.0
    assert rate[:, 0].max() == 0.0


def test_what_lies_behind_the_end_of_a_stream_is_no_evidence_and_frames_that_end_there_are_not_told() -> None:
    told, wrong = 0, 0
    for seed in range(12, 18):
        bit_rate, scan_us = ((2000.0, 199.0), (2500.0, 199.0), (5000.0, 65.0))[seed % 3]
        t_us, on, payloads, bit_us = scanned(bit_rate, scan_us, 60, seed)
        ends = t_us[-1] - (np.arange(len(payloads))[::-1] * SEED11_BITS * bit_us)
        for cut_us in np.random.default_rng(seed).integers(t_us[-1] // 3, t_us[-1], 10).tolist():
            stop = int(np.searchsorted(t_us, cut_us))
            receiver = CyclicReceiver(CODE, bit_rate)
            receiver.feed(t_us[:stop], on[:stop], cut_us)
            for frame in receiver.flush():
                assert isinstance(frame, LinkFrame)
                assert frame.t_us < cut_us + 0.6 * bit_us
                told += 1
                wrong += payloads[int(np.argmin(np.abs(ends - frame.t_us)))] != frame.payload
    assert told > 30
    assert wrong <= 1  # as many as the scores of these frames expect


def test_the_nominal_rate_is_among_those_tried_though_a_window_has_an_odd_number_of_blocks() -> None:
    search = ScanSearch(500.0, SEED11_BITS)
    t = np.arange(0.0, 48.0, 0.5) + 0.01
    assert search.look((t * 500.0).astype(np.int64))
    for first in (0.0, 16.0, 32.0):
        mine = t[(t >= first) & (t < first + 16.0)] - first
        # An ON burst every other bit, an OFF burst between them.
        search.take(np.repeat(mine, 4), np.repeat((mine + first) % 4.0 < 2.0, 4))
    rates = search.peaks(3, 1.0)
    assert rates[0, 0] == 1.0
    assert search.peaks(3, 1e9)[0, 1] < 1e9


@pytest.mark.parametrize("percent", [-5.0, -1.0, 0.4, 1.0, 3.0, 5.0])
def test_a_clock_is_found_where_the_scans_mirror_it(percent: float) -> None:
    # 2.01 scans a bit: at +1 % a clock shows at the nominal rate as well, at +.5 % both are one.
    t_us, on, payloads, bit_us = scanned(2500.0, 199.0, 90, 4, percent * 1e4)
    frames, receiver = read(t_us, on, 2500.0)
    assert receiver.quality(int(t_us[-1])).clock_ppm == pytest.approx(percent * 1e4, abs=500.0)
    ends = t_us[-1] - (np.arange(len(payloads))[::-1] * SEED11_BITS * bit_us)
    right = sum(payloads[int(np.argmin(np.abs(ends - frame.t_us)))] == frame.payload for frame in frames)
    assert right >= 70


@pytest.mark.parametrize(("bit_rate", "image_us", "within_bits"), [(50.0, 10_000.0, 60), (80.0, 5000.0, 100)])
def test_behind_images_new_payloads_are_published_after_so_many_bits_not_after_hundreds(
    bit_rate: float, image_us: float, within_bits: int
) -> None:
    t_us, on, payloads, bit_us = scanned(bit_rate, image_us, 30, 3, tail=0.05)
    receiver = CyclicReceiver(CODE, bit_rate)
    published: list[tuple[int, LinkFrame]] = []
    for until_us in range(10_000, int(t_us[-1]), 10_000):
        here = slice(*np.searchsorted(t_us, [until_us - 10_000, until_us]))
        published += [(until_us, f) for f in receiver.feed(t_us[here], on[here], until_us) if isinstance(f, LinkFrame)]
    assert published[0][0] - t_us[0] <= (within_bits + 16) * bit_us
    ends = t_us[-1] - (np.arange(len(payloads))[::-1] * SEED11_BITS * bit_us)
    right = [f for _, f in published if payloads[int(np.argmin(np.abs(ends - f.t_us)))] == f.payload]
    assert len(right) >= 26
    assert len(published) - len(right) <= 1


@pytest.mark.parametrize("percent", [-3.0, 3.0])
def test_behind_images_a_clock_that_is_off_is_read_once_enough_was_seen(percent: float) -> None:
    t_us, on, payloads, bit_us = scanned(50.0, 10_000.0, 60, 2, percent * 1e4, tail=0.05)
    frames, receiver = read(t_us, on, 50.0, 20_000)
    assert receiver.quality(int(t_us[-1])).clock_ppm == pytest.approx(percent * 1e4, abs=1000.0)
    ends = t_us[-1] - (np.arange(len(payloads))[::-1] * SEED11_BITS * bit_us)
    got = {int(np.argmin(np.abs(ends - frame.t_us))): frame.payload for frame in frames}
    assert sum(payloads[i] == payload for i, payload in got.items() if i >= 30) >= 25


@given(
    step_us=st.integers(2_000, 400_000),
    seed=st.integers(0, 20),
    percent=st.sampled_from([0.0, 0.4, -1.0]),
    bit_rate=st.sampled_from([50.0, 40.0]),
)
@settings(max_examples=15, deadline=None)
def test_an_early_lock_does_not_depend_on_how_the_input_is_cut(
    step_us: int, seed: int, percent: float, bit_rate: float
) -> None:
    t_us, on, _, _ = scanned(bit_rate, 10_000.0, 40, seed, percent * 1e4, tail=0.05)
    assert read(t_us, on, bit_rate, step_us)[0] == read(t_us, on, bit_rate, 10_000)[0]


def test_the_length_of_a_scan_is_told_though_each_begins_a_little_late() -> None:
    rng = np.random.default_rng(1)
    taken = rng.random(128) < 0.5
    at = (np.arange(128)[taken] + rng.uniform(0.0, 0.08, int(taken.sum()))) * 0.5
    assert scans.quantum(at) == pytest.approx(0.5, abs=1e-3)


def right_of(frames: list[LinkFrame], t_us: npt.NDArray[np.int64], payloads: list[int], bit_us: float) -> int:
    """Return how many frames hold the payload that was sent where they end."""
    ends = t_us[-1] - (np.arange(len(payloads))[::-1] * SEED11_BITS * bit_us)
    return sum(payloads[int(np.argmin(np.abs(ends - frame.t_us)))] == frame.payload for frame in frames)


@pytest.mark.parametrize(("tail", "seed"), [(0.05, 5), (0.05, 8), (0.15, 1), (0.15, 4), (0.15, 9), (0.3, 1)])
def test_clean_light_that_shows_in_every_second_scan_is_read_through_its_slips(tail: float, seed: int) -> None:
    # 199.2 us are .498 bit: edges keep to every second scan for 125 bits, and then slip by one.
    t_us, on, payloads, bit_us = scanned(2500.0, 199.2, 160, seed, tail=tail)
    frames, receiver = read(t_us, on, 2500.0)
    right = right_of(frames, t_us, payloads, bit_us)
    assert right >= 130
    assert len(frames) - right <= 3
    assert receiver.quality(int(t_us[-1])).clock_ppm == pytest.approx(0.0, abs=400.0)


@pytest.mark.parametrize(
    ("scan_us", "tail", "seed"), [(199.4, 0.13, 8), (199.4, 0.15, 20), (199.3, 0.17, 1), (199.5, 0.13, 7)]
)
def test_a_clock_found_anew_is_judged_by_frames_that_an_early_lock_has_published(
    scan_us: float, tail: float, seed: int
) -> None:
    # Judged by the scans alone, the image of the rate begins, and 82 to 117 frames are read.
    t_us, on, payloads, bit_us = scanned(2500.0, scan_us, 160, seed, tail=tail)
    frames, receiver = read(t_us, on, 2500.0)
    assert right_of(frames, t_us, payloads, bit_us) >= 150
    assert receiver.quality(int(t_us[-1])).clock_ppm == pytest.approx(0.0, abs=100.0)


def test_rare_scans_are_found_in_a_long_window_only_where_nothing_contradicts_them() -> None:
    rng = np.random.default_rng(2)
    at = 0.996 * np.cumsum(rng.integers(1, 4, 120).astype(np.float64))
    assert scans.quantum(at, rare=True) == 0.0
    slipped = at + 0.498 * (np.arange(120) >= 40) + 0.498 * (np.arange(120) >= 90)
    assert scans.quantum(slipped) == 0.0
    assert scans.quantum(slipped, rare=True) == pytest.approx(0.498)
    assert scans.quantum(np.sort(np.append(slipped, rng.uniform(0.0, at[-1], 40))), rare=True) == 0.0


@pytest.mark.parametrize("payload", [5, 13, 42])
def test_a_word_that_repeats_is_read_though_a_line_of_it_lies_beside_the_bit_rate(payload: int) -> None:
    # 1.434 scans a bit: of a word of 11 bits, a line lies at 1.434 - 5 / 11 = .98 of the bit rate.
    t_us, on, _, _ = scanned(3500.0, 199.2, 300, 3, payload=payload)
    frames, _ = read(t_us, on, 3500.0)
    assert sum(frame.payload == payload for frame in frames) >= 200
    assert sum(frame.payload != payload for frame in frames) <= 3


def bursts(seed: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], float, int]:
    """Return events of a lamp in scans, with long pauses, a bit rate that it does not have, and a step for feeding."""
    rng = np.random.default_rng(seed)
    scan_us = float(rng.choice([65.0, 199.0, 199.2, 500.0, 5000.0, 10000.0, 20000.0]))
    bit_rate = float(rng.choice([0.3, 0.4, 0.5, 0.55, 0.7])) / scan_us * 1e6
    k = int(rng.integers(20, 600))
    kind = rng.integers(3)
    if kind == 0:
        gaps = rng.geometric(rng.uniform(0.1, 0.7), k)
    elif kind == 1:
        gaps = rng.choice([1, 2, 3, 4, 5, 6], k)
    else:
        gaps = 2 * rng.geometric(0.5, k) + (rng.random(k) < 0.03)
    pauses = rng.random(k) < rng.choice([0.0, 0.02, 0.1])
    at = np.cumsum(gaps + pauses * rng.integers(50, 2000, k)) * scan_us
    events = rng.integers(1, 30, k)
    on = rng.random(k) < 0.5 if rng.random() < 0.5 else np.arange(k) % 2 == 0
    return np.repeat(at, events).astype(np.int64), np.repeat(on, events), bit_rate, 50_000


@pytest.mark.parametrize("seed", [*range(8), 161])
def test_a_lock_that_is_lost_again_and_again_is_not_looked_for_at_one_place_for_ever(seed: int) -> None:
    t_us, on, bit_rate, step_us = bursts(seed)
    frames, _ = read(t_us, on, bit_rate, step_us)
    assert len(frames) <= (t_us[-1] - t_us[0]) * bit_rate / 1e6 / SEED11_BITS + 1.0
