"""The table of cameras: a name, and where it lives; imported only when chosen, so an absent SDK hurts nobody else.

Third parties add rows through the entry-point group `heliograph.cameras`.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final, cast

from heliograph.camera import Camera as CameraFile
from heliograph.camera import parse
from heliograph.core import Context
from heliograph.errors import ConfigError
from heliograph_services.event_source.cameras.contract import Camera
from heliograph_services.event_source.config import EventSourceConfig

CAMERAS: Final[dict[str, tuple[str, str]]] = {
    "recording": ("heliograph_services.event_source.cameras.recording", "RecordingCamera"),
    "simulated": ("heliograph_services.event_source.cameras.simulated", "SimulatedCamera"),
    "images": ("heliograph_services.event_source.cameras.images", "ImagesCamera"),
}
ENTRY_POINTS: Final = "heliograph.cameras"


def names() -> list[str]:
    """Return the names of all cameras, ours first."""
    return [*CAMERAS, *sorted(point.name for point in entry_points(group=ENTRY_POINTS) if point.name not in CAMERAS)]


def open_camera(config: EventSourceConfig, context: Context) -> Camera:
    """Return the camera of a configuration, opened, its first events seen.

    Raises:
        ConfigError: no such backend, or a camera file that contradicts the sensor.
        FileError: the recording cannot be read.
    """
    file = read_camera_file(config.camera_file) if config.camera_file else None
    if config.backend in CAMERAS:
        module, attribute = CAMERAS[config.backend]
        kind = getattr(import_module(module), attribute)
    else:
        found = [point for point in entry_points(group=ENTRY_POINTS) if point.name == config.backend]
        if not found:
            raise ConfigError(f"backend must be one of {', '.join(names())}, not {config.backend!r}")
        kind = found[0].load()
    camera = cast("Camera", kind(config, context))
    if file is not None:
        if (file.width, file.height) != (camera.width, camera.height):
            camera.close()
            raise ConfigError(
                f"{config.camera_file} is for {file.width}x{file.height}, the camera has {camera.width}x{camera.height}"
            )
        camera.intrinsics = file.intrinsics
    return camera


def read_camera_file(path: str) -> CameraFile:
    """Return the camera of a camera file.

    Raises:
        ConfigError: it cannot be read, or `heliograph.camera.parse` refuses it.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise ConfigError(f"camera file {path}: {reason}") from None
    return parse(text, path)
