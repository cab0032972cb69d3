"""A lit LED that moves: its own motion drowns its edges, and is what it is read by."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.events import Flags, Times
from heliograph.link import level
from heliograph.link.clock import BLOCK_BITS, SUB
from heliograph.link.contract import LinkFrame
from heliograph.link.frames import seed11_code
from heliograph.link.modulations import modulation

BIT_US = 20_000
# As a beacon of 2 px radius at 210 px/s shows it: events a bit while lit, of a rise, of a fall, of darkness.
LIT, RISE, FALL, DARK = 80.0, 10.0, 7.0, 0.5


def words(seed: int, frames: int) -> tuple[list[int], list[int]]:
    """Return random payloads that no lamp imitates, and their bits."""
    kind = modulation("seed11")
    code = seed11_code()
    safe = [p for p in range(64) if p not in code.twins and p not in code.periodic]
    payloads = np.random.default_rng(seed).choice(safe, frames).tolist()
    return payloads, [int(bit) for payload in payloads for bit in kind.encode(payload)]


def moving(bits: list[int], seed: int, lit: float = LIT) -> tuple[Times, Flags]:
    """Return the events of a light that moves: ON and OFF at random while lit, bursts where it changes."""
    rng = np.random.default_rng(seed + 1)
    t: list[np.ndarray] = []
    on: list[np.ndarray] = []

    def add(t0_us: float, span_us: float, mean: float, share_on: float) -> None:
        n = rng.poisson(mean)
        t.append(t0_us + rng.uniform(0.0, span_us, n))
        on.append(rng.uniform(size=n) < share_on)

    before = 0
    for i, bit in enumerate(bits):
        t0_us = (i + 1) * BIT_US
        add(t0_us, BIT_US, lit if bit else DARK, 0.6)
        if bit != before:
            add(t0_us, 1_500.0, RISE if bit else FALL, float(bit))
        before = bit
    times = np.concatenate(t)
    order = np.argsort(times, kind="stable")
    return times[order].astype(np.int64), np.concatenate(on)[order]


def read(t_us: Times, on: Flags, until_us: int, step_us: int) -> list[LinkFrame]:
    """Return the frames of the default receiver, fed in windows."""
    receiver = modulation("seed11").receiver(1e6 / BIT_US)
    out: list[LinkFrame] = []
    for begin_us in range(0, until_us, step_us):
        first, last = np.searchsorted(t_us, [begin_us, begin_us + step_us])
        out += [one for one in receiver.feed(t_us[first:last], on[first:last], begin_us + step_us)
                if isinstance(one, LinkFrame)]  # fmt: skip
    return out


@pytest.mark.parametrize("lit", [20.0, 80.0, 400.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_light_that_moves_is_read_by_its_level(lit: float, seed: int) -> None:
    payloads, bits = words(seed, 40)
    t_us, on = moving(bits, seed, lit)
    frames = read(t_us, on, (len(bits) + 4) * BIT_US, 10_000)
    sent = {round((11 * (i + 1) + 1) * BIT_US, -4): payload for i, payload in enumerate(payloads)}
    right = [frame for frame in frames if sent.get(round(frame.t_us, -4)) == frame.payload]
    assert len(frames) - len(right) == 0
    # The clock takes its window of 64 bits, and it may be found in a later one: three frames at most.
    assert len(right) >= 37


def test_a_level_is_read_alike_however_the_events_are_cut() -> None:
    _, bits = words(3, 12)
    t_us, on = moving(bits, 3)
    until_us = (len(bits) + 4) * BIT_US
    assert read(t_us, on, until_us, 1_000) == read(t_us, on, until_us, until_us)


def test_an_edge_of_the_level_lies_where_the_events_begin_and_end() -> None:
    lit = np.sort(np.random.default_rng(0).uniform(3.0, 6.0, 300))
    found_t, found_on = np.zeros(4 * BLOCK_BITS), np.zeros(4 * BLOCK_BITS, np.bool_)
    n = level.edges(lit, found_t, found_on)
    assert found_on[:n].tolist() == [True, False]
    np.testing.assert_allclose(found_t[:n], [3.0, 6.0], atol=1.5 / SUB)


@pytest.mark.parametrize("spread", [0.1, 0.9])
def test_the_bursts_of_a_light_that_stands_still_are_no_level(spread: float) -> None:
    rng = np.random.default_rng(5)
    bits = np.array(words(5, 6)[1])
    edges = np.flatnonzero(np.diff(bits)) + 1
    t = np.concatenate([edge + rng.uniform(0.0, spread, 30) for edge in edges])
    on = np.repeat(bits[edges] > 0, 30)
    order = np.argsort(t)
    found = np.array([0.0, 1.0, 0.0, 66.0])
    model, seen = np.zeros((4, 2, SUB)), np.zeros(4, np.int64)
    assert not level.start(t[order], on[order], 66.0, found, model, seen)


def test_on_a_grid_that_is_off_by_half_a_bit_bursts_in_the_middle_are_no_level() -> None:
    # A light that stands still, with ON events all the time: bits with a burst in their middle look lit, and what then
    # counts as a fall begins with a rise's burst.
    rng = np.random.default_rng(1)
    bits = np.array([int(bit) for bit in modulation("seed11").encode(42)] * 6)
    edges = np.flatnonzero(np.diff(bits)) + 1
    bursts = [edge + rng.exponential(0.1, rng.poisson(60)) for edge in edges]
    t = np.concatenate([rng.uniform(0.0, 66.0, 66 * 20), *bursts])
    on = np.concatenate([np.ones(66 * 20), *(np.full(len(one), bits[k]) for one, k in zip(bursts, edges, strict=True))])
    order = np.argsort(t)
    t, on = t[order], on[order] > 0
    inside = (t > 0.5) & (t < 64.0)
    found = np.array([0.5, 1.0, 0.0, 64.0])
    assert not level.start(t[inside], on[inside], 64.0, found, np.zeros((4, 2, SUB)), np.zeros(4, np.int64))
