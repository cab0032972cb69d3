"""Images in a file: NPZ with `images` (n, height, width) uint8 and `t_us` (n,) int64, rising.

Written and read image by image, so that an hour needs no more memory than a second. numpy.load reads what is written
here, and what numpy.savez and numpy.savez_compressed write is read.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import FileError, Refusal, Refusals
from heliograph.events import EventBatch
from heliograph.messages import SENSOR_LIMIT_PX, TIME_LIMIT_US
from heliograph_services.event_source.cameras.changes import Grey, ImageChanges, events_of
from heliograph_services.event_source.cameras.formats.contract import Chunk, Size

_DAMAGE: Final = (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, struct.error)
# A date for the archive's members: the same bytes for the same images.
_DATE: Final = (1980, 1, 1, 0, 0, 0)
_COPY_BYTES: Final = 1 << 20


def holds_images(path: Path) -> bool:
    """Return whether a file is an archive of images; one that cannot be read is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            return "images.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def images_hz(path: Path) -> float:
    """Return how many images a second a sound file of images holds: one over the median of their distances."""
    with np.load(path) as archive:
        return float(1e6 / max(np.median(np.diff(archive["t_us"])), 1.0))


class ImageFile:
    """A file of images, opened for its size.

    Raises:
        FileError: no archive, an array missing, of a wrong type or shape, or no image in it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with zipfile.ZipFile(path) as archive, ExitStack() as stack:
                images, times = self._members(archive, stack)
        except _DAMAGE as error:
            raise FileError(f"{path}: no NPZ file: {error}") from None
        n, height, width = images.shape
        if not 1 <= height <= SENSOR_LIMIT_PX or not 1 <= width <= SENSOR_LIMIT_PX:
            raise FileError(f"{path}: images must be 1 to {SENSOR_LIMIT_PX} pixels a side, not {width}x{height}")
        if n != times.shape[0]:
            raise FileError(f"{path}: images and t_us must be equally many, not {n} and {times.shape[0]}")
        if n < 2:
            raise FileError(f"{path}: changes need at least 2 images, not {n}")
        self.size = Size(width, height)

    def images(self) -> Iterator[tuple[int, Grey | None, Refusals]]:
        """Yield time and image, in order; None and why in place of what is refused.

        An image whose time does not rise is refused, as is one beyond what a clock can have; a file that ends early
        is refused from there on.
        """
        last_us = -TIME_LIMIT_US - 1
        try:
            with zipfile.ZipFile(self._path) as archive, ExitStack() as stack:
                images, times = self._members(archive, stack)
                for _ in range(images.shape[0]):
                    image, t_us = images.next(), int(times.next())
                    if abs(t_us) > TIME_LIMIT_US:
                        yield last_us, None, Refusals({Refusal.TIME_JUMP: 1})
                    elif t_us <= last_us:
                        yield last_us, None, Refusals({Refusal.TIME_BACKWARDS: 1})
                    else:
                        last_us = t_us
                        yield t_us, image, Refusals()
        except _DAMAGE as error:
            short = isinstance(error, EOFError)
            yield last_us, None, Refusals({Refusal.TRUNCATED if short else Refusal.DAMAGED: 1})

    def _members(self, archive: zipfile.ZipFile, stack: ExitStack) -> tuple[_Member, _Member]:
        for name in ("images", "t_us"):
            if f"{name}.npy" not in archive.NameToInfo:
                raise FileError(f"{self._path}: no array {name!r} in it; images and t_us must be")
        images = _Member(self._path, "images", stack.enter_context(archive.open("images.npy")))
        times = _Member(self._path, "t_us", stack.enter_context(archive.open("t_us.npy")))
        if images.dtype != np.uint8 or len(images.shape) != 3:
            raise FileError(f"{self._path}: images must be (n, height, width) uint8, not {images.shape} {images.dtype}")
        if times.dtype.kind not in "iu" or len(times.shape) != 1:
            raise FileError(f"{self._path}: t_us must be (n,) int64, not {times.shape} {times.dtype}")
        return images, times


class _Member:
    """One array of the archive, read along its first axis."""

    def __init__(self, path: Path, name: str, member: IO[bytes]) -> None:
        self._member = member
        try:
            version = np.lib.format.read_magic(member)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            self.shape, by_columns, self.dtype = read(member)
        except _DAMAGE:
            raise
        except Exception as error:  # noqa: BLE001 - numpy's parser of headers raises what Python's own parsers raise
            raise FileError(f"{path}: {name}: {' '.join(str(error).split())[:120]}") from None
        if by_columns and len(self.shape) > 1:
            raise FileError(f"{path}: {name} must be stored by rows (C order), not by columns")

    def next(self) -> npt.NDArray[Any]:
        """Return the next entry.

        Raises:
            EOFError: there is none.
        """
        shape = self.shape[1:]
        wanted = int(np.prod(shape, dtype=np.int64)) * self.dtype.itemsize
        data = self._member.read(wanted)
        if len(data) < wanted:
            raise EOFError("the file ends within an array")
        return np.frombuffer(data, self.dtype).reshape(shape)


class ImageReader:
    """A file of images read as events (`formats.contract.Reader`).

    Args:
        path: of the file.
        changes: makes what compares the images of one pass over the file.

    Raises:
        FileError: as `ImageFile`.
    """

    def __init__(self, path: Path, changes: Callable[[], ImageChanges]) -> None:
        self._file = ImageFile(path)
        self._changes = changes
        self.size = self._file.size

    def chunks(self) -> Iterator[Chunk]:
        """Yield the events of each image, all at its time."""
        changes = self._changes()
        for t_us, image, refused in self._file.images():
            counts = None if image is None else changes.feed(image)
            if counts is not None:
                yield Chunk(events_of(counts, t_us, self.size.width), refused)
            elif refused:
                yield Chunk(EventBatch.empty(), refused)


def write_images(path: Path, width: int, height: int, images: Iterable[tuple[int, Grey]]) -> int:
    """Write images and return their number; memory does not grow with it.

    Args:
        path: where; an existing file is replaced once the new one is whole.
        width: of the sensor, px.
        height: of the sensor, px.
        images: time in us, rising, and (height, width) uint8.

    Raises:
        FileError: the file cannot be written.
        ValueError: an image of another size.
    """
    part = path.with_name(path.name + ".part")
    times: list[int] = []
    try:
        with TemporaryFile(dir=path.parent) as spool:
            # The number of images stands at the head of the array, and is known at its end.
            for t_us, image in images:
                if image.shape != (height, width) or image.dtype != np.uint8:
                    raise ValueError(f"an image must be ({height}, {width}) uint8, not {image.shape} {image.dtype}")
                spool.write(np.ascontiguousarray(image).data)
                times.append(t_us)
            spool.seek(0)
            with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                with _member(archive, "images", (len(times), height, width), "|u1") as member:
                    while block := spool.read(_COPY_BYTES):
                        member.write(block)
                with _member(archive, "t_us", (len(times),), "<i8") as member:
                    member.write(np.array(times, "<i8").tobytes())
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise FileError(f"{path}: {error.strerror}") from None
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return len(times)


def _member(archive: zipfile.ZipFile, name: str, shape: tuple[int, ...], descr: str) -> IO[bytes]:
    member = archive.open(zipfile.ZipInfo(f"{name}.npy", _DATE), "w", force_zip64=True)
    np.lib.format.write_array_header_1_0(member, {"descr": descr, "fortran_order": False, "shape": shape})
    return member
