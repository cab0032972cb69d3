"""The law of one pixel: light in, events out, exactly.

::

    dv/dt = (u - v) / tau,   tau = max(tau_min, tau_ref I_ref / I),   u = ln I
    ON  when v - ref >= th_on,  then ref <- ref + th_on;      OFF when v - ref <= -th_off,  then ref <- ref - th_off
    d ref/dt = -drift (leak);   after an event ref = v for refractory_us, then it stays

The log photoreceptor with a bandwidth proportional to the light: Lichtsteiner, Posch and Delbruck, IEEE JSSC 43
(2008); Graca et al., arXiv 2304.04706. The reference: the same, and Rebecq et al., ESIM (CoRL 2018). Leak: Nozaki and
Delbruck, IEEE Trans. Electron Devices 64 (2017). One reference a pixel serves all its light.

Between two instants u is a straight line, u_a + s x over x in [0, X]; tau is that of the geometric mean of the light at
its ends (the arithmetic mean of u). Then, with m = s + drift and y = v + drift t, which is compared with the constants
ref + drift t + th_on and ref + drift t - th_off,

    y(x) = c + m x + a exp(-x / tau),   c = u_a - s tau + drift t_a,   a = v_a - u_a + s tau

It turns at most once, at exp(-x / tau) = m tau / a; on each side of that a crossing is found by Newton's method within
a bracket; where m = 0 it is closed: after a step D the k-th event comes at tau ln(D / (D - k th)).

An event leaves latency (+ latency_off_extra if OFF) + jitter z later, z normal; where that latency is below 3 jitter,
it is taken as 3 jitter: no event leaves before its crossing, and jitter is still the delay's standard deviation. None
leaves within 1 ns of the pixel's event before: jitter does not exchange the events of a pixel. Times leave in steps
of 2^-14 us (61 ps), which float64 holds exactly for days.
"""

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from heliograph_services.event_source.simulation.contract import Floats
from heliograph_services.event_source.simulation.pixel.leaf import leaf
from heliograph_services.event_source.simulation.pixel.model import (
    COUNT,
    DEAD,
    DRIFT,
    JITTER,
    LATENCY,
    LATENCY_OFF,
    LIGHT,
    OFF,
    ON,
    REF,
    REFRACTORY,
    SENT,
    TAU_LIGHT,
    TAU_MIN,
    T,
    U,
    V,
)
from heliograph_services.event_source.simulation.random import JITTER as FOR_JITTER
from heliograph_services.event_source.simulation.random import normal

# Events of a pixel between two instants: ln(I) spans 20 at most, a threshold is 0.001 at least but seldom; beyond this,
# the reference follows at once.
MOST: Final = 1000
# Free places that a call of `advance` needs: a line of input has two pieces.
RESERVE: Final = 2 * MOST
# An event is (t_us, code), code = (cause + CAUSES) PIXELS + 2 pixel + on: a whole number below 2^53.
CAUSES: Final = 16.0
PIXELS: Final = 4294967296.0
TICKS: Final = 16384.0
# A delay of a given deviation that is never negative has a mean: at least so many deviations.
NORMAL: Final = 3.0
APART_US: Final = 0.001
# Past so many time constants nothing is left of a step (e^-40 is below float64's resolution of any u).
SETTLED: Final = 40.0
# Newton's method doubles the digits: a last step of 1e-3 us leaves an error of about 1e-6 us / tau.
NEWTON_US: Final = 1e-3


@numba.njit(nogil=True)
def grow(out: Floats) -> Floats:
    """Return the events with twice the room."""
    bigger = np.empty((2 * len(out), 2))
    # Element by element: assigning slices would compile three seconds of error messages.
    for k in range(len(out)):
        bigger[k, 0], bigger[k, 1] = out[k, 0], out[k, 1]
    return bigger


@leaf
def write(out: Floats, n: int, t_us: float, pixel: int, on: bool, cause: int) -> int:
    """Write an event; return how many there are now."""
    out[n, 0] = t_us
    out[n, 1] = (cause + CAUSES) * PIXELS + pixel * 2.0 + (1.0 if on else 0.0)
    return n + 1


@leaf
def emit(state: Floats, law: Floats, seed: int, out: Floats, n: int, p: int, t_us: float, on: bool, cause: int) -> int:
    """Write an event that crossed at t_us; return how many there are now."""
    delay = law[LATENCY] if on else law[LATENCY] + law[LATENCY_OFF]
    if law[JITTER] > 0.0:
        delay = max(
            0.0, max(delay, NORMAL * law[JITTER]) + law[JITTER] * normal(seed, FOR_JITTER, p, int(state[p, COUNT]), 0)
        )
    at = max(t_us + delay, state[p, SENT] + APART_US)
    at = math.ceil(at * TICKS) / TICKS
    state[p, SENT] = at
    state[p, COUNT] += 1.0
    return write(out, n, at, p, on, cause)


@leaf
def fade(x: float) -> float:
    """Return exp(-x), for x at least 0."""
    return math.exp(-x) if x < SETTLED else 0.0


@leaf
def _solve(target: float, low: float, high: float, c: float, m: float, a: float, tau: float) -> float:
    """Return x in [low, high] with c + m x + a exp(-x / tau) = target, on a piece where that is monotone."""
    level = target - c
    part = (level - m * low) / a if a != 0.0 else 0.0
    if 0.0 < part < 1.0:
        x = -tau * math.log(part)
        if m == 0.0:
            return min(max(x, low), high)
    else:
        x = level / m if m != 0.0 else low
    # A step in a ramp: whichever of the two moves y more gives the first guess.
    if m != 0.0 and abs(a) * fade(low / tau) < abs(m) * (high - low):
        x = level / m
    rising = m - a / tau * fade(0.5 * (low + high) / tau) > 0.0
    x = min(max(x, low), high)
    for _ in range(60):
        e = a * fade(x / tau)
        f = m * x + e - level
        if (f > 0.0) == rising:
            high = x
        else:
            low = x
        slope = m - e / tau
        after = x - f / slope if slope != 0.0 else low - 1.0
        if not low <= after <= high:
            after = 0.5 * (low + high)
        if abs(after - x) < NEWTON_US:
            return after
        x = after
    return x


@leaf
def _piece(
    state: Floats, law: Floats, seed: int, out: Floats, n: int, p: int, x: float, end: float, y_end: float, span: float,
    c: float, m: float, a: float, tau: float, cause: int,
) -> tuple[int, float]:  # fmt: skip
    """Make the events of a monotone piece [x, end]; return how many there are now, and when the pixel is alive."""
    refractory = law[REFRACTORY]
    t_a = state[p, T]
    for k in range(MOST):
        up = y_end >= state[p, REF] + state[p, ON]
        if x > end or not (up or y_end <= state[p, REF] - state[p, OFF]):
            break
        target = state[p, REF] + state[p, ON] if up else state[p, REF] - state[p, OFF]
        x = _solve(target, x, end, c, m, a, tau)
        n = emit(state, law, seed, out, n, p, t_a + x, up, cause)
        state[p, REF] = target
        if refractory > 0.0:
            state[p, DEAD] = t_a + x + refractory
            x = x + refractory
            alive = min(x, span)
            state[p, REF] = c + m * alive + a * fade(alive / tau)
        elif k == MOST - 1:
            state[p, REF] = y_end
    return n, x


@leaf
def _cross(
    state: Floats, law: Floats, seed: int, out: Floats, n: int, p: int,
    span: float, slope: float, a: float, tau: float, decay: float, cause: int,
) -> int:  # fmt: skip
    """Make the events of a line of input."""
    drift = law[DRIFT]
    t_a = state[p, T]
    m = slope + drift
    c = state[p, U] - slope * tau + drift * t_a
    x = 0.0
    if state[p, DEAD] > t_a:
        x = state[p, DEAD] - t_a
        alive = min(x, span)
        state[p, REF] = c + m * alive + a * fade(alive / tau)
    end, y_end = span, c + m * span + a * decay
    if m * a > 0.0:
        part = m * tau / a
        if decay < part < 1.0:
            end = -tau * math.log(part)
            y_end = c + m * (end + tau)
    # One call for both pieces: each is compiled into this function as a whole.
    while x < span:
        n, x = _piece(state, law, seed, out, n, p, x, end, y_end, span, c, m, a, tau, cause)
        x = max(x, end)
        end, y_end = span, c + m * span + a * decay
    return n


@leaf
def advance(
    state: Floats, law: Floats, seed: int, out: Floats, n: int, p: int, t_us: float, u: float, light: float, cause: int
) -> int:
    """Take a pixel to t_us, its input there by a straight line to u = ln(light), and write its events.

    Args:
        state: (pixels, COLUMNS).
        law: the numbers.
        seed: of the random numbers.
        out: events, with RESERVE free places.
        n: events in it.
        p: the pixel.
        t_us: not before its T.
        u: input at t_us.
        light: exp(u).
        cause: of its events.

    Returns:
        How many events there are now.
    """
    t_a, v_a, u_a = state[p, T], state[p, V], state[p, U]
    span = t_us - t_a
    if span <= 0.0:
        state[p, U], state[p, LIGHT] = u, light
        return n
    if light == state[p, LIGHT]:
        tau = max(law[TAU_MIN], law[TAU_LIGHT] / light)
    else:
        tau = max(law[TAU_MIN], law[TAU_LIGHT] / math.sqrt(light * state[p, LIGHT]))
    slope = (u - u_a) / span
    a = v_a - u_a + slope * tau
    decay = fade(span / tau)
    # v goes no further from where it is than this part of the way to where u has been.
    part = 1.0 - decay
    top = v_a + part * max(0.0, max(u_a, u) - v_a) + law[DRIFT] * t_us
    bottom = v_a + part * min(0.0, min(u_a, u) - v_a) + law[DRIFT] * t_a
    ref = state[p, REF]
    if top >= ref + state[p, ON] or bottom <= ref - state[p, OFF] or state[p, DEAD] > t_a:
        n = _cross(state, law, seed, out, n, p, span, slope, a, tau, decay, cause)
    state[p, V] = u - slope * tau + a * decay
    state[p, U] = u
    state[p, T] = t_us
    state[p, LIGHT] = light
    return n
