"""Light that repeats itself is believed only where the edges of its word keep one phase."""

from __future__ import annotations

from math import exp, log

import numpy as np
import pytest

from heliograph.errors import Refusal
from heliograph.link.codebook import load
from heliograph.link.contract import edges_of
from heliograph.link.cyclic import CyclicReceiver
from heliograph.link.frames import CyclicCode, bits_of, cyclic_runs, seed11_code
from heliograph.link.one_phase import ENOUGH, SPREAD, needed, needed_of, read_out, tube

CODES = {"seed11": seed11_code(), "code": load("code20d4").code()}
FRAMES = 30


def told(
    code: CyclicCode,
    payload: int,
    off_bits: np.ndarray,
    rate: float = 1000.0,
    scan_us: int = 1,
    latency_us: float = 30.0,
) -> tuple[int | None, int, int]:
    """Return what is told of a light that repeats a word with each edge so far off the grid, frames, and OFF_GRID."""
    word = bits_of(code.words[payload], code.bits)
    bit_us = 1e6 / rate
    at, on = edges_of(word * (FRAMES + 1), 0.0, bit_us)
    whole = len(off_bits)
    index = np.arange(len(at)) % whole
    at = at + off_bits[index] * bit_us + 2000.0
    rng = np.random.default_rng(0)
    t = np.repeat(at, 8) + 30.0 * (1.0 + rng.exponential(1.0, 8 * len(at)))
    t = np.ceil(t / scan_us) * scan_us
    order = np.argsort(t, kind="stable")
    receiver = CyclicReceiver(code, rate)
    frames = receiver.feed(t[order].astype(np.int64), np.repeat(on, 8)[order], int(t.max()) + 1)
    frames += receiver.flush()
    identity = receiver.identity()
    return None if identity is None else identity.payload, len(frames), receiver.refusals[Refusal.OFF_GRID]


def edges(code: CyclicCode, payload: int) -> int:
    return len(cyclic_runs(code.words[payload], code.bits))


@pytest.mark.parametrize(("name", "payload"), [("seed11", 42), ("seed11", 11), ("code", 26), ("code", 300)])
def test_a_beacon_keeps_one_phase_and_is_told(name: str, payload: int) -> None:
    code = CODES[name]
    off_bits = np.zeros(edges(code, payload))
    for scan_us in (1, 65, 199):
        identity, _, held_back = told(code, payload, off_bits, scan_us=scan_us)
        assert identity == payload
        assert held_back == 0


@pytest.mark.parametrize(("name", "payload"), [("seed11", 42), ("seed11", 11), ("code", 26), ("code", 300)])
def test_the_same_frames_of_a_light_with_edges_anywhere_are_read_but_not_told(name: str, payload: int) -> None:
    code = CODES[name]
    seen = 0
    for seed in range(6):
        off_bits = np.random.default_rng(seed).uniform(-0.3, 0.3, edges(code, payload))
        identity, frames, held_back = told(code, payload, off_bits)
        assert identity is None
        seen += frames > 0 and held_back > 0
    assert seen >= 3


def test_behind_scans_as_long_as_a_bit_nothing_tells_a_beacon_from_what_repeats_itself() -> None:
    identity, frames, held_back = told(CODES["code"], 300, np.zeros(edges(CODES["code"], 300)), 5000.0, 199)
    assert frames > 0
    assert identity is None
    assert held_back > 0


@pytest.mark.parametrize("rises", [2, 3])
def test_the_tube_holds_the_share_of_lights_that_it_claims(rises: int) -> None:
    n, rho = 400_000, 0.2
    rng = np.random.default_rng(rises)
    off = rng.random((n, 2, rises)) - 0.5
    # What is left about the nearest of all planes of two delays: a delay may lie anywhere, and edges are cyclic.
    least = np.zeros(n)
    for p in range(2):
        ordered = np.sort(off[:, p], axis=1)
        best = np.full(n, np.inf)
        for cut in range(rises):
            turned = np.concatenate([ordered[:, cut:], ordered[:, :cut] + 1.0], axis=1)
            best = np.minimum(best, turned.var(axis=1) * rises)
        least += best
    share = float((least <= rho * rho).mean())
    assert share == pytest.approx(exp(-tube(rises, rises, 2 * rises - 2, rho)), rel=0.05)


def test_what_is_asked_is_the_spread_a_degree_of_freedom_or_enough() -> None:
    asked = {edges(code, w): needed(word, code.bits) for code in CODES.values() for w, word in enumerate(code.words)}
    assert 0.0 < asked[2] < 1e-3
    assert asked[4] == pytest.approx(-log(2.0 * np.pi * 2.0 * SPREAD**2))
    assert asked[4] < asked[6] < asked[8] < asked[10] < asked[12] == asked[14] == -log(ENOUGH)
    assert needed_of(CODES["code"]) is needed_of(load("code20d4").code())


@pytest.mark.parametrize("scan", [0.2, 0.5, 0.995, 1.99])
def test_scans_of_any_length_are_seen_in_the_times(scan: float) -> None:
    rng = np.random.default_rng(3)
    t = np.sort(np.ceil(rng.uniform(0.0, 200.0 * scan, 2000) / scan) * scan)
    assert read_out(t) == pytest.approx(scan, rel=0.01)
    assert read_out(np.sort(rng.uniform(0.0, 200.0, 2000))) == 0.0


def test_the_edges_of_a_sharp_slow_light_and_of_images_in_step_are_no_scans_of_a_bit() -> None:
    rng = np.random.default_rng(3)
    edges = np.flatnonzero(rng.random(200) < 0.5)
    assert read_out(np.sort((edges[:, None] + rng.uniform(0.0, 0.005, (len(edges), 20))).ravel())) == 0.0
    assert read_out(np.repeat(edges.astype(float), 20)) == 0.0
    assert read_out(np.repeat(0.99 * edges, 20)) == pytest.approx(0.99)
