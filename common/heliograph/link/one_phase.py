"""Whether the edges of a word that repeats lie on one grid of bits: a beacon's do, those of other light lie anywhere.

Equal frames count as witnesses one by one against random bits (`heliograph.link.acceptance`). A light that repeats
itself, every n bits or a whole number of times in them, makes them equal whatever it is: together they say what one of
them says. What they do tell better and better is where in its bit each edge of the word lies.

Over the frames of one word since another was read (or the frames lost their place), each edge i of the word, at the
boundaries i = 1 ... n, the last of which is the next frame's first, has the mean of its events' times::

    o_i = sum_frames sum_events (t - b_i) / sum_frames (events - background)        b_i = b_0 + i (b_n - b_0) / n

The frame's own ends are the ruler, since the clock is steered by the very edges. A beacon's o_i are one delay for all
rises and one for all falls. With what is left of them, and a quarter (the square of half a bit) for each edge of the
word that is not seen, and for each that is seen where the word has none::

    rho^2 = sum_i (o_i - mean of i's polarity)^2 + (missing + more) / 4        d = E - 2,  E = E+ + E- edges of the word

Of a light whose edges lie anywhere in their bits, each place as likely, as little is left in that part of the unit
torus that lies within rho of the plane of two delays: a tube (E+ E-)^1/2 wide, a d-ball across::

    P = (E+ E-)^1/2 pi^(d/2) / Gamma(d/2 + 1) rho^d

Asked is that no more is left than SPREAD a degree of freedom, or, of words of many edges, that P is below ENOUGH::

    edges                4      6        8         10        12 and more
    P at SPREAD          .049   .0036    2.7e-4    1.9e-5    (1e-5 is enough)

That is the chance for a light that repeats itself, and has been read as a word, to be believed. It is one for each such
light, not for each of its bits. Against that a word of four edges cannot be made safer than its sensor is exact; one of
two, a square wave, is no evidence at all (d = 0): it is refused as PERIODIC, or believed
where the site says so, if no other edge is seen.

Scans. Behind scans of q bits a time is known to (-q, 0]. That averages out where word and scans drift against each
other, and then shows as a spread v of each edge's times. What does not show may hide as much in each o_i. Behind scans
of TWO_A_BIT and more, where the edges of any light seem to keep the grid, it is added: rho^2 + E max(q^2 / 12 - v, 0).
Below that it is not: images come at two a bit, in step with the bits, and could not be told at all. There a light that
repeats itself in step with both is on the grid with a chance of q an edge.
"""

from __future__ import annotations

from functools import lru_cache
from math import inf, lgamma, log, pi, sqrt
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.link.clock import Floats
from heliograph.link.frames import CyclicCode, bits_of
from heliograph.link.scans import spacing, starts
from heliograph.link.state import (
    AT,
    GRID_FRAMES,
    GRID_WORD,
    MOMENT,
    NUMBER,
    READ_OUT,
    RING,
    SQUARE,
    State,
)

# What the beacons of the simulated sensors keep to, their slowest pixels and the ends of scans included.
SPREAD: Final = 1.0 / 16.0
# Lights that repeat themselves are not many; and a sensor's own inexactness would delay words of many edges.
ENOUGH: Final = 1e-5
# Of the mean edge of its polarity: less is no edge, more is one.
SEEN: Final = 0.25
MORE: Final = 0.5
# Behind longer scans the times say nothing, unless they drift.
TWO_A_BIT: Final = 0.6
# Shorter ones hide less than SPREAD in any case.
SCAN_LEAST: Final = 0.15
# Of a word of two edges: that it has no other is all that is asked, and worth nothing.
ALONE: Final = 1e-6
# The edges of a light that is slow and sharp come in bursts whole bits apart. Those of scans have one time each. So do
# those of images, of which a bit may last two: then the bursts are whole bits apart to the camera's clock.
IN_STEP: Final = 1e-3
WHOLE: Final = 0.05
STAMPS: Final = 1.5
# What the camera's clock and a PLL's last step leave: bounds the logarithm.
RHO_LEAST: Final = 1e-3


def needed_of(code: CyclicCode) -> tuple[float, ...]:
    """Return what `needed` says of each word of a code."""
    return _needed_of(code.words, code.bits)


@lru_cache
def _needed_of(words: tuple[int, ...], n: int) -> tuple[float, ...]:
    return tuple(needed(word, n) for word in words)


def needed(word: int, n: int) -> float:
    """Return -ln P, in nats, from which on a word of n bits is believed of a light that repeats it."""
    bits = bits_of(word, n)
    rises = sum(one > before for before, one in zip((bits[-1], *bits[:-1]), bits, strict=True))
    d = 2 * rises - 2
    if d <= 0:
        return ALONE
    return min(tube(rises, rises, d, SPREAD * sqrt(d)), -log(ENOUGH))


def tube(falls: float, rises: float, d: float, rho: float) -> float:
    """Return -ln P, at least 0."""
    ball = 0.5 * d * log(pi) - lgamma(0.5 * d + 1.0) + d * log(max(rho, RHO_LEAST))
    return max(-ball - 0.5 * log(falls * rises), 0.0)


_tube = numba.njit(nogil=True)(tube)


def read_out(t: Floats) -> float:
    """Return the length of the scans that events come in; 0 where it does not matter or they come in none.

    Unlike `heliograph.link.scans.quantum` it knows scans of any length.

    Args:
        t: (n,) event times in nominal bits, not falling.
    """
    begun = starts(t)
    q = spacing(begun, SCAN_LEAST, inf)
    whole = abs(q - max(round(q), 1))
    in_step = whole < IN_STEP or (whole < WHOLE and len(np.unique(t)) > STAMPS * len(begun))
    return 0.0 if in_step else q


@numba.njit(nogil=True)
def clear(fact: Floats) -> None:
    """Begin a slot."""
    fact[NUMBER : SQUARE + 2] = 0.0


@numba.njit(nogil=True)
def take(offset: float, off: float, on: float, fact: Floats) -> None:
    """Count events of both polarities at one time, so far behind the boundary of their slot."""
    for p in range(2):
        number = on if p == 1 else off
        fact[NUMBER + p] += number
        fact[MOMENT + p] += number * offset
        fact[SQUARE + p] += number * offset * offset


@numba.njit(nogil=True)
def note(m: int, which: int, state: State) -> float:
    """Take in the accepted frame of word `which` that ends at slot m; return -ln P of its row, in nats."""
    word = state.words[which]
    n = len(word)
    ints, grid = state.ints, state.grid
    if ints[GRID_WORD] != which:
        ints[GRID_WORD] = which
        ints[GRID_FRAMES] = 0
        grid[:] = 0.0
    ints[GRID_FRAMES] += 1
    begin = state.facts[(m - n) % RING, AT]
    period = (state.facts[m % RING, AT] - begin) / n
    for i in range(1, n + 1):
        fact = state.facts[(m - n + i) % RING]
        off = fact[AT] - begin - i * period
        for p in range(2):
            number, moment = fact[NUMBER + p], fact[MOMENT + p]
            sums = grid[i - 1, p]
            sums[0] += number
            sums[1] += moment + off * number
            sums[2] += fact[SQUARE + p] + 2.0 * off * moment + off * off * number
    return _nats(word, grid, state.floats[READ_OUT])


@numba.njit(nogil=True)
def _nats(word: npt.NDArray[np.uint8], grid: Floats, q: float) -> float:
    """Return -ln P of the sums of a row."""
    edges = np.zeros(2)
    off, odd, spread, seen = 0.0, 0.0, 0.0, 0.0
    for p in range(2):
        edges[p], timed, left, other, wide = _left(word, grid, p)
        off += left
        odd += other
        spread += wide
        seen += timed
        if timed == 0.0:
            return 0.0
    d = edges[0] + edges[1] - 2.0
    if d <= 0.0:
        return ALONE if odd == 0.0 else 0.0
    hidden = (d + 2.0) * max(q * q / 12.0 - spread / seen, 0.0)
    off = off + hidden if q > TWO_A_BIT else max(off - hidden, 0.0)
    return float(_tube(edges[0], edges[1], d, np.sqrt(off + 0.25 * odd)))


@numba.njit(nogil=True)
def _left(word: npt.NDArray[np.uint8], grid: Floats, p: int) -> tuple[float, float, float, float, float]:
    """Return of a polarity E, how many edges were timed, what is left of their o_i, missing + more, the sum of v."""
    n = len(word)
    # Somewhere in a word a polarity is at rest: what comes there is background.
    quiet = np.inf
    usual, edges = 0.0, 0.0
    for i in range(n):
        quiet = min(quiet, grid[i, p, 0])
        if p == word[(i + 1) % n] and p != word[i]:
            edges += 1.0
            usual += grid[i, p, 0]
    usual = usual / max(edges, 1.0) - quiet
    first, second, spread, timed, odd = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        number = grid[i, p, 0] - quiet
        if p != word[(i + 1) % n] or p == word[i]:
            # One more edge is one of two. What goes on in the same way behind an edge may be its tail, though.
            if word[i] != p and word[(i + 1) % n] != p:
                odd += number > MORE * usual
        elif number <= SEEN * usual or number <= 0.0:
            odd += 1.0
        else:
            at = grid[i, p, 1] / number
            first += at
            second += at * at
            spread += max((grid[i, p, 2] - quiet / 12.0) / number - at * at, 0.0)
            timed += 1.0
    if timed > 0.0:
        second = max(second - first * first / timed, 0.0)
    return edges, timed, second, odd, spread
