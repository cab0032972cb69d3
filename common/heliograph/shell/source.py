"""Runs a camera as a process: `main_of_source(Source(...))` is all of a source's `__main__`.

A step is what happened until a camera time, as records ready to be sent; how they leave is `heliograph.shell.pace`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import msgspec

from heliograph.shell.process import Stop, wake_promptly
from heliograph.shell.run import guarded, launch_of

if TYPE_CHECKING:
    from heliograph.core import Context
    from heliograph.errors import Refusals
    from heliograph.messages import Message

ConfigT = TypeVar("ConfigT", bound=msgspec.Struct)


class Step(Protocol):
    """What happened until t1_us."""

    @property
    def t1_us(self) -> int: ...  # noqa: D102
    @property
    def messages(self) -> list[Message]: ...  # noqa: D102
    @property
    def end(self) -> bool: ...  # noqa: D102


class Stream(Protocol):
    """A camera's steps, and its numbers."""

    refusals: Refusals
    counters: dict[str, int]
    gauges: dict[str, float]

    def __iter__(self) -> Iterator[Step]: ...


@dataclass(frozen=True)
class Source(Generic[ConfigT]):
    """What the shell must know of a source.

    Args:
        kind: its name in the site file and on the bus.
        about: one line for `--help`.
        config: its settings; has `camera`, `pace` (1 real time, 0 as fast as possible), `wait_for`
            (services) and `await_s` (how long a paced source waits for them before it begins).
        make: opens the camera, warms kernels.
    """

    kind: str
    about: str
    config: type[ConfigT]
    make: Callable[[ConfigT, Context], Stream]


def main_of_source(source: Source[Any], argv: Sequence[str] | None = None) -> int:
    """Run a source until its stream ends or it is stopped; return its exit status."""

    def work(stop: Stop) -> int:
        launch = launch_of(source.kind, source.about, source.config, argv)
        from heliograph.shell.pace import serve  # noqa: PLC0415 - zenoh and numpy, not needed for --help

        wake_promptly()
        return serve(source, launch, stop)

    return guarded(work)
