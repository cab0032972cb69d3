"""Prophesee RAW: EVT 2.0 (words of 32 bits) and EVT 3.0 (words of 16 bits), little-endian, type in the top four bits.

EVT 2.0::

    0 CD_OFF, 1 CD_ON   tttttt xxxxxxxxxxx yyyyyyyyyyy    t: low 6 bits of the time
    8 TIME_HIGH         28 bits: bits 33 .. 6 of the time; it wraps after 2^34 us = 4.8 hours

EVT 3.0, a small machine with the state (y, base, polarity, time)::

    0 ADDR_Y       y = bits 10..0               2 ADDR_X        event at x = bits 10..0, polarity = bit 11
    3 VECT_BASE_X  base = bits 10..0, polarity = bit 11
    4 VECT_12, 5 VECT_8   events at base + i for the bits i that are set; base += 12 or 8
    6 TIME_LOW     bits 11..0 of the time       8 TIME_HIGH     bits 23..12; wraps after 2^24 us = 16.8 s

All other types (triggers, continued and vendor words) carry no change of brightness. Words before the first TIME_HIGH
have no time and are left out. A TIME_HIGH that falls by more than half its range has wrapped; one that falls by less is
a time that runs backwards, which the recording camera sees and counts.

Source: https://docs.prophesee.ai/stable/data/encoding_formats/evt2.html and .../evt3.html
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.contract import CHUNK_EVENTS, Chunk, Size, settled_size
from heliograph_services.event_source.cameras.formats.headers import read_header_of

_VECTOR: Final = 12  # most events that one word of EVT 3 can bring


@numba.njit(cache=True, nogil=True)
def _evt2(words: Any, state: Any, t_us: Any, x_px: Any, y_px: Any, on: Any) -> int:
    """Decode words; state[4] is the last TIME_HIGH (-1: none), state[5] the number of times that it wrapped."""
    high, wraps, n = state[4], state[5], 0
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= 1:
            if high >= 0:
                t_us[n] = (wraps << 34) + (high << 6) + ((word >> 22) & 0x3F)
                x_px[n] = (word >> 11) & 0x7FF
                y_px[n] = word & 0x7FF
                on[n] = kind == 1
                n += 1
        elif kind == 8:
            new = word & 0xFFFFFFF
            if high - new > 1 << 27:
                wraps += 1
            high = new
    state[4], state[5] = high, wraps
    return n


@numba.njit(cache=True, nogil=True)
def _evt3(words: Any, state: Any, t_us: Any, x_px: Any, y_px: Any, on: Any) -> int:
    """Decode words; state: y, base, polarity, TIME_LOW, TIME_HIGH (-1: none), times that TIME_HIGH wrapped."""
    y, base, polarity, low, high, wraps = state[0], state[1], state[2], state[3], state[4], state[5]
    n = 0
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 12
        if kind == 0:
            y = word & 0x7FF
        elif kind == 2:
            if high >= 0:
                t_us[n] = (wraps << 24) + (high << 12) + low
                x_px[n] = word & 0x7FF
                y_px[n] = y
                on[n] = (word >> 11) & 1
                n += 1
        elif kind == 3:
            base = word & 0x7FF
            polarity = (word >> 11) & 1
        elif kind in (4, 5):
            bits = word & (0xFFF if kind == 4 else 0xFF)
            x = base
            base += 12 if kind == 4 else 8
            while bits != 0 and high >= 0:
                if bits & 1:
                    t_us[n] = (wraps << 24) + (high << 12) + low
                    x_px[n] = x
                    y_px[n] = y
                    on[n] = polarity
                    n += 1
                bits >>= 1
                x += 1
        elif kind == 6:
            low = word & 0xFFF
        elif kind == 8:
            new = word & 0xFFF
            wraps += high - new > 1 << 11
            # The low bits start anew with every step of the high ones.
            low = low if new == high else 0
            high = new
    state[0], state[1], state[2], state[3], state[4], state[5] = y, base, polarity, low, high, wraps
    return n


class _RawReader:
    """What both versions share: the header, blocks of whole words, and a kernel with its state."""

    dtype: ClassVar[str]
    events_a_word: ClassVar[int]
    kernel: ClassVar[Callable[..., int]]

    def __init__(self, path: Path, given: Size) -> None:
        self._path = path
        header = read_header_of(path)
        self._data_at = header.end
        self.size = settled_size(path, header.size, given)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events (`contract.Reader`)."""
        state = np.array([0, 0, 0, 0, -1, 0], np.int64)  # -1: no TIME_HIGH yet
        word_bytes = np.dtype(self.dtype).itemsize
        try:
            with self._path.open("rb") as file:
                file.seek(self._data_at)
                while data := file.read(CHUNK_EVENTS * word_bytes):
                    whole = len(data) // word_bytes
                    refused = Refusals({Refusal.TRUNCATED: 1} if len(data) % word_bytes else {})
                    words = np.frombuffer(data, self.dtype, whole)
                    yield Chunk(self._decoded(words, state), refused)
        except OSError as error:
            raise FileError(f"{self._path}: {error.strerror}") from None

    def _decoded(self, words: npt.NDArray[Any], state: npt.NDArray[np.int64]) -> EventBatch:
        room = len(words) * self.events_a_word
        out = EventBatch(
            np.empty(room, np.int64), np.empty(room, np.uint16), np.empty(room, np.uint16), np.empty(room, np.bool_)
        )
        n = self.kernel(words, state, out.t_us, out.x_px, out.y_px, out.on)
        # A copy, so that what is kept of a chunk does not hold the room for all that it might have had.
        return out.part(0, n) if n > room // 2 else _copy(out.part(0, n))


def _copy(b: EventBatch) -> EventBatch:
    return EventBatch(b.t_us.copy(), b.x_px.copy(), b.y_px.copy(), b.on.copy())


class Evt2Reader(_RawReader):
    """EVT 2.0."""

    dtype = "<u4"
    events_a_word = 1
    kernel = staticmethod(_evt2)


class Evt3Reader(_RawReader):
    """EVT 3.0."""

    dtype = "<u2"
    events_a_word = _VECTOR
    kernel = staticmethod(_evt3)
