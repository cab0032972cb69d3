"""IEBCS by its formulas (Joubert, Marcireau, Ralph, Jolley, van Schaik and Cohen, "Event camera simulator improvements
via characterized parameters", Frontiers in Neuroscience 15, 2021).

Light is held from one change to the next. The photoreceptor is a low pass of first order, its time constant in inverse
proportion to the light. From v towards u = ln I a threshold th above the last reset value r is reached after

    t = -tau ln(1 - (r + th - v) / (u - v))

and the pixel is dead for a refractory period, at the end of which it is reset to what v is by then. To the delay comes
a latency with a jitter, and from noise of the threshold, sigma_th, a further one of ``sigma_th tau / (u - v)``:

    sd(t) = sqrt(jitter^2 + (sigma_th tau / (u - v))^2)
"""

from __future__ import annotations

import math


def events(
    changes: list[tuple[float, float]],
    until_us: float,
    threshold: float,
    tau_light: float,
    tau_min: float,
    dead_us: float,
) -> list[tuple[float, bool]]:
    """Return (t_us, on) of a pixel without noise whose light is (from t_us, W/m2)."""
    made = []
    v = reset = math.log(changes[0][1])
    alive_us = changes[0][0]
    ends = [t for t, _ in changes[1:]] + [until_us]
    for (begin, light), end in zip(changes, ends, strict=True):
        u, tau, t = math.log(light), max(tau_min, tau_light / light), begin
        while True:
            if alive_us > t:
                until = min(alive_us, end)
                v = u + (v - u) * math.exp(-(until - t) / tau)
                t = until
                reset = v
                if until == end:
                    break
            sign = 1.0 if u > v else -1.0
            share = (reset + sign * threshold - v) / (u - v) if u != v else math.inf
            wait = -tau * math.log(1.0 - share) if share < 1.0 else math.inf
            if t + wait >= end:
                v = u + (v - u) * math.exp(-(end - t) / tau)
                break
            v = u + (v - u) * math.exp(-wait / tau)
            t += wait
            made.append((t, sign > 0))
            alive_us = t + dead_us
    return made


def first_jitter(jitter_us: float, threshold_sd: float, threshold: float, size: float, tau: float) -> float:
    """Return the standard deviation of the first event of a step of that size, at its crossing.

    The published formula has the slope of v at the step, size / tau; at the crossing it is (size - threshold) / tau.
    """
    return math.hypot(jitter_us, threshold_sd * tau / (size - threshold))
