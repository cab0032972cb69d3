"""NPZ, our own format: `t` int64 microseconds, `x` and `y` uint16, `on` bool, and the scalars `width` and `height`.

A simulated recording may have `cause` int16, what made each event (`simulation/contract.py`); it is not read.

What numpy.savez writes of these arrays is read (other integer types too), and what is written here numpy.load reads.
A member is a .npy file (numpy's format 1.0 to 3.0) in a zip archive. The arrays are streamed side by side, so that a
recording of hours needs no more memory than one of seconds; nothing is unpickled.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch
from heliograph_services.event_source.cameras.formats.contract import CHUNK_EVENTS, Chunk, Size, as_pixels, settled_size

_COLUMNS: Final = (("t", np.int64), ("x", np.uint16), ("y", np.uint16), ("on", np.bool_))
_DAMAGE: Final = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, struct.error)
# A date for the archive's members: the same bytes for the same events.
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_COPY_BYTES: Final = 1 << 20


class NpzReader:
    """An NPZ file; see the module.

    Raises:
        FileError: no archive, an array missing, of a wrong type or length, or no size of the sensor.
    """

    def __init__(self, path: Path, given: Size) -> None:
        self._path = path
        try:
            with zipfile.ZipFile(path) as archive, ExitStack() as stack:
                columns = self._columns(archive, stack)
                self._n = columns[0].n
                sides = [self._scalar(archive, name) for name in ("width", "height")]
        except _DAMAGE as error:
            raise FileError(f"{path}: no NPZ file: {error}") from None
        self.size = settled_size(path, Size(*sides), given)

    def _columns(self, archive: zipfile.ZipFile, stack: ExitStack) -> list[_Column]:
        columns = []
        for name, _ in _COLUMNS:
            if f"{name}.npy" not in archive.NameToInfo:
                raise FileError(f"{self._path}: no array {name!r} in it; t, x, y and on must be")
            columns.append(_Column(self._path, name, stack.enter_context(archive.open(f"{name}.npy"))))
        if len({column.n for column in columns}) > 1:
            raise FileError(f"{self._path}: t, x, y and on must be equally long, not {[c.n for c in columns]}")
        return columns

    def _scalar(self, archive: zipfile.ZipFile, name: str) -> int:
        if f"{name}.npy" not in archive.NameToInfo:
            return 0
        with archive.open(f"{name}.npy") as member:
            column = _Column(self._path, name, member, scalar=True)
            return max(0, int(column.read(1)[0]))

    def chunks(self) -> Iterator[Chunk]:
        """Yield the file's events (`contract.Reader`)."""
        try:
            with zipfile.ZipFile(self._path) as archive, ExitStack() as stack:
                columns = self._columns(archive, stack)
                for start in range(0, self._n, CHUNK_EVENTS):
                    n = min(CHUNK_EVENTS, self._n - start)
                    t, x, y, on = (column.read(n) for column in columns)
                    yield Chunk(EventBatch(t.astype(np.int64, copy=False), as_pixels(x), as_pixels(y), on > 0))
        except _DAMAGE as error:
            short = isinstance(error, EOFError)
            yield Chunk(EventBatch.empty(), Refusals({Refusal.TRUNCATED if short else Refusal.DAMAGED: 1}))


class _Column:
    """One array of an archive, read piece by piece."""

    def __init__(self, path: Path, name: str, member: IO[bytes], *, scalar: bool = False) -> None:
        self._member = member
        try:
            version = np.lib.format.read_magic(member)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(member)
        except _DAMAGE:
            raise
        except Exception as error:  # noqa: BLE001 - numpy's parser of headers raises what Python's own parsers raise
            raise FileError(f"{path}: {name}: {' '.join(str(error).split())[:120]}") from None
        whole = shape in {(), (1,)} if scalar else len(shape) == 1
        if dtype.kind not in "iub" or not whole:
            wanted = "a whole number" if scalar else "a row of whole numbers"
            raise FileError(f"{path}: {name} must be {wanted}, not {dtype}{shape}")
        self._dtype = dtype
        self.n: int = 1 if scalar else shape[0]

    def read(self, n: int) -> npt.NDArray[Any]:
        """Return the next n elements.

        Raises:
            EOFError: there are fewer.
        """
        data = self._member.read(n * self._dtype.itemsize)
        if len(data) < n * self._dtype.itemsize:
            raise EOFError("the file ends within an array")
        return np.frombuffer(data, self._dtype).astype(self._dtype.newbyteorder("="), copy=False)


def write_npz(path: Path, width: int, height: int, batches: Iterable[EventBatch]) -> int:
    """Write events as an NPZ file and return their number; memory does not grow with it.

    Args:
        path: where; an existing file is replaced once the new one is whole.
        width: of the sensor, pixels.
        height: of the sensor, pixels.
        batches: events in order of time.

    Raises:
        FileError: the file cannot be written.
    """
    rows = ((batch.t_us, batch.x_px, batch.y_px, batch.on) for batch in batches)
    return write_columns(path, _COLUMNS, rows, {"width": width, "height": height})


def write_labelled_npz(
    path: Path, width: int, height: int, batches: Iterable[tuple[EventBatch, npt.NDArray[np.int16]]]
) -> int:
    """Write events and the cause of each (int16, array `cause`) as `write_npz` does.

    Raises:
        FileError: the file cannot be written.
    """
    rows = ((batch.t_us, batch.x_px, batch.y_px, batch.on, cause) for batch, cause in batches)
    return write_columns(path, (*_COLUMNS, ("cause", np.int16)), rows, {"width": width, "height": height})


def write_columns(
    path: Path,
    columns: Sequence[tuple[str, npt.DTypeLike]],
    rows: Iterable[Sequence[npt.NDArray[Any]]],
    numbers: Mapping[str, int],
) -> int:
    """Write arrays side by side, and some numbers, as an NPZ file; return the arrays' length.

    Args:
        path: where; an existing file is replaced once the new one is whole.
        columns: name and dtype of each array.
        rows: the next parts of all arrays, equally long.
        numbers: by name.

    Raises:
        FileError: the file cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        with ExitStack() as stack:
            # A zip archive holds its members one after another, so the columns wait in files of their own.
            spools = [stack.enter_context(TemporaryFile(dir=path.parent)) for _ in columns]
            n = 0
            for arrays in rows:
                n += len(arrays[0])
                for spool, column in zip(spools, arrays, strict=True):
                    spool.write(np.ascontiguousarray(column).data)
            with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                for (name, dtype), spool in zip(columns, spools, strict=True):
                    spool.seek(0)
                    _write_member(archive, name, np.dtype(dtype), (n,), spool)
                for name, value in numbers.items():
                    with TemporaryFile() as number:
                        number.write(np.array(value, "<i8").tobytes())
                        number.seek(0)
                        _write_member(archive, name, np.dtype("<i8"), (), number)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise FileError(f"{path}: {error.strerror}") from None
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return n


def _write_member(
    archive: zipfile.ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], data: IO[bytes]
) -> None:
    info = zipfile.ZipInfo(f"{name}.npy", _DATE)
    with archive.open(info, "w", force_zip64=True) as member:
        head = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, head)
        while block := data.read(_COPY_BYTES):
            member.write(block)
