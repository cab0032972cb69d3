"""What the demo shows: plain lines, or a live table on a terminal."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Final, Protocol, Self

from heliograph.messages import Data, Identification
from heliograph_services.cli.lines import for_people, identification_line

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_TEXT_WIDTH: Final = 24
_LINE_WIDTH: Final = 60


class View(Protocol):
    """Shows what arrives."""

    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def state(self, message: Identification) -> None:
        """Show the state of a beacon."""
        ...

    def text(self, message: Data) -> None:
        """Show what a beacon said."""
        ...

    def note(self, line: str) -> None:
        """Show a line about the system."""
        ...


class Lines:
    """A line for each change; for pipes, logs and small terminals."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for name, text in self._texts.items():
            if text:
                self.note(f"{name} says {text!r}")
        self._texts.clear()

    def state(self, message: Identification) -> None:
        """Print a change; a refreshed state is no news."""
        if message.change != "refreshed":
            self.note(for_people(identification_line(message)))

    def text(self, message: Data) -> None:
        """Print what was said once it fills a line."""
        name = message.beacon or message.protocol
        text = self._texts.get(name, "") + (message.text if message.text is not None else (message.data or b"").hex())
        self._texts[name] = text
        if len(text) >= _LINE_WIDTH:
            self.note(f"{name} says {text!r}")
            self._texts[name] = ""

    def note(self, line: str) -> None:
        """Print a line at once."""
        print(line, flush=True)


class Table:
    """A table of the beacons that follows."""

    def __init__(self) -> None:
        from rich.console import Console  # noqa: PLC0415 - only on a terminal
        from rich.live import Live  # noqa: PLC0415

        self._rows: dict[str, Identification] = {}
        self._texts: dict[str, str] = {}
        self._live = Live(console=Console(), refresh_per_second=8, get_renderable=self._render)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def state(self, message: Identification) -> None:
        """Take a beacon's state; a track that was lost does not hide the one that took its place."""
        shown = self._rows.get(message.beacon)
        if not message.lost or shown is None or shown.track == message.track:
            self._rows[message.beacon] = message

    def text(self, message: Data) -> None:
        """Keep the end of what was said."""
        name = message.beacon or message.protocol
        self._texts[name] = (self._texts.get(name, "") + (message.text or ""))[-_TEXT_WIDTH:]

    def note(self, line: str) -> None:
        """Print a line above the table."""
        self._live.console.print(line, highlight=False)

    def _render(self) -> RichTable:
        from rich.table import Table as RichTable  # noqa: PLC0415 - only on a terminal

        table = RichTable(title="heliograph: who blinks, where, and what it says", pad_edge=False)
        table.add_column("beacon", no_wrap=True)
        table.add_column("protocol", no_wrap=True)
        for name in ("x px", "y px", "conf", "frames"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("says", width=_TEXT_WIDTH, no_wrap=True)
        for name in sorted(self._rows):
            row = self._rows[name]
            protocol = row.protocol if row.payload is None else f"{row.protocol} {row.payload}"
            place = (f"{row.x_px:.1f}", f"{row.y_px:.1f}", "lost" if row.lost else f"{row.confidence:.2f}")
            said = self._texts.get(name, "").replace("\n", " ")
            table.add_row(name, protocol, *place, str(row.frames_used), said, style="dim" if row.lost else "")
        return table
