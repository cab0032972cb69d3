"""`heliograph-beacon-controller`: gives beacons what a site wants them to send, and takes commands for them."""

from __future__ import annotations

import sys
from typing import Final

from heliograph.shell.process import Stop
from heliograph.shell.run import guarded, launch_of
from heliograph_services.beacon_controller.config import BeaconControllerConfig

KIND: Final = "beacon_controller"
ABOUT: Final = "Talks to beacons over their serial lines: sets, arms, sends; puts them right after a reboot."


def main() -> int:
    """Run the service; return its exit status."""

    def work(stop: Stop) -> int:
        launch = launch_of(KIND, ABOUT, BeaconControllerConfig, None)
        from heliograph_services.beacon_controller.service import serve  # noqa: PLC0415 - not needed for --help

        return serve(launch, stop)

    return guarded(work)


if __name__ == "__main__":
    sys.exit(main())
