"""The kernels that let a region's own events say where its target is.

A region is a Kalman filter (heliograph_services.decoder.region_state). What it has heard within its gate since it was
centred last is a measurement as soon as it holds n >= n_min events on enough distinct pixels and stands out from the
surrounding noise, n >= 2 e + 3 sqrt(e); else it is forgotten after `HOLD_US`::

    z = trimmed mean of (event - c(t)) / (1 - e / n),   R = 2 (min(m^2 / 2, rho^2 / 4) + 1/12) / n + R_0
    S = P_xx + R,   |z| at most 5 sqrt(S),   c += P_xx z / S,   v += P_xv z / S
    u = (z_x^2 + z_y^2) / 2 S,   q <- q exp(eta (min(u, u_max) - 1))

    w += (v x v') / (|v|^2 tau), 0 below v_0               v before, v' after

m is the median distance of the events (heliograph_services.decoder.routing), rho the target's radius as it is told.
What lies about a centre at the distance m varies by m^2 / 2 on each axis; a region that is off its target finds too
large an m, hence the other bound. The line of q keeps the filter as nimble as its target: residuals larger than their
expected size are an acceleration that was not allowed for. An LED that rests or goes straight is averaged over many
edges; one that turns at 20,000 px/s2 is followed edge by edge. The mean is trimmed by a fifth at both ends of each
axis, so that a neighbour's edge cannot pull, while the two crescents of a moving lit disc still balance (a median would
jump from one to the other). The turn rate w carries a region round its curve where it hears nothing of its own, or
shares what it hears with another: it is learned from what is its alone, and forgotten after `ALIVE_US` of silence. A
pixel counts at most `PIXEL_LIMIT` times a step, and one alone is no measurement: a hot one cannot pull.
"""

from __future__ import annotations

import math
from typing import Final

from heliograph_services.decoder.region_state import (
    AGE_US,
    CORE,
    EVENTS,
    FIRST,
    GROW_LIMIT_PX,
    P_VV,
    P_XV,
    P_XX,
    PIXELS,
    RADIUS,
    RANK,
    REACH,
    SHARED,
    SPEED_LIMIT_PX_S,
    TOGETHER,
    TURN,
    US_PER_S,
    VX,
    VY,
    Counts,
    Floats,
    Ints,
    Q,
    X,
    Y,
    gate_px,
    neighbours,
    part,
    shown_px,
)

# Fewer events say nothing: three pixels that fire twice. The edge of a 3 px disc makes about 30.
MIN_EVENTS: Final = 6
# Sum over steps of (distinct pixels - 1): a hot pixel alone never gets there.
MIN_PIXELS: Final = 2
TRIM: Final = 0.2
# A faint target's edge trickles in over some milliseconds; what is older is no edge.
HOLD_US: Final = 5_000
# A sixth of a pixel, squared: what pixels, late OFF events and half-lit crescents leave of a mean over many events.
R_0: Final = 0.05
# The filter's bandwidth is about (q / (R T))^(1/4): with R T = .03 px2 x 2 ms from 64 to 640 rad/s. From one
# millisecond to the next no acceleration is seen, and q falls; but in five dark bits at 50 bit/s a flying camera's
# 500 px/s2 are 2.5 px, for which this allows 1.7 px (three standard errors).
Q_MIN: Final = 1e3
Q_MAX: Final = 1e7
# After ten edges of the expected size nothing is left of a turn; the first edge of one raises q fivefold at most.
ETA: Final = 0.2
U_MAX: Final = 9.0
SIGMAS_LIMIT: Final = 5.0
# A quarter of a pixel: below the centroid's own noise.
BINS_PER_PX: Final = 4
SHARED_VARIANCE: Final = 10.0
# Least tau: five windows of a tracker's, for the same reason as its.
TURN_S: Final = 0.025
# Of the filter's time constant 1 / sqrt(K_v), K_v = P_xv / (S t). Routh's condition for the two loops together asks for
# more than .7; below it, what is calm and goes straight would swing.
TURN_CONSTANTS: Final = 3.0
# Slower ones turn little in the 50 ms of a crossing, and their errors would make turns that are not there.
TURN_LEAST_PX_S: Final = 300.0
# 2,000 px/s on a circle of 40 px.
TURN_MOST_RAD_S: Final = 50.0
# A region that has not been centred for so long follows nothing that could be confused.
ALIVE_US: Final = 30_000


@part
def share(state: Floats, centred_us: Ints, n: int, now_us: int) -> None:
    """Note which regions may take another's events for their own: one of no lower rank, centred of late.

    What either takes for its target's lies within its gate, so regions that overlap beyond their gates share nothing.
    """
    for i in range(n):
        state[SHARED, i] = 0.0
    xs, ys, reaches = state[X], state[Y], state[REACH]
    for k in range(n):
        # Of a thousand tracks that hear nothing, none takes anything from another.
        if now_us - centred_us[k] > ALIVE_US:
            continue
        x, y, reach = state[X, k], state[Y, k], state[REACH, k]
        for first in range(0, n, TOGETHER):
            behind = min(first + TOGETHER, n)
            if not neighbours(xs[first:behind], ys[first:behind], reaches[first:behind], x, y, reach):
                continue
            for i in range(first, behind):
                both = reaches[i] + reach
                dx, dy = abs(xs[i] - x), abs(ys[i] - y)
                if i != k and dx < both and dy < both and dx * dx + dy * dy < both * both:
                    gates = gate_px(state, i) + gate_px(state, k)
                    if dx * dx + dy * dy < gates * gates and state[RANK, k] >= state[RANK, i]:
                        state[SHARED, i] = 1.0


@part
def trimmed_mean(counts: Counts, n: int, half: int) -> float:
    """Return the mean of what is left after a fifth is cut from both ends, to a quarter of a bin's width.

    Args:
        counts: (2 half or more,) residuals by quarter pixel, 0 px between the bins half - 1 and half.
        n: their sum, above 0.
        half: bins on each side.
    """
    cut = TRIM * n
    low, high = cut, n - cut
    below, total = 0.0, 0.0
    for at in range(2 * half):
        if counts[at] == 0:
            continue
        above = below + counts[at]
        inside = min(above, high) - max(below, low)
        if inside > 0.0:
            total += inside * (at - half + 0.5)
        below = above
    return total / (high - low) / BINS_PER_PX


@part
def half_bins(reach: float, bins: int) -> int:
    """Return how many bins each side of a region's histogram has."""
    return min(int((reach + GROW_LIMIT_PX + 2.0) * BINS_PER_PX), bins // 2)


@part
def turn(state: Floats, i: int, vx: float, vy: float, gain_v: float, since_s: float) -> None:
    """Correct the turn rate of region i, whose velocity was (vx, vy) before its correction by gain_v z."""
    speed2 = vx * vx + vy * vy
    if speed2 < TURN_LEAST_PX_S * TURN_LEAST_PX_S or gain_v <= 0.0:
        state[TURN, i] = 0.0
        return
    tau_s = max(TURN_S, since_s, TURN_CONSTANTS * math.sqrt(since_s / gain_v))
    change = (vx * state[VY, i] - vy * state[VX, i]) / (speed2 * tau_s)
    state[TURN, i] = min(max(state[TURN, i] + change, -TURN_MOST_RAD_S), TURN_MOST_RAD_S)


@part
def correct(state: Floats, i: int, zx: float, zy: float, variance: float, since_s: float) -> None:
    """Let a measurement correct region i: residuals in px, their variance in px2, the time since the one before."""
    if state[SHARED, i]:
        variance *= SHARED_VARIANCE
    size = state[P_XX, i] + variance
    limit = SIGMAS_LIMIT * math.sqrt(size)
    away = math.sqrt(zx * zx + zy * zy)
    surprise = away * away / (2.0 * size)
    if away > limit:
        zx *= limit / away
        zy *= limit / away
    gx, gv = state[P_XX, i] / size, state[P_XV, i] / size
    vx, vy = state[VX, i], state[VY, i]
    state[X, i] += gx * zx
    state[Y, i] += gx * zy
    state[VX, i] = min(max(state[VX, i] + gv * zx, -SPEED_LIMIT_PX_S), SPEED_LIMIT_PX_S)
    state[VY, i] = min(max(state[VY, i] + gv * zy, -SPEED_LIMIT_PX_S), SPEED_LIMIT_PX_S)
    state[P_VV, i] -= gv * state[P_XV, i]
    state[P_XV, i] *= 1.0 - gx
    state[P_XX, i] *= 1.0 - gx
    if not state[SHARED, i]:
        turn(state, i, vx, vy, gv, since_s)
        state[Q, i] = min(max(state[Q, i] * math.exp(ETA * (min(surprise, U_MAX) - 1.0)), Q_MIN), Q_MAX)


@part
def centre(state: Floats, i: int, heard: Ints, counts: Counts, noise: float, since_s: float) -> bool:
    """Correct region i if what it has heard is a measurement; return whether it was.

    Args:
        state: as of the step's end.
        i: which region.
        heard: (HEARD_ROWS, capacity).
        counts: (2, bins): its residuals by quarter pixel.
        noise: events of the surrounding noise to be expected among them.
        since_s: how long ago it was corrected.
    """
    n = heard[EVENTS, i]
    if n < MIN_EVENTS or heard[PIXELS, i] < MIN_PIXELS or n < 2.0 * noise + 3.0 * math.sqrt(noise):
        return False
    half = half_bins(state[REACH, i], counts.shape[1])
    signal = 1.0 - noise / n
    zx = trimmed_mean(counts[0], n, half) / signal
    zy = trimmed_mean(counts[1], n, half) / signal
    spread = min(state[CORE, i] ** 2 / 2.0, state[RADIUS, i] ** 2 / 4.0) + 1.0 / 12.0
    correct(state, i, zx, zy, 2.0 * spread / n / (signal * signal) + R_0, since_s)
    return True


@part
def settle(
    state: Floats,
    centred_us: Ints,
    heard: Ints,
    counts: Counts,
    n: int,
    now_us: int,
    step_us: int,
    noise_per_px_us: float,
    self_centring: bool,
) -> None:
    """Centre the regions that have heard enough, and forget what has led to nothing; arguments as of `follow`."""
    for i in range(n):
        if now_us - centred_us[i] > ALIVE_US:
            state[TURN, i] = 0.0
        if heard[EVENTS, i] == 0:
            continue
        heard[FIRST, i] = 0
        heard[AGE_US, i] += step_us
        reach = min(gate_px(state, i), shown_px(state, i))
        noise = noise_per_px_us * heard[AGE_US, i] * math.pi * reach * reach
        done = self_centring and centre(state, i, heard, counts[i], noise, (now_us - centred_us[i]) / US_PER_S)
        if done:
            centred_us[i] = now_us
        if done or heard[AGE_US, i] >= HOLD_US:
            counts[i, :, : 2 * half_bins(state[REACH, i], counts.shape[2])] = 0
            heard[:, i] = 0
