"""The table of file formats, and how a file's own is found: by its first bytes, then by its name.

Which program decodes what:

- RAW (EVT 2, EVT 3) and DAT by our own kernels. faery reads them exactly when they are sound (it is the witness in the
  tests), but sets times that run backwards silently to the last one, takes a step backwards in EVT 2 for a leap of
  4.8 hours, and gives up a file at the first pixel off the sensor.
- CSV by numpy, since a damaged line must cost that line alone, and times that run backwards must be seen.
- AEDAT4 and ES by faery.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Final, cast

from heliograph.errors import FileError
from heliograph_services.event_source.cameras.formats.contract import Reader, Size

_HERE: Final = "heliograph_services.event_source.cameras.formats"
FORMATS: Final[dict[str, tuple[str, str]]] = {
    "aedat4": (f"{_HERE}.faery_files", "Aedat4Reader"),
    "evt2": (f"{_HERE}.raw", "Evt2Reader"),
    "evt3": (f"{_HERE}.raw", "Evt3Reader"),
    "dat": (f"{_HERE}.dat", "DatReader"),
    "es": (f"{_HERE}.faery_files", "EsReader"),
    "csv": (f"{_HERE}.text", "CsvReader"),
    "npz": (f"{_HERE}.npz", "NpzReader"),
    "mat": (f"{_HERE}.matlab", "MatlabReader"),
}
_BY_MAGIC: Final[tuple[tuple[bytes, str], ...]] = (
    (b"#!AER-DAT4.0", "aedat4"),
    (b"Event Stream", "es"),
    (b"PK\x03\x04", "npz"),
    (b"MATLAB 5.0", "mat"),
)
_BY_SUFFIX: Final = {".dat": "dat", ".csv": "csv", ".txt": "csv"}
# Files whose first bytes must have told their format.
_SUFFIXES_WITH_MAGIC: Final = {".aedat4": "AEDAT4", ".es": "Event Stream", ".npz": "NPZ", ".mat": "MATLAB 5"}
_HEAD_BYTES: Final = 4096


def open_reader(path: Path, name: str, given: Size) -> Reader:
    """Return a reader of a file.

    Args:
        path: of the recording.
        name: a row of `FORMATS`, or "auto".
        given: the sensor's size, as the operator says it.

    Raises:
        FileError: the file is missing, empty, of an unknown format, damaged at its beginning, or lacks its size.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}") from None
    if not head:
        raise FileError(f"{path}: the file is empty")
    module, attribute = FORMATS[_format_of(path, head) if name == "auto" else name]
    return cast("Reader", getattr(import_module(module), attribute)(path, given))


def _format_of(path: Path, head: bytes) -> str:
    for magic, name in _BY_MAGIC:
        if head.startswith(magic):
            return name
    suffix = path.suffix.lower()
    if head.startswith(b"MATLAB 7.3"):
        raise FileError(f"{path}: MATLAB 7.3 files (HDF5) are not read; save it with -v7")
    if suffix in _SUFFIXES_WITH_MAGIC:
        raise FileError(f"{path}: no {_SUFFIXES_WITH_MAGIC[suffix]} file: it begins with {head[:12]!r}")
    if suffix == ".raw":
        from heliograph_services.event_source.cameras.formats.headers import evt_version  # noqa: PLC0415

        return evt_version(path, head)
    if suffix in _BY_SUFFIX:
        return _BY_SUFFIX[suffix]
    raise FileError(f"{path}: unknown format; set format to one of {', '.join(FORMATS)}")
