"""From clusters to targets: centre, size, polarity and roundness.

The centre is the barycentre of the events, as in the paper. That of the pixels lies ahead of a beacon that moves, by .5
px at 300 px/s: the dark pixels ahead answer to the faint rim of its light, the ones behind are still fading.

Over the N distinct pixels of a cluster, with variances var_x, var_y (a pixel's own extent adds 1/12 each) and b the
barycentre, d the farthest pixel::

    distinct   N / (2 pi (var_x + var_y + 1/6))     1 for a disc: R^2 / 2 = var_x + var_y, N = pi R^2
    paper      N / (pi (|b - d| + 1/2)^2)           the paper's N_e / (pi |b - d|^2), "Clustering"; paper-notes 8

Discs of radius 1.5 px and more score .86 to 1 (distinct) or .66 to .89 (paper), streaks .16 to .45. A target is
refused as a *birth* if N lies outside {N_min; N_max} or it is less round than r; a track may still use it.
Polarity is P = (n_on - n_off) / (n_on + n_off).

A disc that sweeps over L pixels while the window lasts is a streak. With the variances l_1 >= l_2 along its own axes::

    L^2 = 12 (l_1 - c l_2)                                c = 1.5: what chance makes of a disc is no motion
    fill = N / (4 pi sqrt((l_1 + 1/12) (l_2 + 1/12)))     1 for a disc, .95 for a long streak, less for a crescent

(distinct) A streak that is not round is *swept* if it is as full as r_s, as wide as a beacon, and its pixels went both
ways (`BOTH_SHARE`): a light that blinks while it moves. What an edge leaves behind went one way, or is thin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.clustering import Active, Ints
from heliograph_services.tracker.config import Shape
from heliograph_services.tracker.jit import kernel

Floats = npt.NDArray[np.float64]

# The share of a target's pixels that its radius covers (heliograph.messages.Tracks).
COVERED: Final = 0.9

ROUND: Final = 0
TOO_FEW: Final = 1
TOO_MANY: Final = 2
NOT_ROUND: Final = 3
SWEPT: Final = 4

# A blinking light fires all its pixels one way, then all of them the other way; a crossing edge fires each pixel one
# way, and a texture goes on with one polarity or mixes both among different pixels. So a window shows blinking if a
# share of its pixels went both ways within it (fast light), or if its polarity is clear and not the last clear one, and
# its pixels fired more than once, or, of a disc, all at once (slow light; `DENSE`, `AT_ONCE_TICKS2`). Clear is the
# paper's |P| >= .5. The edges of 5 kbit/s put both into every pixel of a 5 ms window that has more than one event;
# noise on an edge does so in one of twenty.
BOTH_SHARE: Final = 0.25
CLEAR: Final = 0.5
# A light that is switched passes several thresholds at once, and puts 1.3 to 8 events into each pixel of a window (all
# scenes of ours, 50 bit/s to 5 kbit/s); an edge that moves by less than a pixel in it passes one: 1.00, at most 1.08 in
# nine of ten.
DENSE: Final = 1.2
# A sensor that is scanned tells a pixel at most once a scan, however many thresholds a weak light passed: 24 pixels, 24
# events. But those of a light are a disc and come at once, while an edge needs all of the window. Variance of the
# events' times, ticks squared: an edge has 2 (five ticks alike), a light on the border of two ticks a quarter. Of 7,800
# pieces of edges before a hand-held camera and in a recorded room (at least 6 pixels) one in four has less than .5, but
# none of these is rounder than .9; of the images of weak lights at 100 bit/s 98 of 100 are.
AT_ONCE_TICKS2: Final = 0.5
AT_ONCE_ROUND: Final = 0.9
AT_ONCE_PIXELS: Final = 6
# Small discs on a grid of pixels are rounder or less by their place: five pixels have .82, nine .87 to .95. All events
# in one tick allow for it: of 36,900 pieces of edges of 5 to 12 pixels before a hand-held camera (4 s) 40 are as round,
# at 23 places.
ONE_TICK2: Final = 1.0 / 64.0
ONE_TICK_ROUND: Final = 0.8
ONE_TICK_PIXELS: Final = 5
# Where time tells nothing, as with images, the disc alone must do: of 1,900 pieces of edges of 9 pixels and more none
# is as round (15 of 4,700 of 6 to 8 pixels are).
DISC_PIXELS: Final = 9
# Half as many pixels as a target needs are enough where every one of them went both ways within the window: a light of
# two or three pixels. In 4 s before a hand-held camera and over a site in shadow there were three such, at two places,
# neither of them again; over the site in the sun 1157, its far beacons. One pixel may be a defect.
TINY_SHARE: Final = 0.5
TINY_PIXELS: Final = 2
# A small light that shines and moves brightens what lies before it and darkens what lies behind: of the events of a
# window the rarer polarity has 25 to 50 % (LEDs of 2 px radius at 200 px/s); edges of a texture have none.
DIPOLE_SHARE: Final = 0.15
# A disc of 13 pixels whose axes differ by a half does so by chance in one of ten windows.
CHANCE: Final = 1.5
# Ticks squared; below it is rounding, or one event of a thousand.
LEAST_SPREAD: Final = 1e-3
# Full streaks score .9 to 1, two parallel lines or a bent one less than .7.
SWEPT_FILL: Final = 0.75
# Of a disc of radius 2 px; lines of one and two pixels have .17 and .33.
SWEPT_VAR_PX2: Final = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """k targets of a window, in the order of their clusters.

    Args:
        x_px: (k,) float64, centre, sensor pixels.
        y_px: (k,) float64.
        pixels: (k,) int32, distinct onset pixels.
        radius_px: (k,) float64, covers nine tenths of the pixels; half a pixel for a single one. Sensor pixels.
        reach_px: (k,) float64, covers all of them.
        on: (k,) int32, events that became brighter.
        off: (k,) int32.
        both: (k,) int32, pixels that became brighter and darker within the window.
        roundness: (k,) float64.
        swept_px: (k, 2) float64, how far it moved in the window along each axis, without the sign; sensor pixels.
        verdict: (k,) uint8: ROUND, SWEPT, TOO_FEW, TOO_MANY or NOT_ROUND.
        lag_s: (k,) float64, mean time of the events, from the middle of the window.
        v_px_s: (k, 2) float64, the slope of the events' places over their times; 0 where all are of one tick.
        spread_s2: (k,) float64, variance of the events' times.
        at_once: (k,) bool: a disc whose events came at once; a larger one where the stream is too coarse to tell.
        piece: (k,) bool: cut out of a larger cluster (`splitting`).
    """

    x_px: Floats
    y_px: Floats
    pixels: Ints
    radius_px: Floats
    reach_px: Floats
    on: Ints
    off: Ints
    both: Ints
    roundness: Floats
    swept_px: Floats
    verdict: npt.NDArray[np.uint8]
    lag_s: Floats
    v_px_s: Floats
    spread_s2: Floats
    at_once: npt.NDArray[np.bool_]
    piece: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.x_px)

    @property
    def light(self) -> npt.NDArray[np.bool_]:
        """(k,) bool: those that have the shape of a light, still or moving."""
        return np.asarray((self.verdict == ROUND) | (self.verdict == SWEPT))

    @property
    def blinking(self) -> npt.NDArray[np.bool_]:
        """(k,) bool: those of which many pixels went both ways within the window."""
        return np.asarray(self.both >= BOTH_SHARE * self.pixels)

    @property
    def dipole(self) -> npt.NDArray[np.bool_]:
        """(k,) bool: those that a small light may have made that shines and moves; see `DIPOLE_SHARE`."""
        return np.asarray(np.minimum(self.on, self.off) >= DIPOLE_SHARE * (self.on + self.off))

    @property
    def rise(self) -> npt.NDArray[np.bool_]:
        """(k,) bool: those that became clearly brighter."""
        return np.asarray(self.on - self.off >= CLEAR * (self.on + self.off))

    @property
    def switched(self) -> npt.NDArray[np.bool_]:
        """(k,) bool: those that a light may have made that was switched in the window; see `is_switched`."""
        return is_switched(self.pixels, self.on + self.off, self.both, self.at_once)


def is_switched(
    pixels: npt.NDArray[Any],
    events: npt.NDArray[Any],
    both: npt.NDArray[Any],
    at_once: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]:
    """Return (k,) bool: whether many pixels went both ways, or each by more than one threshold, or all at once.

    Args:
        pixels: (k,), distinct pixels.
        events: (k,), of them all.
        both: (k,), pixels that went both ways.
        at_once: (k,), see `Targets`.
    """
    return np.asarray((both >= BOTH_SHARE * pixels) | (events >= DENSE * pixels) | at_once)


@dataclass(frozen=True, slots=True)
class ShapeFilter:
    """What may become a track: {N_min; N_max} onset pixels, and the least roundness by one of the two measures."""

    min_pixels: int
    max_pixels: int
    min_roundness: float
    shape: Shape


@kernel
def _members(labels: Ints, count: int, first: Ints, member: Ints) -> None:
    """Sort the pixels by cluster: those of cluster c are member[first[c]:first[c + 1]], in the order of the input."""
    for i in range(len(labels)):
        if labels[i] >= 0:
            first[labels[i] + 1] += 1
    for c in range(count):
        first[c + 1] += first[c]
    cursor = first[:count].copy()
    for i in range(len(labels)):
        c = labels[i]
        if c >= 0:
            member[cursor[c]] = i
            cursor[c] += 1


@kernel
def _measure(
    x_px: Ints,
    y_px: Ints,
    on: Ints,
    off: Ints,
    moments: Floats,
    first: Ints,
    member: Ints,
    covered: float,
    out: Floats,
    events: Ints,
) -> None:
    """Fill out (11, k) and events (3, k): on, off, both.

    Rows of out: x, y, covering radius and reach of the centres, var_x, var_y, their covariance; of the events in ticks
    the mean and the variance, and the slopes of x and y over them.
    """
    for c in range(out.shape[1]):
        start, stop = first[c], first[c + 1]
        n = stop - start
        sx = 0.0
        sy = 0.0
        wx = 0.0
        wy = 0.0
        t = 0.0
        tt = 0.0
        tx = 0.0
        ty = 0.0
        for m in range(start, stop):
            i = member[m]
            sx += x_px[i]
            sy += y_px[i]
            wx += (on[i] + off[i]) * x_px[i]
            wy += (on[i] + off[i]) * y_px[i]
            t += moments[0, i]
            tt += moments[1, i]
            tx += moments[0, i] * x_px[i]
            ty += moments[0, i] * y_px[i]
            events[0, c] += on[i]
            events[1, c] += off[i]
            if on[i] > 0 and off[i] > 0:
                events[2, c] += 1
        mean_x = sx / n
        mean_y = sy / n
        n_events = events[0, c] + events[1, c]
        x = wx / n_events
        y = wy / n_events
        out[7, c] = t / n_events
        out[8, c] = max(0.0, tt / n_events - out[7, c] ** 2)
        if out[8, c] > LEAST_SPREAD:
            out[9, c] = (tx / n_events - x * out[7, c]) / out[8, c]
            out[10, c] = (ty / n_events - y * out[7, c]) / out[8, c]
        d2 = np.empty(n, np.float64)
        for m in range(n):
            i = member[start + m]
            d2[m] = (x_px[i] - x) ** 2 + (y_px[i] - y) ** 2
            dx = x_px[i] - mean_x
            dy = y_px[i] - mean_y
            out[4, c] += dx * dx / n
            out[5, c] += dy * dy / n
            out[6, c] += dx * dy / n
        d2.sort()
        out[0, c] = x
        out[1, c] = y
        out[2, c] = np.sqrt(d2[max(0, int(np.ceil(covered * n)) - 1)])
        out[3, c] = np.sqrt(d2[n - 1])


def measure(
    active: Active,
    labels: Ints,
    piece: npt.NDArray[np.bool_],
    pool_px: int,
    rule: ShapeFilter,
    ticks: int = 1,
    tick_s: float = 1.0,
    *,
    is_fine: bool = False,
) -> Targets:
    """Return the targets of labelled pixels.

    Args:
        active: the window's n pixels.
        labels: (n,) int32, below k; -1 for noise. Every label below k occurs.
        piece: (k,) bool, see `Targets`.
        pool_px: side of an onset pixel in sensor pixels.
        rule: what may become a track.
        ticks: in the window.
        tick_s: length of a tick.
        is_fine: whether the sensor's own instants are finer than the window, so that *at once* means something.
    """
    count = len(piece)
    first = np.zeros(count + 1, np.int32)
    member = np.empty(len(active), np.int32)
    out = np.zeros((11, count), np.float64)
    events = np.zeros((3, count), np.int32)
    _members(labels, count, first, member)
    _measure(active.x_px, active.y_px, active.on, active.off, active.moments, first, member, COVERED, out, events)
    pixels = np.diff(first)
    distinct = pixels / (2 * np.pi * (out[4] + out[5] + 1 / 6))
    roundness = distinct if rule.shape == "distinct" else pixels / (np.pi * (out[3] + 0.5) ** 2)
    disc = distinct >= AT_ONCE_ROUND
    one_tick = (out[8] < ONE_TICK2) & (distinct >= ONE_TICK_ROUND)
    brief = disc & (out[8] <= AT_ONCE_TICKS2) & (pixels >= AT_ONCE_PIXELS) | one_tick & (pixels >= ONE_TICK_PIXELS)
    at_once = brief if is_fine else disc & (pixels >= DISC_PIXELS)  # images and slow scans: all of it is at once
    swept_px, fill, width_var = _swept(pixels, out[4], out[5], out[6])
    verdict = np.where(roundness < rule.min_roundness, NOT_ROUND, ROUND).astype(np.uint8)
    if rule.shape == "distinct":
        moving = (fill >= SWEPT_FILL) & (width_var >= SWEPT_VAR_PX2) & (events[2] >= BOTH_SHARE * pixels)
        verdict[(verdict == NOT_ROUND) & moving] = SWEPT
    verdict[pixels > rule.max_pixels] = TOO_MANY
    few = pixels < rule.min_pixels
    if rule.shape == "distinct":  # the paper's way of tracking has its N_min as it is
        tiny = few & (pixels >= max(TINY_SHARE * rule.min_pixels, TINY_PIXELS)) & (events[2] == pixels)
        verdict[tiny] = ROUND
        few &= ~tiny
    verdict[few] = TOO_FEW
    middle = (pool_px - 1) / 2
    return Targets(
        x_px=out[0] * pool_px + middle,
        y_px=out[1] * pool_px + middle,
        pixels=pixels,
        radius_px=(out[2] + 0.5) * pool_px,
        reach_px=(out[3] + 0.5) * pool_px,
        on=events[0],
        off=events[1],
        both=events[2],
        roundness=roundness,
        swept_px=swept_px * pool_px,
        verdict=verdict,
        lag_s=(out[7] - (ticks - 1) / 2) * tick_s,
        v_px_s=out[9:11].T * (pool_px / tick_s),
        spread_s2=out[8] * tick_s**2,
        at_once=at_once,
        piece=piece,
    )


def _swept(pixels: Ints, var_x: Floats, var_y: Floats, cov: Floats) -> tuple[Floats, Floats, Floats]:
    """Return (k, 2) how far discs swept along x and y, (k,) how full, (k,) the variance across; see the module."""
    mean, half = (var_x + var_y) / 2, (var_x - var_y) / 2
    root = np.hypot(half, cov)
    along, across = mean + root, np.maximum(mean - root, 0.0)
    length_px = np.sqrt(12 * np.maximum(along - CHANCE * across, 0.0))
    # The long axis lies at the angle a from x: cos 2a = half / root.
    cos2 = np.divide(half, root, out=np.zeros_like(root), where=root > 0)
    swept = np.stack([np.sqrt((1 + cos2) / 2), np.sqrt(np.maximum(1 - cos2, 0.0) / 2)], axis=1) * length_px[:, None]
    fill = pixels / (4 * np.pi * np.sqrt((along + 1 / 12) * (across + 1 / 12)))
    return swept, fill, across
