"""The motion at one place, from the samples around it.

A straight front shows only its motion across itself, v_i along u_i; fronts of several directions together show all of
V. So V is fitted, not averaged, with robust weights, since a network in texture also fires where two fronts meet::

    minimise over V:   sum_i w_i rho_i (u_i . V - v_i)^2  +  ACROSS sum_i w_i rho_i (n_i . V)^2        n_i across u_i

rho_i is Tukey's biweight at `REACH_OF` times the mean absolute residual. The confidence is the weight of the samples
that V explains, over that of all, times how much evidence there is.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from heliograph_services.tracker.jit import kernel

# A motion across a front that no other front has seen is held to 0; the seen ones overrule it at a twentieth.
ACROSS: Final = 0.05
ROUNDS: Final = 5
# Tukey's 4.685 standard deviations in mean absolute residuals (a normal one is 0.8 deviations) is 5.9; two fronts that
# meet are no normal error, so it is taken closer.
REACH_OF: Final = 3.0
# Residuals below this share of the speed are rounding to ticks, not outliers.
LEAST_SHARE: Final = 0.15
# A sample is explained as far as its residual is less than this share of the speed.
EXPLAINED: Final = 0.5
# Evidence that makes a confidence of one half: two fronts of three pixels across a kernel, (15/25)^3 each.
EVIDENCE_HALF: Final = 0.4
# Samples that are passed over at once.
BLOCK: Final = 32


@kernel
def _solve(near: Any, ax: float, ay: float, bound: float) -> Any:
    """Return the V that the weights at the former V (ax, ay) yield; near is (n, 4): u, v and w of the samples."""
    a = 0.0
    b = 0.0
    d = 0.0
    e = 0.0
    f = 0.0
    for i in range(len(near)):
        ux = near[i, 0]
        uy = near[i, 1]
        residual = abs(ux * ax + uy * ay - near[i, 2])
        if residual >= bound:
            continue
        w = near[i, 3] * (1.0 - (residual / bound) ** 2) ** 2
        a += w * (ux * ux + ACROSS * uy * uy)
        b += w * (1.0 - ACROSS) * ux * uy
        d += w * (uy * uy + ACROSS * ux * ux)
        e += w * ux * near[i, 2]
        f += w * uy * near[i, 2]
    det = a * d - b * b
    if det <= 0.0:
        return 0.0, 0.0
    return (d * e - b * f) / det, (a * f - b * e) / det


@kernel
def _residual(near: Any, ax: float, ay: float, bound: float) -> float:
    """Return the mean absolute residual of the samples within the bound."""
    total = 0.0
    used = 0.0
    for i in range(len(near)):
        residual = abs(near[i, 0] * ax + near[i, 1] * ay - near[i, 2])
        if residual < bound:
            total += near[i, 3] * residual
            used += near[i, 3]
    return total / used if used > 0.0 else 0.0


@kernel
def _explained(near: Any, ax: float, ay: float) -> float:
    """Return the weight of the samples that V explains."""
    limit = EXPLAINED * np.sqrt(ax * ax + ay * ay)
    total = 0.0
    for i in range(len(near)):
        residual = abs(near[i, 0] * ax + near[i, 1] * ay - near[i, 2])
        if residual < limit:
            total += near[i, 3] * (1.0 - (residual / limit) ** 2) ** 2
    return total


@kernel
def _motion(near: Any, total: float) -> Any:
    """Return (vx, vy, confidence) from the samples of a place, of so much weight; zeros without any."""
    ax = 0.0
    ay = 0.0
    bound = np.inf
    for _ in range(ROUNDS):
        ax, ay = _solve(near, ax, ay, bound)
        if ax == 0.0 and ay == 0.0:
            return 0.0, 0.0, 0.0
        bound = max(REACH_OF * _residual(near, ax, ay, bound), LEAST_SHARE * np.sqrt(ax * ax + ay * ay))
    return ax, ay, _explained(near, ax, ay) / (total + EVIDENCE_HALF)


@kernel
def local_motions(x: Any, y: Any, vx: Any, vy: Any, weight: Any, at_x: Any, at_y: Any, radius: Any, out: Any) -> None:
    """Fill out (k, 3): vx, vy, confidence at k places from the (n,) samples within each radius; zeros without any."""
    n = len(x)
    # A tick's samples come row by row: most blocks of them lie above or below a place altogether.
    blocks = -(-n // BLOCK)
    top = np.empty(blocks)
    bottom = np.empty(blocks)
    for b in range(blocks):
        top[b] = np.inf
        bottom[b] = -np.inf
        for i in range(b * BLOCK, min(n, (b + 1) * BLOCK)):
            top[b] = min(top[b], y[i])
            bottom[b] = max(bottom[b], y[i])
    inside = np.empty(n, np.int64)
    for place in range(len(at_x)):
        px = at_x[place]
        py = at_y[place]
        reach = radius[place]
        found = 0
        for b in range(blocks):
            # Half a pixel more: the circle itself is judged below.
            if top[b] > py + reach + 0.5 or bottom[b] < py - reach - 0.5:
                continue
            for i in range(b * BLOCK, min(n, (b + 1) * BLOCK)):
                if (x[i] - px) ** 2 + (y[i] - py) ** 2 <= reach * reach:
                    inside[found] = i
                    found += 1
        near = np.empty((found, 4))
        total = 0.0
        for j in range(found):
            i = inside[j]
            speed = np.sqrt(vx[i] * vx[i] + vy[i] * vy[i])
            near[j, 0] = vx[i] / speed
            near[j, 1] = vy[i] / speed
            near[j, 2] = speed
            near[j, 3] = weight[i]
            total += weight[i]
        out[place, 0], out[place, 1], out[place, 2] = _motion(near, total)
