"""Lights that are no beacons, at the level of one track's events: fresh parameters for each, drawn from its seed.

The kinds are those of the scenario `clutter`, in its proportions (LIGHTS: 32 a camera), and what a room has besides::

    bits       10  random bits on a clock: half of them at the listener's own rate (+-1 %), half at 50 to 5000 bit/s;
                   lit with a probability of .3, .5 or .7
    telegraph   5  on and off for exponential times, means of .3 ms to .1 s
    lamp        3  100 or 120 Hz, sinusoidal, depth .2 to .9; its rises and falls spread over the period
    pwm         7  mains (100, 120), 240, or 200 Hz to 20 kHz; a tenth to nine tenths lit
    glint       3  flashes of .2 to 5 ms, 5 to 300 a second
    edge        2  moving edges and textured crossings: bursts of ON, then OFF events over 1 to 30 ms
    monitor     1  50 to 240 images a second, each a random step of light, behind a back light of PWM
    noise       1  100 to 1e5 events a second

How it is seen: a change makes Poisson(k) events, k log-uniform in 1.5 to 20; late by 20 to 80 us (OFF 0 to 60 more),
with an exponential tail of 10 to 80 us; 1 to 1000 events a second of noise; half of the sensors are read out in scans
of 65 or 199 us. Not here, but in the scenario: refractory time, bandwidth, the shape of an image, motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.events import Flags, Times
from heliograph.link.contract import edges_of
from heliograph.link.modulations import TEXT, modulation

Floats = npt.NDArray[np.float64]
Edges = tuple[Floats, Flags]

LIGHTS: Final = {"bits": 10, "telegraph": 5, "lamp": 3, "pwm": 7, "glint": 3, "edge": 2, "monitor": 1, "noise": 1}
CAMERA: Final = sum(LIGHTS.values())
# Events a second at most, so that hours can be run: a tenth of what one region under glare yields.
EVENTS_MOST: Final = 50_000.0


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The events of a light, and what it was."""

    label: str
    t_us: Times
    on: Flags
    until_us: int


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def light(kind: str, rate: float, seconds: float, rng: np.random.Generator) -> Seen:
    """Return a light of a kind, with parameters of its own, heard for so many seconds at a bit rate."""
    label, edges = _MAKERS[kind](rate, seconds * 1e6, rng)
    return watched(label, edges, seconds, rng, log_uniform(rng, 100.0, 1e5) if kind == "noise" else None)


def watched(label: str, edges: Edges, seconds: float, rng: np.random.Generator, noise_hz: float | None = None) -> Seen:
    """Return the events of a light that changes at these times."""
    at_us, levels = edges
    until_us = int(seconds * 1e6)
    inside = at_us < until_us
    at_us, levels = at_us[inside], levels[inside]
    k = log_uniform(rng, 1.5, 20.0)
    k = min(k, EVENTS_MOST * seconds / max(len(at_us), 1))
    many = rng.poisson(k, len(at_us))
    on = np.repeat(levels, many)
    late = rng.uniform(20.0, 80.0) + np.where(on, 0.0, rng.uniform(0.0, 60.0))
    t = np.repeat(at_us, many) + late + rng.exponential(rng.uniform(10.0, 80.0), len(on))
    stray = rng.poisson((noise_hz or log_uniform(rng, 1.0, 1e3)) * seconds)
    t = np.concatenate([t, rng.uniform(0.0, until_us, stray)])
    on = np.concatenate([on, rng.random(stray) < 0.5])
    scan_us = float(rng.choice([1.0, 1.0, 65.0, 199.0]))
    t = np.ceil(t / scan_us) * scan_us
    order = np.argsort(t, kind="stable")
    times = t[order].astype(np.int64)
    kept = times < until_us
    return Seen(label, times[kept], on[order][kept], until_us)


def _bits(rate: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    own = rng.random() < 0.5
    clock = rate * rng.uniform(0.99, 1.01) if own else log_uniform(rng, 50.0, 5000.0)
    lit = float(rng.choice([0.3, 0.5, 0.5, 0.7]))
    bits = (rng.random(int(until_us * 1e-6 * clock) + 1) < lit).astype(np.int64)
    where = "the listener's rate" if own else f"{clock:.0f} bit/s"
    return f"bits at {where}", edges_of(bits, float(rng.uniform(0.0, 1e6 / clock)), 1e6 / clock)


def _switched(lit_us: Floats, dark_us: Floats) -> Edges:
    """Return the edges of a light that is lit and dark in turn."""
    at = np.cumsum(np.stack([dark_us, lit_us], axis=1).ravel())
    return at, np.tile(np.array([True, False]), len(lit_us))


def _telegraph(_: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    lit_us, dark_us = log_uniform(rng, 300.0, 1e5), log_uniform(rng, 300.0, 1e5)
    n = int(1.5 * until_us / (lit_us + dark_us)) + 20
    label = f"telegraph {lit_us / 1e3:.1f} / {dark_us / 1e3:.1f} ms"
    return label, _switched(rng.exponential(lit_us, n), rng.exponential(dark_us, n))


def _lamp(_: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    hz, depth = float(rng.choice([100.0, 120.0])) * rng.uniform(0.999, 1.001), float(rng.uniform(0.2, 0.9))
    # A change of light of a threshold of .2 each: rises between the minimum and the maximum, falls behind it.
    steps = max(int(np.log((1.0 + depth) / (1.0 - depth)) / 0.2), 1)
    levels = (1.0 - depth) * np.exp(0.2 * (np.arange(steps) + rng.random()))
    sine = np.clip((levels - 1.0) / depth, -1.0, 1.0)
    rising = np.arcsin(sine) / (2.0 * np.pi) / hz * 1e6
    offsets = np.concatenate([rising, 0.5e6 / hz - rising[::-1]])
    periods = np.arange(int(until_us * 1e-6 * hz) + 2)[:, None] / hz * 1e6
    on = np.tile(np.repeat([True, False], steps), len(periods))
    at = (periods + offsets + rng.uniform(0.0, 1e6 / hz)).ravel()
    kept = at >= 0.0
    return f"lamp {hz:.0f} Hz", (at[kept], on[kept])


def _pwm(_: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    hz = float(rng.choice([100.0, 120.0, 240.0, *[log_uniform(rng, 200.0, 20_000.0) for _ in range(3)]]))
    duty = float(rng.uniform(0.1, 0.9))
    n = int(until_us * 1e-6 * hz) + 2
    label = f"pwm {hz:.0f} Hz, {duty:.2f} lit"
    return label, _switched(np.full(n, duty / hz * 1e6), np.full(n, (1.0 - duty) / hz * 1e6))


def _glint(_: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    hz, lit_us = log_uniform(rng, 5.0, 300.0), log_uniform(rng, 200.0, 5_000.0)
    n = int(1.5 * until_us * 1e-6 * hz) + 20
    return f"glint {hz:.0f} Hz", _switched(rng.exponential(lit_us, n), rng.exponential(1e6 / hz, n))


def _edge(_: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    wide_us = log_uniform(rng, 1e3, 3e4)
    n = int(until_us / (10.0 * wide_us)) + 1
    times = [
        np.sort(at + rng.normal(0.0, wide_us / 2.0, int(rng.integers(5, 40))))
        for at in np.sort(rng.uniform(0.0, until_us, 2 * n))
    ]
    levels = [np.full(len(part), i % 2 == 0) for i, part in enumerate(times)]
    at = np.concatenate(times)
    order = np.argsort(at, kind="stable")
    kept = at[order] >= 0.0
    return f"edge {wide_us / 1e3:.0f} ms", (at[order][kept], np.concatenate(levels)[order][kept])


def _monitor(_: float, until_us: float, rng: np.random.Generator) -> tuple[str, Edges]:
    hz = float(rng.choice([50.0, 60.0, 72.0, 75.0, 100.0, 120.0, 144.0, 240.0]))
    n = int(until_us * 1e-6 * hz) + 1
    images = np.arange(n) / hz * 1e6
    back_hz = hz * float(rng.choice([1.0, 2.0, 4.0])) if rng.random() < 0.5 else log_uniform(rng, 200.0, 2e3)
    back, on = _switched(*(np.full(int(until_us * 1e-6 * back_hz) + 1, 0.5e6 / back_hz) for _ in range(2)))
    at, levels = np.concatenate([images, back]), np.concatenate([rng.random(n) < 0.5, on])
    order = np.argsort(at, kind="stable")
    return f"monitor {hz:.0f} Hz, {back_hz:.0f} Hz", (at[order], levels[order])


def _noise(_: float, __: float, ___: np.random.Generator) -> tuple[str, Edges]:
    return "noise", (np.empty(0), np.empty(0, np.bool_))


def beacon(protocol: str, rate: float, seconds: float, rng: np.random.Generator) -> tuple[str, Edges]:
    """Return the edges of a beacon with a random payload, or random text.

    Raises:
        ValueError: the protocol has no such bit rate.
    """
    kind = modulation(protocol)
    if protocol == "frequency":
        payload = round(rate / 2.0)
        bits = kind.encode(payload) * (int(seconds * rate / 64) + 1)
        return f"{protocol} {payload}", edges_of(bits, float(rng.uniform(0.0, 1e6 / rate)), 1e6 / rate)
    sent: list[int] = []
    label = protocol
    payload = 0
    if protocol not in TEXT and protocol != "packet":
        while True:
            payload = int(rng.integers(0, 256))
            try:
                word = kind.encode(payload)
            except ValueError:
                continue
            if getattr(kind, "advice", lambda _: None)(payload) is None:
                break
        sent = list(word) * (int(seconds * rate / len(word)) + 1)
        label = f"{protocol} {payload}"
    number = 0
    while len(sent) < seconds * rate:
        if protocol == "packet":
            sent += kind.message(rng.bytes(16), int(rng.integers(256)), number)  # type: ignore[attr-defined]
            number += 1
        else:
            sent += kind.encode("".join(chr(c) for c in rng.integers(32, 127, 64)))
    # Real clocks are .03 to .04 % off.
    bit = 1e6 / rate * (1.0 + rng.uniform(-4e-4, 4e-4))
    return label, edges_of(sent, float(rng.uniform(0.0, 10.0 * bit)), bit, level=protocol == "uart")


_MAKERS: Final = {
    "bits": _bits,
    "telegraph": _telegraph,
    "lamp": _lamp,
    "pwm": _pwm,
    "glint": _glint,
    "edge": _edge,
    "monitor": _monitor,
    "noise": _noise,
}
