"""Crowds: one table of a scenario, many beacons.

The area is cut into count or more cells, as square as they come (rows and columns from the area's sides); beacon i sits
in cell ``(2 i + 1) cells // (2 count)``. Its centre lies anywhere in the middle fifth of its cell, its ellipse has half
axes of 15 to 30 % of the cell's sides and a random phase and direction, so no two ever come nearer than a fifth of a
cell's side. ``period = 2 pi max(a, b) / speed``: the fastest moment of the ellipse has the speed of the file.

Payloads: the modulation's sendable and advised ones in their order, n of them, of which beacon i takes number
``i n // count``; fewer IDs than beacons are an error. The phases of their rounds are random within a second. All random
numbers are hashes of (seed, which crowd, which beacon).
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from heliograph.errors import FileError
from heliograph.link.modulations import modulation
from heliograph.units import US_PER_S
from heliograph_services.event_source.simulation.contract import Floats
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, Crowd, Path, Sine, Still

# IDs are asked for one by one up to here: the largest codebook has 4096 words.
_IDS_LIMIT: Final = 4096
_DRAWS: Final = 6  # of a beacon: centre x and y, half axes, phase, begin


def sendable(protocol: str, options: dict[str, str | int]) -> list[int]:
    """Return the payloads that a modulation can send and advises to send, in order; none where it sends text.

    Raises:
        ValueError: there is no such modulation, or it refuses an option.
    """
    try:
        kind: Any = modulation(protocol, **options)
    except FileError as error:
        raise ValueError(str(error)) from None
    advice = getattr(kind, "advice", None)
    good: list[int] = []
    if advice is None:
        return good
    for payload in range(_IDS_LIMIT):
        try:
            kind.encode(payload)
        except ValueError:
            continue
        if advice(payload) is None:
            good.append(payload)
    return good


def expanded(crowd: Crowd, which: int, seed: int) -> list[BeaconSpec]:
    """Return the beacons of a crowd.

    Args:
        crowd: as the scenario gives it.
        which: its number in the scenario.
        seed: of all that is random.

    Raises:
        ValueError: its modulation cannot send so many payloads.
    """
    good = sendable(crowd.protocol, crowd.options)
    if not crowd.fresh and len(good) < crowd.count:
        raise ValueError(
            f"count must be at most {len(good)}, the payloads of {crowd.protocol} that can be sent, not {crowd.count}"
        )
    if not good:
        raise ValueError(f"protocol must have payloads, which {crowd.protocol} has not")
    # Numba, only where there is a crowd.
    from heliograph_services.event_source.simulation.random import PATH, uniforms  # noqa: PLC0415

    beacon, draw = np.indices((crowd.count, _DRAWS))
    draws = uniforms(seed, PATH, which, beacon, draw)
    return [
        BeaconSpec(
            name=f"{crowd.prefix}{i:03d}",
            protocol=crowd.protocol,
            bit_rate=crowd.bit_rate,
            options=crowd.options,
            payload=None if crowd.fresh else good[i * len(good) // crowd.count],
            fresh=crowd.fresh,
            start_us=float(np.floor(draws[i, 5] * US_PER_S)),
            intensity_w_sr=crowd.intensity_w_sr,
            diameter_m=crowd.diameter_m,
            path=_path(crowd, i, draws[i]),
        )
        for i in range(crowd.count)
    ]


def _path(crowd: Crowd, i: int, draw: Floats) -> Path:
    x0, y0, x1, y1 = crowd.area_m
    columns = min(crowd.count, max(1, math.ceil(math.sqrt(crowd.count * (x1 - x0) / (y1 - y0)))))
    rows = math.ceil(crowd.count / columns)
    wide, high = (x1 - x0) / columns, (y1 - y0) / rows
    row, column = divmod((2 * i + 1) * rows * columns // (2 * crowd.count), columns)
    centre = (
        float(x0 + (column + 0.5 + 0.2 * (draw[0] - 0.5)) * wide),
        float(y0 + (row + 0.5 + 0.2 * (draw[1] - 0.5)) * high),
        crowd.z_m,
    )
    if crowd.speed_m_s == 0.0:
        return Still(at_m=centre)
    a, b = float(0.15 + 0.15 * draw[2]) * wide, float(0.15 + 0.15 * draw[3]) * high
    period_s = 2.0 * math.pi * max(a, b) / crowd.speed_m_s
    phase = 360.0 * float(draw[4])
    # Every other one goes round the other way.
    return Sine(
        at_m=centre,
        amplitude_m=(a, b, 0.0),
        period_s=(period_s, period_s, period_s),
        phase_deg=(phase, phase + (90.0 if i % 2 else -90.0), 0.0),
    )
