"""A patch of pixels by its differential equation, in steps of 0.1 us: slow, and nothing to get wrong.

``dv/dt = (u - v) / tau(I)``, ``u = ln I``, ``I = exp(view) + sum of lights``, everything at the time itself: no
straight lines, no boxes, no cut. Events at the end of the step in which the threshold is reached.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
STEP_US = 0.1


def events(
    light: Callable[[float], Floats], until_us: float, threshold: float, tau_light: float, tau_min: float
) -> list[tuple[float, int, bool]]:
    """Return (t_us, pixel, on) in order of time.

    Args:
        light: W/m2 of all pixels at a time.
        until_us: end.
        threshold: of both polarities.
        tau_light: tau I of the photoreceptor.
        tau_min: its floor.
    """
    v = np.log(light(0.0))
    ref = v.copy()
    made = []
    for step in range(round(until_us / STEP_US)):
        now = light((step + 0.5) * STEP_US)
        tau = np.maximum(tau_min, tau_light / now)
        v += (np.log(now) - v) * -np.expm1(-STEP_US / tau)
        for sign in (1.0, -1.0):
            over = np.flatnonzero(sign * (v - ref) >= threshold)
            while len(over):
                made += [((step + 1) * STEP_US, int(pixel), sign > 0) for pixel in over]
                ref[over] += sign * threshold
                over = over[sign * (v[over] - ref[over]) >= threshold]
    return made
