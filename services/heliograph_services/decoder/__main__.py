"""`heliograph-decoder`: reads what the tracked beacons of one camera say; runs beside the camera."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from heliograph.core import Context, Core
from heliograph.errors import ConfigError
from heliograph.shell.run import Service, main_of
from heliograph_services.decoder.config import DecoderConfig


def _make(config: DecoderConfig, context: Context) -> Core:
    from heliograph_services.decoder.core import make_core, warm  # noqa: PLC0415 - numba, not needed for --help

    warm()
    return make_core(config, context, _camera_text(config.camera_file))


def _camera_text(path: str) -> str:
    if not path:
        return ""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"camera_file {path}: {error}") from None


SERVICE: Final = Service(
    kind="decoder",
    about="Reads the beacons of one camera: frames, identifications, messages.",
    config=DecoderConfig,
    make=_make,
    inputs={"events": True, "tracks": True},
    paced_by="events",
    urgent=True,
)


def main() -> int:
    """Run the service; return its exit status."""
    return main_of(SERVICE)


if __name__ == "__main__":
    sys.exit(main())
