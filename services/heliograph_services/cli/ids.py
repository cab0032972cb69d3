"""`heliograph ids`: who is there, where, and what they say; a client of a running site like any other.

On a terminal a table that follows; with `--json` one object a line. With `--json --frames --until-end` a replayed
recording gives the lines of `heliograph decode --json --frames`, byte for byte, without its summary.
"""

from __future__ import annotations

import argparse
import functools
import math
import os
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

from heliograph.errors import BusError, ConfigError
from heliograph.messages import Identification, Link, Message
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.site import BusLinks, load_site
from heliograph.wire import SCHEMAS
from heliograph_services.cli.in_order import InOrder
from heliograph_services.cli.lines import dump, for_people, lines_of

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
_WAIT_S: Final = 0.1
_FORGET_S: Final = 10.0
# The end of a text that stands beside the other columns in 80.
_TEXT_SHOWN: Final = 18


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    arguments = _parser().parse_args(argv)
    site_name, links = _where(arguments)
    stop = Stop()
    stop.install()
    table = _Table() if _wants_table(arguments) else None
    with connected(client_config(links, wait=arguments.wait), site_name, f"client/{os.getpid()}", stop) as bus:
        if bus is None:
            return 0
        try:
            follow(bus, arguments, stop, table)
        finally:
            if table is not None:
                table.close()
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="heliograph ids", description=__doc__)
    parser.add_argument("site", nargs="?", metavar="SITE.toml", help="where to find the bus (or --connect, --name)")
    parser.add_argument("--connect", metavar="ENDPOINT", help=f"a router of the site (default: {DEFAULT_ENDPOINT})")
    parser.add_argument("--name", metavar="SITE", help="the site's name, where no file is given (default: *)")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    parser.add_argument("--frames", action="store_true", help="with --json: every accepted frame too")
    parser.add_argument("--links", action="store_true", help="how well each track is read, once a second (for aiming)")
    parser.add_argument("--refreshed", action="store_true", help="with --json: repeated states too")
    parser.add_argument("--duration", type=float, metavar="S", help="end after so many seconds")
    parser.add_argument("--until-end", action="store_true", help="end when a replayed recording has been decoded")
    parser.add_argument("--wait", action="store_true", help="wait for a router rather than fail without one")
    return parser


def _where(arguments: argparse.Namespace) -> tuple[str, BusLinks]:
    if arguments.site:
        site = load_site(arguments.site)
        links = BusLinks(connect=(arguments.connect,)) if arguments.connect else site.bus
        return arguments.name or site.site, links
    if arguments.name is None:
        raise ConfigError("give SITE.toml, or --name SITE (and --connect ENDPOINT)")
    return arguments.name, BusLinks(connect=(arguments.connect or DEFAULT_ENDPOINT,))


def _wants_table(arguments: argparse.Namespace) -> bool:
    return not arguments.json and sys.stdout.isatty()


def follow(bus: Bus, arguments: argparse.Namespace, stop: Stop, table: _Table | None) -> None:
    """Print what the site says until the end that was asked for.

    Raises:
        BusError: this reader was too slow.
    """
    wanted = {"frames": arguments.frames, "link": arguments.links or table is not None}
    names = ["ids", "messages", "progress", *(name for name, is_wanted in wanted.items() if is_wanted)]
    inbox = bus.subscribe({name: SCHEMAS[name] for name in names})
    deadline = math.inf if arguments.duration is None else time.monotonic() + arguments.duration
    ordered = InOrder(names, waits=arguments.until_end)
    show = table.take if table is not None else functools.partial(_print, arguments)
    while not stop and not ordered.ended and (now := time.monotonic()) < deadline:
        sample = inbox.get(_WAIT_S)
        opened = bus.open(sample) if sample else None
        if opened is not None:
            ordered.put(*opened, now)
        elif table is not None:
            table.refresh()
        for message in ordered.take(now):
            show(message)
    for message in ordered.rest():
        show(message)
    if inbox.dropped:
        raise BusError(f"too slow: {sum(inbox.dropped.values())} messages were dropped here")
    if ordered.missing:
        raise BusError(f"{sum(ordered.missing.values())} messages were lost on the way: {dict(ordered.missing)}")


def _print(arguments: argparse.Namespace, message: Message) -> None:
    for line in lines_of(message, frames=arguments.frames, refreshed=arguments.refreshed, links=arguments.links):
        print(dump(line) if arguments.json else for_people(line), flush=True)


class _Table:
    """The live table of a terminal."""

    def __init__(self) -> None:
        from rich.console import Console  # noqa: PLC0415 - only on a terminal
        from rich.live import Live  # noqa: PLC0415

        self._rows: dict[tuple[str, str], tuple[Identification, float]] = {}
        self._texts: dict[str, str] = {}
        self._links: dict[tuple[str, str], Link] = {}
        self._live = Live(console=Console(), refresh_per_second=8, get_renderable=self._render)
        self._live.start()

    def take(self, message: Message) -> None:
        """Take note of a state, a text, or how well a track is read."""
        if isinstance(message, Identification):
            self._rows[message.camera, message.track] = (message, time.monotonic())
        elif isinstance(message, Link):
            self._links[message.camera, message.track] = message
        else:
            text = getattr(message, "text", None)
            if text is not None:
                track = getattr(message, "track", "")
                self._texts[track] = (self._texts.get(track, "") + text)[-_TEXT_SHOWN:]

    def refresh(self) -> None:
        """Forget who has long been lost."""
        now = time.monotonic()
        gone = [key for key, (state, seen) in self._rows.items() if state.lost and now - seen > _FORGET_S]
        for key in gone:
            del self._rows[key]
        for key in self._links.keys() - self._rows.keys():
            del self._links[key]

    def _render(self) -> Any:
        from rich.box import SIMPLE_HEAD  # noqa: PLC0415
        from rich.table import Table  # noqa: PLC0415

        # In 80 columns the text gives way, and nothing else.
        table = Table(title="beacons", pad_edge=False, collapse_padding=True, box=SIMPLE_HEAD)
        for name, width in (("beacon", 6), ("camera", 6)):
            table.add_column(name, no_wrap=True, min_width=width, max_width=18)
        for name, width in (("x px", 6), ("y px", 6), ("conf", 4), ("SNR dB", 6), ("MAR", 4), ("age s", 5)):
            table.add_column(name, justify="right", no_wrap=True, min_width=width)
        table.add_column("text", justify="right", no_wrap=True)
        for state, seen in sorted(self._rows.values(), key=lambda row: (row[0].beacon, row[0].track)):
            age_s = time.monotonic() - seen
            link = self._links.get((state.camera, state.track))
            table.add_row(
                f"{state.beacon} (not alone)" if state.duplicates else state.beacon,
                state.camera,
                f"{state.x_px:.1f}",
                f"{state.y_px:.1f}",
                f"{state.confidence:.2f}",
                f"{link.snr_db:.0f}" if link and link.snr_db is not None else "-",
                f"{link.mar_estimate:.2f}" if link and link.mar_estimate is not None else "-",
                f"{age_s:.1f}" if not state.lost else "lost",
                self._texts.get(state.track, "").replace("\n", " "),
                style="dim" if state.lost else "",
            )
        return table

    def close(self) -> None:
        """Leave the terminal as it was."""
        self._live.stop()
