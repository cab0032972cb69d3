"""ESIM by its formulas (Rebecq, Gehrig and Scaramuzza, "ESIM: an open event camera simulator", CoRL 2018, section 3).

Between two images at t and t + dt the log intensity of a pixel goes on a straight line. An event of polarity p comes
whenever it has changed by C since the last one: at ``t + dt (ref + p C - L(t)) / (L(t + dt) - L(t))``; then ref moves
by p C, whether or not the event is dropped because the pixel's last one was less than a refractory period before.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt


def events(
    times_us: Sequence[float], images: Sequence[npt.NDArray[np.float64]], up: float, down: float
) -> list[tuple[float, int, bool]]:
    """Return (t_us, pixel, on) of images of ln I, sorted; without a refractory period."""
    made = []
    ref = images[0].reshape(-1).copy()
    for t0, t1, before, after in zip(times_us[:-1], times_us[1:], images[:-1], images[1:], strict=True):
        for pixel, (a, b) in enumerate(zip(before.reshape(-1), after.reshape(-1), strict=True)):
            while b > a and ref[pixel] + up <= b:
                ref[pixel] += up
                made.append((t0 + (t1 - t0) * (ref[pixel] - a) / (b - a), pixel, True))
            while b < a and ref[pixel] - down >= b:
                ref[pixel] -= down
                made.append((t0 + (t1 - t0) * (ref[pixel] - a) / (b - a), pixel, False))
    return sorted(made)
