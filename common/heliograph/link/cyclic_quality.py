"""How well a cyclic code is read, from the state of its demodulator."""

from __future__ import annotations

import numpy as np

from heliograph.link import state
from heliograph.link.contract import LinkQuality
from heliograph.units import US_PER_S


def quality_of(
    at: state.State | None, scanned: tuple[float, float] | None, bit_us: float, mar: float | None
) -> LinkQuality:
    """Return the quality of a link.

    Args:
        at: state of the demodulator; None while there is no clock.
        scanned: events of a transition and background events a slot, where the light is scanned.
        bit_us: nominal length of a bit.
        mar: share of the last second's frames that were read.
    """
    if at is None or at.ints[state.ALIGNED] < 0:
        return LinkQuality(US_PER_S / bit_us, None, None, None, None, mar)
    period = float(at.floats[state.PERIOD])
    jitter_us = float(np.sqrt(at.floats[state.JITTER2])) * bit_us
    burst, background = (float(at.figures[0]), float(at.figures[1])) if scanned is None else scanned
    # Energy of a transition over the background in a slot, half an event of which is never excluded.
    snr_db = 10.0 * float(np.log10(max(burst, 1e-3) / max(background, 0.5)))
    return LinkQuality(US_PER_S / (bit_us * period), snr_db, jitter_us, (1.0 / period - 1.0) * 1e6, burst, mar)
