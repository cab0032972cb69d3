"""MATLAB v5 recordings of a beacon: `event` (+1 brighter, -1 darker) and `event_t` (seconds), no coordinates.

The layout of the recordings published with Z. Wang et al., "Smart visual beacons with asynchronous optical
communications using event cameras", IROS 2022: the events of one blob, cropped already, so the sensor has one pixel.
Read by scipy (extra `matlab`).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch, Flags, Times
from heliograph.messages import TIME_LIMIT_US
from heliograph.units import US_PER_S
from heliograph_services.event_source.cameras.formats.contract import CHUNK_EVENTS, Chunk, Size, settled_size

_NAMES: Final = ("event", "event_t")
# scipy reads whole arrays: 3 GB of them at this number of events. Longer recordings belong into a streamed format.
_EVENTS_LIMIT: Final = 200_000_000


class MatlabReader:
    """A beacon recording; see the module.

    Raises:
        FileError: scipy is absent, or the file is damaged, lacks an array, or has one of a wrong shape.
    """

    def __init__(self, path: Path, given: Size) -> None:
        self._path = path
        self._on, self._t_us, self._refused = _loaded(path)
        self.size = settled_size(path, Size(1, 1), given)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events (`contract.Reader`)."""
        if self._refused:
            yield Chunk(EventBatch.empty(), Refusals({Refusal.DAMAGED: self._refused}))
        for start in range(0, len(self._t_us), CHUNK_EVENTS):
            t_us = self._t_us[start : start + CHUNK_EVENTS]
            place = np.zeros(len(t_us), np.uint16)
            yield Chunk(EventBatch(t_us, place, place, self._on[start : start + CHUNK_EVENTS]))


def _loaded(path: Path) -> tuple[Flags, Times, int]:
    """Return polarity, time, and the number of entries that are neither +1 nor -1 or have no time."""
    try:
        from scipy.io import loadmat, whosmat  # noqa: PLC0415 - an extra, and half a second
    except ImportError:
        raise FileError(f"{path}: MATLAB files need scipy: pip install 'heliograph[matlab]'") from None
    try:
        sizes = {name: int(np.prod(shape)) for name, shape, _ in whosmat(path)}
        missing = [name for name in _NAMES if name not in sizes]
        if missing:
            raise FileError(f"{path}: no array {missing[0]!r} in it, only {', '.join(sorted(sizes)) or 'none'}")
        if sizes["event"] != sizes["event_t"] or sizes["event"] > _EVENTS_LIMIT:
            raise FileError(
                f"{path}: event and event_t must be equally long, at most {_EVENTS_LIMIT}, not"
                f" {sizes['event']} and {sizes['event_t']}"
            )
        arrays = loadmat(path, variable_names=list(_NAMES))
        event, event_t = (_row(path, name, arrays[name]) for name in _NAMES)
    except FileError:
        raise
    except Exception as error:  # noqa: BLE001 - scipy raises whatever a damaged file makes it stumble over
        raise FileError(
            f"{path}: no sound MATLAB 5 file: {type(error).__name__}: {' '.join(str(error).split())[:120]}"
        ) from None
    with np.errstate(all="ignore"):  # what is no number, or too large a one, is sorted out in the next line
        t_us = np.rint(event_t * US_PER_S)
        sound = (np.abs(event) == 1) & (np.abs(t_us) <= TIME_LIMIT_US)
    return event[sound] > 0, t_us[sound].astype(np.int64), len(sound) - int(np.count_nonzero(sound))


def _row(path: Path, name: str, array: Any) -> npt.NDArray[np.float64]:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        raise FileError(f"{path}: {name} must hold numbers")
    return array.ravel().astype(np.float64)
