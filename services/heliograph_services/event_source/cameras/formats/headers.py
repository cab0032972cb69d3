"""The text header of Prophesee's files (RAW and DAT): lines that begin with `%`, up to `% end` or the first other line.

The size of the sensor stands there in one of three ways, the version of RAW in one of two::

    % geometry 640x480        % format EVT3;height=480;width=640        % Width 640 / % Height 480
    % evt 3.0                 % format EVT3;...

Source: https://docs.prophesee.ai/stable/data/file_formats/raw.html and .../dat.html
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from heliograph.errors import FileError
from heliograph_services.event_source.cameras.formats.contract import Size

# Headers are a few hundred bytes; one that goes on longer is binary data that happens to begin with '%'.
HEADER_LIMIT: Final = 65_536
_GEOMETRY: Final = re.compile(r"geometry\s+(\d{1,5})x(\d{1,5})", re.IGNORECASE)
_WIDTH: Final = re.compile(r"\bwidth[\s=]+(\d{1,5})", re.IGNORECASE)
_HEIGHT: Final = re.compile(r"\bheight[\s=]+(\d{1,5})", re.IGNORECASE)
_EVT: Final = re.compile(r"\bevt\s*([0-9.]+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Header:
    """A header's lines without their `%`, and where the data begin."""

    lines: tuple[str, ...]
    end: int

    @property
    def size(self) -> Size:
        """The sensor's size; 0x0 where the header does not say it."""
        text = "\n".join(self.lines)
        both = _GEOMETRY.search(text)
        if both:
            return Size(int(both[1]), int(both[2]))
        width, height = _WIDTH.search(text), _HEIGHT.search(text)
        return Size(int(width[1]), int(height[1])) if width and height else Size(0, 0)


def read_header(data: bytes) -> Header:
    """Return the header at the beginning of a file; it may be empty.

    Args:
        data: the file's first bytes, at most `HEADER_LIMIT` of them.
    """
    lines: list[str] = []
    at = 0
    while data.startswith(b"%", at):
        stop = data.find(b"\n", at)
        if stop < 0:
            break
        lines.append(data[at + 1 : stop].decode("ascii", "replace").strip())
        at = stop + 1
        if lines[-1] == "end":
            break
    return Header(tuple(lines), at)


def read_header_of(path: Path) -> Header:
    """Return the header of a file.

    Raises:
        FileError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return read_header(file.read(HEADER_LIMIT))
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}") from None


def evt_version(path: Path, head: bytes) -> str:
    """Return "evt2" or "evt3", as the header of a RAW file says.

    Raises:
        FileError: it says nothing, or another version.
    """
    found = _EVT.search("\n".join(read_header(head).lines))
    if not found:
        raise FileError(f"{path}: the header does not say which EVT this is; set format to evt2 or evt3")
    version = found[1].strip(".")
    if version in {"3", "3.0"}:
        return "evt3"
    if version in {"2", "2.0"}:
        return "evt2"
    raise FileError(f"{path}: EVT {version} is not read, only EVT 2.0 and EVT 3.0")
