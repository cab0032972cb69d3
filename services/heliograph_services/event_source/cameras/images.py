"""A camera made of images: a file of them (`image_file`), turned into events here, inside the source (`changes`).

All events of an image have its time: what blinks faster than half the images' rate is not seen as it is.
"""

from __future__ import annotations

from heliograph_services.event_source.cameras.changes import ImageChanges
from heliograph_services.event_source.cameras.formats.contract import Reader
from heliograph_services.event_source.cameras.image_file import ImageReader
from heliograph_services.event_source.cameras.recording import RecordingCamera


class ImagesCamera(RecordingCamera):
    """A camera made of a file of images.

    Args:
        config: file, loop, duration_s, window_us, and image_scale, image_threshold, image_max_events.
        context: not used.

    Raises:
        ConfigError: no file is given.
        FileError: it cannot be read, or nothing in it changes.
    """

    def _opened(self) -> Reader:
        config = self._config
        return ImageReader(
            self._path,
            lambda: ImageChanges(config.image_threshold, config.image_scale, config.image_max_events, "step"),
        )
