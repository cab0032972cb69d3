"""`heliograph simulate SCENARIO -o FILE`: make a recording of a scene, with its truth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from heliograph.errors import ConfigError


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(
        prog="heliograph simulate", description="Make a recording (NPZ) of a simulated scene, with its truth."
    )
    made.add_argument("scenario", metavar="SCENARIO", help="built-in scene (five, still, empty) or a scenario file")
    made.add_argument("-o", "--output", required=True, metavar="FILE", help="recording to write (NPZ)")
    made.add_argument("--truth", default=None, metavar="FILE", help="what was really there, as JSON lines")
    made.add_argument("--seed", type=int, default=0, metavar="N", help="of all that is random (0)")
    made.add_argument("--duration", type=float, default=10.0, metavar="S", help="seconds (10)")
    return made


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    arguments = parser().parse_args(argv)
    if not 0 <= arguments.seed < 2**32:
        raise ConfigError(f"--seed must be in [0, {2**32 - 1}], not {arguments.seed}")
    if not 0 < arguments.duration <= 1e6:
        raise ConfigError(f"--duration must be in (0, 1000000] s, not {arguments.duration:g}")
    from heliograph_services.event_source.simulation.write import simulate  # noqa: PLC0415 - not needed for --help

    truth = None if arguments.truth is None else Path(arguments.truth)
    written = simulate(arguments.scenario, Path(arguments.output), truth, arguments.seed, arguments.duration)
    print(
        f"{arguments.output}: {written.events} events, {written.frames} frames sent, stream {written.stream}",
        file=sys.stderr,
    )
    return 0
