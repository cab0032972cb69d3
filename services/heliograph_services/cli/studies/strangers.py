"""Lights that send our protocols, seen by an asynchronous sensor, and lights that are nobody to a receiver.

For tests and for trials of false identities: noise, lamps, blinkers of random bits, random telegraphs, and the other
protocols at the receiver's own bit rate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link.contract import Bits, edges_of
from heliograph.link.modulations import TEXT, modulation
from heliograph.units import bit_us
from heliograph_services.cli.studies.asynchronous import AsyncPixels, events

SENTENCE = "The quick brown fox jumps over the lazy dog; 0123456789! "


def sent(
    bits: Iterable[int], bit_rate: float, light: AsyncPixels, seed: int, *, ppm: float = 0.0, start_us: float = 100.0
) -> tuple[Times, Flags]:
    """Return the events of a light that sends the bits."""
    at_us, levels = edges_of(bits, start_us, bit_us(bit_rate) / (1.0 + ppm * 1e-6))
    return events(at_us, levels, light, np.random.default_rng(seed))


def square(frequency_hz: float, seconds_s: float, duty: float = 0.5) -> tuple[npt.NDArray[np.float64], Flags]:
    """Return the edges of a lamp that is switched so often."""
    period_us = 1e6 / frequency_hz
    k = np.arange(int(seconds_s * frequency_hz))
    at_us = np.stack([k * period_us, (k + duty) * period_us], axis=1).ravel() + 10.0
    return at_us, np.tile(np.array([True, False]), len(k))


def nobody(bit_rate: float, seconds_s: float, seed: int) -> Iterator[tuple[str, Times, Flags]]:
    """Yield lights that are nobody: noise, lamps, blinkers of random bits at the right rate, random telegraphs."""
    rng = np.random.default_rng(seed)
    light = AsyncPixels(pixels=20, jitter_us=min(5.0, 5e4 / bit_rate), noise_hz=1e3)
    n = int(seconds_s * bit_rate)
    for noise_hz in (1e3, 1e5):
        yield f"noise {noise_hz:g}", *events(np.empty(0), np.empty(0, np.bool_), AsyncPixels(noise_hz=noise_hz), rng,
                                             seconds_s * 1e6)  # fmt: skip
    for divisor in (2.0, 3.0, 4.0, 5.0, 2.3, 11.0):
        yield f"lamp of bit rate / {divisor:g}", *events(*square(bit_rate / divisor, seconds_s), light, rng)
    for density in (0.5, 0.3):
        bits = (rng.random(n) < density).astype(int)
        yield f"random bits {density}", *events(*edges_of(bits, 0.0, bit_us(bit_rate)), light, rng)
    gaps = 1.0 + np.floor(rng.exponential(2.0 * bit_us(bit_rate), n // 2))
    yield "telegraph", *events(np.cumsum(gaps), np.arange(len(gaps)) % 2 == 0, light, rng)


def words(name: str) -> Iterator[tuple[str, Bits]]:
    """Yield some words that each protocol sends; texts whole."""
    kind = modulation(name)
    if name in TEXT:
        yield name, tuple(bit for character in SENTENCE for bit in kind.encode(character))
        return
    for payload in (1, 5, 42, 77, 100, 170, 255, 8200):
        try:
            yield f"{name} {payload}", kind.encode(payload)
        except ValueError:
            continue


def others(but: str, names: Iterable[str], bit_rate: float, seconds_s: float, seed: int) -> Iterator[
    tuple[str, Times, Flags]
]:  # fmt: skip
    """Yield lights that send other protocols at the same bit rate."""
    light = AsyncPixels(pixels=20, jitter_us=min(5.0, 5e4 / bit_rate))
    for name in names:
        if name == but:
            continue
        for label, bits in words(name):
            times = int(seconds_s * bit_rate) // len(bits) + 1
            yield label, *sent(bits * times, bit_rate, light, seed)
