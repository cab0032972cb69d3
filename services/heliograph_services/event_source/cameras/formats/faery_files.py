"""AEDAT4 and ES, read by faery (LGPL-3).

faery raises RuntimeError where a file is damaged (after it has given what came before) and panics where it has a hole
of its own; a panic reaches Python as a child of BaseException. Both end a file here: what came before it counts. Times
are kept as they are in the file (faery's `zero_t0` concerns its writers). ES has its origin in the lower left corner:
faery turns it over, so that y grows downwards like everywhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final, TypeVar

import numpy as np

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.aedat4_header import check_aedat4
from heliograph_services.event_source.cameras.formats.contract import Chunk, Size, settled_size

T = TypeVar("T")
_END: Final = object()
# What faery says when a file ends in the middle of something.
_SHORT: Final = "failed to fill whole buffer"


class _Damaged(Exception):  # noqa: N818 - never leaves this module
    """faery gave up; the text is its reason."""


def _guarded(work: Callable[[], T]) -> T:
    """Return what faery returns.

    Raises:
        _Damaged: for every way in which it fails.
    """
    try:
        return work()
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:  # noqa: BLE001 - a panic of the Rust side is no Exception
        raise _Damaged(" ".join(str(error).split())[:160] or type(error).__name__) from None


class _FaeryReader:
    """What both formats share."""

    kind: ClassVar[str]  # faery's name of the format

    def __init__(self, path: Path, given: Size) -> None:
        self._path = path
        if self.kind == "aedat":
            check_aedat4(path)
        try:
            found = _guarded(lambda: self._decoder().dimensions())
        except _Damaged as damage:
            raise FileError(f"{path}: {damage}") from None
        self.size = settled_size(path, Size(int(found[0]), int(found[1])), given)

    def _decoder(self) -> Any:
        import faery  # noqa: PLC0415 - 0.2 s that other formats and the simulator need not pay

        return faery.events_stream_from_file(self._path, file_type=self.kind)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events (`contract.Reader`)."""
        try:
            packets = _guarded(lambda: iter(self._decoder()))
            while (packet := _guarded(lambda: next(packets, _END))) is not _END:
                yield Chunk(_batch_of(packet))
        except _Damaged as damage:
            reason = Refusal.TRUNCATED if _SHORT in str(damage) else Refusal.DAMAGED
            yield Chunk(EventBatch.empty(), Refusals({reason: 1}))


def _batch_of(packet: Any) -> EventBatch:
    """Return faery's structured array as a batch; times beyond int64 become negative, and are refused as such."""
    return EventBatch(
        np.ascontiguousarray(packet["t"]).view(np.int64),
        np.ascontiguousarray(packet["x"]),
        np.ascontiguousarray(packet["y"]),
        np.ascontiguousarray(packet["on"]),
    )


class Aedat4Reader(_FaeryReader):
    """AEDAT4 (iniVation): the first event stream of the container."""

    kind = "aedat"


class EsReader(_FaeryReader):
    """Event Stream."""

    kind = "es"
