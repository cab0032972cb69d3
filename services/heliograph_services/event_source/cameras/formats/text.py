"""CSV: one event a line, `t,x,y,on`, whole microseconds; `on` is 1 for brighter and 0 or -1 for darker.

A first line with letters is a header: it names the columns in their order, and may say the size of the sensor as faery
writes it (`t,x@640,y@480,on`). Columns may also be called `timestamp`/`t_us`, `x_px`, `y_px`, `p`/`polarity`. Columns
are parted by commas, semicolons, tabs or blanks. A line that is no event is refused, and costs that line alone.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.contract import Chunk, Size, as_pixels, settled_size

_NAMES: Final = {
    "t": "t", "t_us": "t", "time": "t", "timestamp": "t", "x": "x", "x_px": "x", "y": "y", "y_px": "y",
    "on": "on", "p": "on", "polarity": "on",
}  # fmt: skip
_DEFAULT: Final = ("t", "x", "y", "on")
_PARTS: Final = re.compile(r"[,;\t ]+")
# Characters read at once: some 50,000 lines.
_BLOCK: Final = 1 << 20
# A line of four numbers; a longer one is no line of events, and must not be gathered without end.
_LINE_LIMIT: Final = 1 << 16
_INT64: Final = np.iinfo(np.int64)


class CsvReader:
    """A CSV file; see the module.

    Raises:
        FileError: a header without the four columns, or no size of the sensor.
    """

    def __init__(self, path: Path, given: Size) -> None:
        self._path = path
        with path.open("rb") as file:
            first = file.readline(_LINE_LIMIT)
        text = first.decode("ascii", "replace").strip().lower()
        self._data_at = 0
        self._order: tuple[str, ...] = _DEFAULT
        found = Size(0, 0)
        if re.search("[a-z]", text):
            self._data_at = len(first)
            self._order, found = _header(path, text)
        self.size = settled_size(path, found, given)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events (`contract.Reader`)."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._data_at)
                rest = b""
                while block := file.read(_BLOCK):
                    lines, newline, rest = (rest + block).rpartition(b"\n")
                    if newline:
                        yield self._chunk(lines)
                    elif len(rest) > _LINE_LIMIT:
                        raise FileError(f"{self._path}: no CSV file: a line of more than {_LINE_LIMIT} characters")
                if rest:
                    yield self._chunk(rest)
        except OSError as error:
            raise FileError(f"{self._path}: {error.strerror}") from None

    def _chunk(self, lines: bytes) -> Chunk:
        rows, refused = _rows(lines, len(self._order))
        t_us, x, y, on = (rows[:, self._order.index(name)] for name in _DEFAULT)
        batch = EventBatch(np.ascontiguousarray(t_us), as_pixels(x), as_pixels(y), on > 0)
        return Chunk(batch, Refusals({Refusal.DAMAGED: refused} if refused else {}))


def _header(path: Path, text: str) -> tuple[tuple[str, ...], Size]:
    names, sides = [], {"x": 0, "y": 0}
    for part in _PARTS.split(text):
        word, _, side = part.partition("@")
        name = _NAMES.get(word, word)
        names.append(name)
        if side.isdigit() and name in sides:
            sides[name] = int(side[:9])
    if any(names.count(name) != 1 for name in _DEFAULT):
        raise FileError(f"{path}: the header must name t, x, y and on once each, not {text[:80]!r}")
    return tuple(names), Size(sides["x"], sides["y"]) if all(sides.values()) else Size(0, 0)


def _rows(lines: bytes, columns: int) -> tuple[npt.NDArray[np.int64], int]:
    """Return (n, columns) int64 and the number of lines that are no such row."""
    plain = lines.translate(_TO_COMMAS).rstrip(b",\n")
    if plain:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                numbers = np.fromstring(plain.replace(b"\n", b",").decode("ascii"), np.int64, sep=",")
            # Whether the numbers fill the lines evenly must be seen line by line only where the sum says no.
            if len(numbers) == columns * (plain.count(b"\n") + 1) and _even(plain, columns):
                return numbers.reshape(-1, columns), 0
        except (ValueError, DeprecationWarning, UnicodeDecodeError):
            pass
    return _rows_one_by_one(lines, columns)


_TO_COMMAS: Final = bytes.maketrans(b"; \t", b",,,")


def _even(plain: bytes, columns: int) -> bool:
    """Whether every line has columns - 1 commas, so that a surplus here cannot hide a lack there."""
    data = np.frombuffer(plain, np.uint8)
    ends = np.append(np.flatnonzero(data == ord("\n")), len(data))
    commas = np.searchsorted(np.flatnonzero(data == ord(",")), ends)
    return bool((np.diff(commas, prepend=0) == columns - 1).all())


def _rows_one_by_one(lines: bytes, columns: int) -> tuple[npt.NDArray[np.int64], int]:
    good, refused = [], 0
    for line in lines.decode("ascii", "replace").split("\n"):
        if not line.strip():
            continue
        try:
            row = [int(word) for word in _PARTS.split(line.strip()) if len(word) <= 20]
        except ValueError:
            row = []
        if len(row) == columns and all(_INT64.min <= number <= _INT64.max for number in row):
            good.append(row)
        else:
            refused += 1
    return np.array(good, np.int64).reshape(-1, columns), refused
