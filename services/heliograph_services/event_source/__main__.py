"""`heliograph-event-source`: a camera, a recording or the simulator, brought to the bus."""

from __future__ import annotations

import sys
from typing import Final

from heliograph.core import Context
from heliograph.shell.source import Source, Stream, main_of_source
from heliograph_services.event_source.config import EventSourceConfig


def _make(config: EventSourceConfig, context: Context) -> Stream:
    from heliograph_services.event_source.stream import open_stream  # noqa: PLC0415 - numba, not needed for --help

    return open_stream(config, context)


SOURCE: Final = Source(
    kind="event_source",
    about="Brings one camera to the bus: raw events for the decoder beside it, onsets for the tracker.",
    config=EventSourceConfig,
    make=_make,
)


def main() -> int:
    """Run the source; return its exit status."""
    return main_of_source(SOURCE)


if __name__ == "__main__":
    sys.exit(main())
