"""Events made of images: what changed in a pixel since its reference, in steps of a threshold.

``D = f(grey) - reference``; where abs(D) is above the threshold there are floor(abs(D) / threshold) events, at least
one and at most `limit`, ON where D is positive. Then the reference is moved:

    step      by so many thresholds, as a pixel of an event camera does (ESIM, Rebecq et al. 2018); what the limit cuts
              off is lost, the reference is then the image's value
    changed   to the image's value where there was an event (gazebo_dvs_plugin, processDelta)
    last      to the image's value everywhere

f is the grey itself (`linear`), or its logarithm (`log`), below 20 of 255 a straight line through 0 that meets it
there: one level of grey is then at most a step of .15, as v2e does (Hu, Liu and Delbruck 2021, section 4.1).
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch

Grey = npt.NDArray[np.uint8]
Counts = npt.NDArray[np.int16]
Scale = Literal["log", "linear"]
Reference = Literal["step", "changed", "last"]

LIN_LOG_GREY: Final = 20.0
# Of a threshold: a pixel that goes to and fro between two greys makes as many events both ways.
_ROUNDING: Final = 1e-9
_RULES: Final[dict[Reference, int]] = {"step": 0, "changed": 1, "last": 2}


def values_of(scale: Scale) -> npt.NDArray[np.float64]:
    """Return f of every grey level, (256,) float64."""
    grey = np.arange(256, dtype=np.float64)
    if scale == "linear":
        return grey
    return np.where(grey < LIN_LOG_GREY, grey * np.log(LIN_LOG_GREY) / LIN_LOG_GREY, np.log(np.maximum(grey, 1.0)))


class ImageChanges:
    """Compares image after image; the first is the first reference.

    Args:
        threshold: in units of f, above 0.
        scale: f.
        limit: events a pixel and image, at most.
        reference: how it is moved.
    """

    def __init__(self, threshold: float, scale: Scale, limit: int, reference: Reference) -> None:
        self._threshold = threshold
        self._values = values_of(scale)
        self._limit = limit
        self._rule = _RULES[reference]
        self._reference: npt.NDArray[np.float64] | None = None

    def feed(self, image: Grey) -> Counts | None:
        """Return (pixels,) int16, the ON events of each pixel, or the OFF events as a negative number.

        None for the first image.

        Args:
            image: (height, width), the same size each time.
        """
        grey = np.ascontiguousarray(image).reshape(-1)
        if self._reference is None:
            self._reference = self._values[grey]
            return None
        counts = np.empty(len(grey), np.int16)
        _compare(grey, self._values, self._reference, self._threshold, self._limit, self._rule, counts)
        return counts


def events_of(counts: Counts, t_us: int, width: int) -> EventBatch:
    """Return the events of one image, all at one time, by rows."""
    pixel = np.flatnonzero(counts)
    count = counts[pixel].astype(np.int64)
    pixel = np.repeat(pixel, np.abs(count))
    return EventBatch(
        np.full(len(pixel), t_us, np.int64),
        (pixel % width).astype(np.uint16),
        (pixel // width).astype(np.uint16),
        np.repeat(count > 0, np.abs(count)),
    )


@numba.njit(cache=True, nogil=True)
def _compare(grey: Any, values: Any, reference: Any, threshold: float, limit: int, rule: int, counts: Any) -> None:
    for i in range(len(grey)):
        value = values[grey[i]]
        change = value - reference[i]
        size = abs(change)
        n = 0
        if size > threshold:
            steps = max(1, int(size / threshold + _ROUNDING))
            n = min(limit, steps)
            if rule != 0 or steps > limit:
                reference[i] = value
            elif change > 0.0:
                reference[i] += n * threshold
            else:
                reference[i] -= n * threshold
        elif rule == 2:
            reference[i] = value
        counts[i] = n if change > 0.0 else -n


def warm() -> None:
    """Compile the kernel, or load it from the cache."""
    changes = ImageChanges(1.0, "linear", 1, "step")
    for _ in range(2):
        changes.feed(np.zeros((1, 1), np.uint8))
