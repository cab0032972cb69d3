"""`heliograph-metrics-sink`: counts what a site's decoders publish, and keeps it in a file."""

from __future__ import annotations

import sys
from typing import Final

from heliograph import truth
from heliograph.core import Context, Core
from heliograph.shell.run import Service, main_of
from heliograph_services.metrics_sink.config import MetricsSinkConfig


def _make(config: MetricsSinkConfig, context: Context) -> Core:
    from heliograph_services.metrics_sink.service import make_core  # noqa: PLC0415 - not needed for --help

    return make_core(config, context)


# A decoder sends a thousand windows a second: 16 s of them, 20 MB, in which the disk or the processor may be elsewhere.
QUEUE: Final = 16_384

SERVICE: Final = Service(
    kind="metrics_sink",
    about="Keeps counts, refusals and, where the truth is known, accuracy of a site.",
    config=MetricsSinkConfig,
    make=_make,
    inputs={
        "frames": False,
        "ids": False,
        "messages": False,
        "link": False,
        "tracks": False,
        "health": False,
        "truth": False,
    },
    timed="frames",
    queue=QUEUE,
    extra_schemas=truth.SCHEMAS,
)


def main() -> int:
    """Run the service; return its exit status."""
    return main_of(SERVICE)


if __name__ == "__main__":
    sys.exit(main())
