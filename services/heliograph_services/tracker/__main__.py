"""`heliograph-tracker`: follows targets from onsets, wherever it runs."""

from __future__ import annotations

import sys
from typing import Final

from heliograph.core import Context, Core
from heliograph.shell.run import Service, main_of
from heliograph_services.tracker.config import TrackerConfig


def _make(config: TrackerConfig, context: Context) -> Core:
    from heliograph_services.tracker.core import make_core, warm  # noqa: PLC0415 - numba, not needed for --help

    warm(config.clustering, config.kalman, config.flow)
    return make_core(config, context)


SERVICE: Final = Service(
    kind="tracker",
    about="Follows the targets of one camera, from its onsets.",
    config=TrackerConfig,
    make=_make,
    inputs={"onsets": True, "status": True},
    paced_by="onsets",
)


def main() -> int:
    """Run the service; return its exit status."""
    return main_of(SERVICE)


if __name__ == "__main__":
    sys.exit(main())
