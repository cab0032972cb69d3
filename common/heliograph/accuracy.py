"""What "how right" means: the rules of matching and the ratios, once, for the metrics sink and every study.

The definitions are those of docs/metrics.md. Every ratio takes counts by block, (k,) each, neighbours in time beside
each other, and is a `Share`: counts added, then divided, with a 95 % interval. ::

    MAR_sent     = right / sent                     (of frames that count; visible and in view apart)
    MAR_received = right / (right + wrong + inserted)
    FER          = (sent - right) / sent
    BAR          = bits right by slot / bits sent
    BER          = (bits of matched frames - bits right) / bits of matched frames
    CER          = (sent - right + inserted) / sent (characters; substituted, deleted and inserted)
    goodput      = data bits of right frames / time of the frames that count
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.shares import Share, quotient, share
from heliograph.units import US_PER_S

# A published frame matches a sent one within max(GATE_PX, the blob's radius) of its place.
GATE_PX: Final = 5.0
# A frame counts from max(GRACE_US, GRACE_FRAMES frames) after its visible interval began; before it is acquisition.
GRACE_US: Final = 500_000
GRACE_FRAMES: Final = 5
# Half a frame is never more than a second: the longest frames (11 bits at 10 bit/s) stay below, and a damaged
# frame_t0_us cannot widen the gate.
HALF_LIMIT_US: Final = US_PER_S
# Two beacons are a close pair within this many blob diameters.
CLOSE_DIAMETERS: Final = 2.0


def mar_sent(right: npt.ArrayLike, sent: npt.ArrayLike) -> Share:
    """Return the share of the frames sent that were read right."""
    return share(right, sent)


def mar_received(right: npt.ArrayLike, wrong: npt.ArrayLike, inserted: npt.ArrayLike) -> Share:
    """Return the share of the frames published that are right."""
    return share(right, np.asarray(right) + np.asarray(wrong) + np.asarray(inserted))


def frame_errors(right: npt.ArrayLike, sent: npt.ArrayLike) -> Share:
    """Return the share of the frames sent that were not read right (FER)."""
    return share(np.asarray(sent) - np.asarray(right), sent)


def bits_right(right_bits: npt.ArrayLike, sent_bits: npt.ArrayLike) -> Share:
    """Return the share of the bits sent that were read right by slot (BAR); a missing frame has none right."""
    return share(right_bits, sent_bits)


def bit_errors(right_bits: npt.ArrayLike, matched_bits: npt.ArrayLike) -> Share:
    """Return the share of wrong bits by slot among the frames that a published one matches (BER)."""
    return share(np.asarray(matched_bits) - np.asarray(right_bits), matched_bits)


def character_errors(right: npt.ArrayLike, inserted: npt.ArrayLike, sent: npt.ArrayLike) -> Share:
    """Return wrong, missing and inserted characters over characters sent (CER); insertions can lift it above 1."""
    errors = np.asarray(sent) - np.asarray(right) + np.asarray(inserted)
    return share(errors, sent) if errors.sum() <= np.sum(sent) else quotient(errors, sent)


def goodput_bit_s(right_payload_bits: npt.ArrayLike, counted_us: npt.ArrayLike) -> Share:
    """Return data bits of right frames a second of frames that count; its `n` is microseconds."""
    found = quotient(right_payload_bits, counted_us)
    return Share(found.value * US_PER_S, found.low * US_PER_S, found.high * US_PER_S, found.n)
