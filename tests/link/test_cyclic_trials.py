"""How soon a beacon is known: a likely clock counts where the code repeats under it."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link import trial
from heliograph.link.modulations import modulation
from support.lights import Light, Seen, repeated, seen

BIT_RATE = 2000.0
BIT_US = 500.0


def identified_after_us(what: Seen, step_us: int = 1_000) -> float:
    """Return how long after the first event the receiver knows who it is, asked every step_us."""
    receiver = modulation("seed11").receiver(BIT_RATE)
    at = 0
    for until_us in range(step_us, int(what.until_us), step_us):
        to = int(np.searchsorted(what.t_us, until_us))
        receiver.feed(what.t_us[at:to], what.on[at:to], until_us)
        at = to
        if receiver.identity() is not None:
            return float(until_us - what.t_us[0])
    return float("inf")


@pytest.mark.parametrize("payload", [2, 4, 12, 19, 32, 49])
def test_words_of_few_edges_are_known_after_five_frames(payload: int) -> None:
    bits = [0] * 37 + repeated(modulation("seed11").encode(payload), 20)
    # Four frames of light, and the parts of a block until it is looked at; the edges alone need 70 bits and more.
    assert identified_after_us(seen(Light(), bits, BIT_RATE, payload)) <= 56 * BIT_US


def test_what_comes_out_of_the_dark_is_known_as_soon_as_what_is_new() -> None:
    link, receiver = modulation("seed11"), modulation("seed11").receiver(BIT_RATE)
    first = repeated(link.encode(27), 30)
    what = seen(Light(), [*first, *[0] * 6_000, *repeated(link.encode(49), 20)], BIT_RATE, 3)
    dark_us = round((len(first) + 3_000) * BIT_US)
    before = what.t_us < dark_us
    receiver.feed(what.t_us[before], what.on[before], dark_us)
    soon_us = int(what.t_us[~before][0]) + round(56 * BIT_US)
    soon = ~before & (what.t_us < soon_us)
    receiver.feed(what.t_us[soon], what.on[soon], soon_us)
    known = receiver.identity()
    assert known is not None
    assert known.payload == 49


def test_likeness_is_that_of_numpy() -> None:
    rng = np.random.default_rng(8)
    t, on = np.sort(rng.uniform(0.0, 40.0, 300)), rng.random(300) < 0.5
    n, slots, begin, period = 11, 33, 3.2, 1.01
    edges = begin + period * np.arange(slots + 1)
    counts = np.stack([np.histogram(t[on == p], edges)[0] for p in (False, True)]).astype(float)
    counts -= counts.mean(axis=1, keepdims=True)
    a, b = counts[:, :-n].ravel(), counts[:, n:].ravel()
    expected = (a @ b) / np.sqrt((a @ a) * (b @ b))
    assert trial.likeness(t, on, begin, period, slots, n) == pytest.approx(expected)
