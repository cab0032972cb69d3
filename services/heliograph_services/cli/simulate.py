"""`heliograph simulate SCENARIO -o FILE`: make a recording of a scene, with its truth."""

from __future__ import annotations

import argparse
import sys
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heliograph.errors import ConfigError

if TYPE_CHECKING:
    from heliograph_services.event_source.simulation.output.record import Recorded

IMAGES_HZ_MAX: Final = 10_000.0
_COLUMNS: Final = 80  # of a terminal


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    made = argparse.ArgumentParser(
        prog="heliograph simulate",
        description="Make a recording (NPZ) of a simulated scene, with its truth.",
        epilog="built-in scenarios:\n" + _table(list(built_in())),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("scenario", metavar="SCENARIO", help="built-in scenario (below) or a scenario file (TOML)")
    made.add_argument("-o", "--output", required=True, metavar="FILE", help="recording to write (NPZ)")
    made.add_argument("--truth", default=None, metavar="FILE", help="what was really there, as JSON lines")
    made.add_argument("--seed", type=int, default=0, metavar="N", help="of all that is random (0)")
    made.add_argument("--duration", type=float, default=10.0, metavar="S", help="seconds (10)")
    made.add_argument(
        "--fidelity",
        choices=("full", "live"),
        default="full",
        help="how finely the surroundings are rendered (full); lights are always full",
    )
    made.add_argument(
        "--sensor", default="", metavar="NAME", help="instead of the scenario's: a preset, or a TOML file"
    )
    made.add_argument("--mode", default="", metavar="NAME", help="of the sensor's read-out, instead of the scenario's")
    made.add_argument("--labels", action="store_true", help="also write what made each event (array `cause`)")
    made.add_argument("--plot", default=None, metavar="FILE.png", help="a picture of the scene and of the event stream")
    made.add_argument(
        "--images", type=float, default=0.0, metavar="HZ", help="write so many images a second instead of events"
    )
    return made


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    arguments = parser().parse_args(argv)
    if not 0 <= arguments.seed < 2**32:
        raise ConfigError(f"--seed must be in [0, {2**32 - 1}], not {arguments.seed}")
    if not 0 < arguments.duration <= 1e6:
        raise ConfigError(f"--duration must be in (0, 1000000] s, not {arguments.duration:g}")
    if not 0 <= arguments.images <= IMAGES_HZ_MAX:
        raise ConfigError(f"--images must be in [0, {IMAGES_HZ_MAX:g}] Hz, not {arguments.images:g}")
    # Compiled kernels, not needed for --help.
    from heliograph_services.event_source.cameras.senders import Senders  # noqa: PLC0415
    from heliograph_services.event_source.simulation.output.record import Order, record  # noqa: PLC0415

    order = Order(
        scenario=arguments.scenario,
        out=Path(arguments.output),
        truth=None if arguments.truth is None else Path(arguments.truth),
        plot=None if arguments.plot is None else Path(arguments.plot),
        seed=arguments.seed,
        duration_s=arguments.duration,
        fidelity=arguments.fidelity,
        labels=arguments.labels,
        images_hz=arguments.images,
        sensor=arguments.sensor,
        mode=arguments.mode,
    )
    senders = Senders()
    try:
        with _bar(arguments.duration) as progress:
            recorded = record(order, senders, progress)
    finally:
        senders.close()
    refused = sum(senders.refused().values())
    print(f"{order.out}: {summary(recorded)}" + (f", {refused} edges refused" if refused else ""), file=sys.stderr)
    return 0


def summary(recorded: Recorded) -> str:
    """Return what has been recorded, in a line."""
    made = recorded.run
    lost = ", ".join(f"{n} {name}" for name, n in recorded.lost.items())
    what = f"{recorded.images} images" if recorded.images else f"{recorded.events} events ({lost or 'none'} lost)"
    sensor = f"{made.sensor.name} {made.mode}".strip()
    told = f"fidelity {made.fidelity}, sensor {sensor}, seed {made.seed}"
    return f"{what}, {recorded.frames} frames sent, stream {made.stream}, {told}"


def _table(rows: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in rows) + 2
    return "\n".join(
        textwrap.fill(about, _COLUMNS, initial_indent=f"  {name:<{width}}", subsequent_indent=" " * (width + 2))
        for name, about in rows
    )


def built_in() -> Iterator[tuple[str, str]]:
    """Yield the built-in scenarios and what each is about, without importing what would run them."""
    folder = files("heliograph_services.event_source.simulation.world") / "scenarios"
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.name.endswith(".toml"):
            about = str(tomllib.loads(entry.read_text(encoding="utf-8")).get("about", ""))
            words = " ".join(about.split()).partition(". ")[0].rstrip(".")
            yield entry.name.removesuffix(".toml"), words.replace("%", "%%")


@contextmanager
def _bar(duration_s: float) -> Iterator[Callable[[float], None] | None]:
    """Yield what moves a bar on a terminal; None where there is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console  # noqa: PLC0415 - only on a terminal
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415

    words = TextColumn("{task.completed:.1f} of {task.total:g} s")
    with Progress(BarColumn(), words, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=duration_s)
        yield lambda done_s: bar.update(task, completed=min(done_s, duration_s))
