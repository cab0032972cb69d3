"""Lights that repeat themselves in step with a word: the worst case for a code that is sent again and again.

The period is n bits of the listener's rate, give or take 2 %, or that over k = 1 ... 5, n the bits of a word; so
whatever is read of such a light is read again in every frame, and equal frames say nothing. Three kinds, in turn::

    edges   1 to 4 flashes a period, their edges anywhere in it
    pwm     one flash a period
    word    a word of the other cyclic code, over as long as k words of the listener's: on another grid

Each lasts 60 words, and is seen as `false_lights.watched` sees a light. A listener that measures the rate itself is
shown periods for 250 to 5000 bit/s. `read` counts the lights of which at least as many frames were read as an identity
takes, so could have been told by frames alone; most of the rest make none. A payload whose word is a square wave (the
encoder advises against it; it is read where only a bit rate is given) is any PWM of that period: `square`, not `told`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from heliograph.link.contract import edges_of
from heliograph.link.modulations import modulation
from heliograph_services.cli.studies.false_lights import Edges, log_uniform, watched
from heliograph_services.cli.studies.heard import Signal, listen
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.routing import HEART_OF

BITS = {"seed11": 11, "code": 20}
OTHER = {"seed11": "code", "code": "seed11"}
KINDS = ("edges", "pwm", "word")
WORDS = 60
OFF_RATE = 0.02
MEASURED = (250.0, 5000.0)
FRAMES = 4


def repeater(kind: str, protocol: str, rate: float, rng: np.random.Generator) -> tuple[str, Edges, float]:
    """Return a light's name, its edges and how many seconds it lasts.

    Args:
        kind: of KINDS.
        protocol: of the listener, a cyclic one.
        rate: of the listener, bit/s.
        rng: of all that is drawn.
    """
    seconds = WORDS * BITS[protocol] / rate
    k = int(rng.integers(1, 6))
    whole_us = BITS[protocol] / rate * 1e6 * (1.0 + rng.uniform(-OFF_RATE, OFF_RATE))
    if kind == "word":
        other = OTHER[protocol]
        word = _word(other, rng)
        period_us = whole_us * (k if protocol == "seed11" else 1)
        repeats = int(seconds * 1e6 / period_us) + 2
        edges = edges_of(word * repeats, float(rng.uniform(0.0, period_us)), period_us / len(word))
        return f"word of {other} in {period_us / whole_us:.0f}", edges, seconds
    period_us = whole_us / k
    flashes = 1 if kind == "pwm" else int(rng.integers(1, 5))
    at = np.sort(rng.random(2 * flashes)) * period_us
    repeats = int(seconds * 1e6 / period_us) + 2
    times = (np.arange(repeats)[:, None] * period_us + at).ravel()
    return f"{flashes} in a period, {k} periods", (times, np.tile([True, False], len(times) // 2)), seconds


def _word(protocol: str, rng: np.random.Generator) -> tuple[int, ...]:
    while True:
        try:
            return tuple(modulation(protocol).encode(int(rng.integers(0, 512))))
        except ValueError:
            continue


def repeaters_row(links: LinkPlan, protocol: str, rate: float | None, lights: int, seed: int) -> dict[str, Any]:
    """Return what a reader told of so many lights; rate None where it measures it."""
    rng = np.random.default_rng(seed)
    heard_s, frames, read, square, told = 0.0, 0, 0, 0, []
    advice = modulation(protocol).advice  # type: ignore[attr-defined]  # cyclic protocols have it
    for i in range(lights):
        own = rate or log_uniform(rng, *MEASURED)
        label, edges, seconds = repeater(KINDS[i % len(KINDS)], protocol, own, rng)
        seen = watched(label, edges, seconds, rng)
        depth = np.full(len(seen.t_us), HEART_OF, np.uint8)
        said = listen(links, Signal(seen.t_us, seen.on, depth, 0, seen.until_us))
        heard_s += seconds
        frames += said.frames
        read += said.frames >= FRAMES
        payloads = {int(one.split(":")[1]) for one in said.identities}
        if payloads and all(advice(payload) is not None for payload in payloads):
            square += 1
        elif payloads:
            told.append({"light": label, "identities": said.identities, "text": ""})
    row = {"heard_s": round(heard_s, 3), "candidates": lights, "read": read, "square": square}
    return row | {"frames": frames, "told": told}
