"""The head of an AEDAT4 file, checked before faery sees it: a damaged one makes faery panic, or abort the process.

::

    "#!AER-DAT4.0" CR LF    n u4    n bytes: flatbuffer IOHeader: compression i4, dataTablePosition i8, infoNode string

A flatbuffer begins with the offset of its root table and the identifier "IOHE"; a table begins with the (signed,
subtracted) offset of its vtable: u2 size of the vtable, u2 size of the table, then a u2 offset for each field.
infoNode is XML whose attributes `typeIdentifier` name the streams: EVTS, FRME, IMUS, TRIG; those of an event stream
say its sizeX and sizeY. Source: https://docs.inivation.com/software/software-advanced-usage/file-formats/aedat-4.0.html
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

from heliograph.errors import FileError

_MAGIC: Final = b"#!AER-DAT4.0\r\n"
# Headers have 1 to 20 kB; a megabyte is room for any list of streams.
_HEAD_LIMIT: Final = 1 << 20
_FIELD_INFO: Final = 2
_TYPES: Final = frozenset({"EVTS", "FRME", "IMUS", "TRIG"})
_SIDES: Final = ("sizeX", "sizeY")


def check_aedat4(path: Path) -> None:
    """Return where a file's head is sound.

    Raises:
        FileError: it is not; the text says what is wrong.
    """
    with path.open("rb") as file:
        data = file.read(len(_MAGIC) + 4)
        if not data.startswith(_MAGIC):
            raise FileError(f"{path}: no AEDAT4 file: it begins with {data[:12]!r}")
        size = int.from_bytes(data[len(_MAGIC) :], "little")
        head = file.read(min(size, _HEAD_LIMIT))
    if len(data) < len(_MAGIC) + 4 or len(head) < size:
        raise FileError(f"{path}: the file ends within its header")
    try:
        text = _info_node(head).decode("ascii")
        # Entities could make it grow without end; no recorder writes any.
        if "<!" in text:
            raise ValueError("a declaration in it")
        _check_streams(ET.fromstring(text))  # noqa: S314 - no declarations, hence no entities
    except (ValueError, struct.error, ET.ParseError) as error:
        raise FileError(f"{path}: the AEDAT4 header is damaged: {' '.join(str(error).split())[:120]}") from None


def _info_node(head: bytes) -> bytes:
    """Return the string infoNode of an IOHeader."""
    (table,) = struct.unpack_from("<I", head, 0)
    if head[4:8] != b"IOHE":
        raise ValueError(f"identifier {head[4:8]!r}, not b'IOHE'")
    (back,) = struct.unpack_from("<i", head, table)
    vtable = table - back
    if vtable < 0:
        raise ValueError("a table before the header")
    vtable_size, table_size = struct.unpack_from("<HH", head, vtable)
    if vtable_size < 4 + 2 * (_FIELD_INFO + 1) or vtable + vtable_size > len(head) or table + table_size > len(head):
        raise ValueError("a table outside the header")
    offsets = struct.unpack_from("<HHH", head, vtable + 4)
    if any(offset + width > table_size for offset, width in zip(offsets, (4, 8, 4), strict=True)):
        raise ValueError("a field outside its table")
    if not offsets[_FIELD_INFO]:
        raise ValueError("no infoNode")
    at = table + offsets[_FIELD_INFO]
    at += struct.unpack_from("<I", head, at)[0]
    (length,) = struct.unpack_from("<I", head, at)
    if at + 4 + length > len(head):
        raise ValueError("infoNode outside the header")
    return head[at + 4 : at + 4 + length]


def _check_streams(root: ET.Element) -> None:
    """Raise ValueError where a stream is of no known type, or an event stream has no size."""
    streams = [node for node in root.iter("node") if node.find("attr[@key='typeIdentifier']") is not None]
    for node in streams:
        kind = node.findtext("attr[@key='typeIdentifier']") or ""
        if kind not in _TYPES:
            raise ValueError(f"stream of the type {kind!r}")
        if not (node.get("name") or "").isdigit():
            raise ValueError(f"stream named {node.get('name')!r}")
        if kind == "EVTS" and not all((node.findtext(f".//attr[@key='{side}']") or "").isdigit() for side in _SIDES):
            raise ValueError("an event stream without sizeX and sizeY")
    if not any(node.findtext("attr[@key='typeIdentifier']") == "EVTS" for node in streams):
        raise ValueError("no event stream")
