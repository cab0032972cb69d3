"""Prophesee DAT.

A text header, two bytes (type, size of an event), then events of 8 bytes, little-endian::

    t u4 (us)    x: bits 13..0, y: bits 27..14, polarity: bits 31..28 of the second u4

t wraps after 2^32 us = 71.6 minutes: when it falls by more than half of that. The types 0x00 and 0x0C are changes of
brightness. Source: https://docs.prophesee.ai/stable/data/file_formats/dat.html
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.contract import CHUNK_EVENTS, Chunk, Size, settled_size
from heliograph_services.event_source.cameras.formats.headers import read_header_of

_EVENT_BYTES: Final = 8
_TYPES: Final = (0x00, 0x0C)


class DatReader:
    """A DAT file; see the module.

    Raises:
        FileError: no such type or size of events, or no size of the sensor.
    """

    def __init__(self, path: Path, given: Size) -> None:
        self._path = path
        header = read_header_of(path)
        with path.open("rb") as file:
            file.seek(header.end)
            kind = file.read(2)
        if len(kind) < 2 or kind[0] not in _TYPES or kind[1] != _EVENT_BYTES:
            raise FileError(f"{path}: no DAT file of changes: type and size are {kind!r}, not 0x00 or 0x0c and 8")
        self._data_at = header.end + 2
        self.size = settled_size(path, header.size, given)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events (`contract.Reader`)."""
        wraps, last = 0, 0
        try:
            with self._path.open("rb") as file:
                file.seek(self._data_at)
                while data := file.read(CHUNK_EVENTS * _EVENT_BYTES):
                    refused = Refusals({Refusal.TRUNCATED: 1} if len(data) % _EVENT_BYTES else {})
                    words = np.frombuffer(data, "<u4", len(data) // _EVENT_BYTES * 2).reshape(-1, 2)
                    t_us, address = words[:, 0].astype(np.int64), words[:, 1]
                    if len(t_us):
                        wrapped = np.diff(t_us, prepend=last) < -(1 << 31)
                        last = int(t_us[-1])
                        t_us += (wraps + np.cumsum(wrapped)) << 32
                        wraps += int(np.count_nonzero(wrapped))
                    x_px = (address & 0x3FFF).astype(np.uint16)
                    y_px = ((address >> 14) & 0x3FFF).astype(np.uint16)
                    yield Chunk(EventBatch(t_us, x_px, y_px, (address >> 28) > 0), refused)
        except OSError as error:
            raise FileError(f"{self._path}: {error.strerror}") from None
