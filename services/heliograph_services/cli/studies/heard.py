# ruff: noqa: ARG002 - an ear has the shape of `TrackLinks`, and hears more than it heeds
"""What a site's decoder hears of a scene, track by track: recorded once, so that any receiver can listen to it.

Source, tracker and decoder run as they are, with one difference: the tracks' receivers (`TrackLinks`) are replaced by
ears that keep every event with its depth in the image, and read nothing. So regions, routing and centring are those of
a scene in which nobody is read, and what a receiver would have been fed is known to the event.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from unittest import mock

import numpy as np

from heliograph.core import Context
from heliograph.errors import Refusals
from heliograph.events import Flags, Times
from heliograph.messages import Message
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.decoder import core, following
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.feeding import NEVER_DUE_US
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import Decided, TrackLinks
from heliograph_services.decoder.region_state import Depths
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core as make_tracker

# The decoder's window, and the step with which receivers are asked whether they have given up.
STEP_US = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """The events of one candidate, from from_us until until_us.

    Args:
        t_us: (n,) int64.
        on: (n,) bool.
        depth: (n,) uint8, see `heliograph_services.decoder.routing`.
        from_us: when it was begun.
        until_us: when it was ended.
    """

    t_us: Times
    on: Flags
    depth: Depths
    from_us: int
    until_us: int

    @property
    def seconds(self) -> float:
        """How long it was heard."""
        return (self.until_us - self.from_us) * 1e-6


class Ear:
    """Keeps what a track's receivers would hear; stands in for `TrackLinks`."""

    every: list[Ear]

    def __init__(self, plan: LinkPlan) -> None:
        self.parts: list[tuple[Times, Flags, Depths]] = []
        self.from_us: int | None = None
        self.until_us = 0
        self.contested = self.outvoted = 0
        self.winner = None
        self.every.append(self)

    def feed(self, t_us: Times, on: Flags, depth: Depths, until_us: int, deep: int = 0) -> list[Decided]:
        """Keep events."""
        if self.from_us is None:
            self.from_us = int(t_us[0]) if len(t_us) else until_us
        self.parts.append((t_us.copy(), on.copy(), depth.copy()))
        self.until_us = until_us
        return []

    def least(self) -> int:
        """Return that every event is heard, wherever it lies in the image."""
        return 0

    def due_us(self) -> int:
        """Return that nothing is due."""
        return NEVER_DUE_US

    def flush(self, now_us: int) -> list[Decided]:
        """Decide nothing."""
        return []

    def accepted(self, now_us: int) -> None:
        """Accept nothing."""

    def verdict(self, now_us: int) -> str:
        """Return that nothing is known."""
        return "new"

    def quality(self, link: int, now_us: int) -> None:
        """Know nothing."""

    def take_refusals(self) -> Refusals:
        """Refuse nothing."""
        return Refusals()

    def signal(self) -> Signal:
        """Return what was heard."""
        t_us, on, depth = (np.concatenate([part[k] for part in self.parts]) for k in range(3))
        return Signal(t_us, on, depth, self.from_us or 0, self.until_us)


def heard(steps: Iterable[list[Message]], context: Context = ONE_PROCESS) -> list[Signal]:
    """Return what a decoder hears of a scene, a signal a track.

    Args:
        steps: what a source sends.
        context: of both cores.
    """
    ears = type("Ears", (Ear,), {"every": []})
    with mock.patch.object(following, "TrackLinks", ears):
        pipeline = Pipeline(make_tracker(TrackerConfig(), context), core.make_core(DecoderConfig(), context))
        for messages in steps:
            pipeline.feed(messages)
    return [ear.signal() for ear in ears.every if ear.parts]  # type: ignore[attr-defined]  # made above


@dataclass(slots=True)
class Told:
    """What receivers said of a candidate: identities with their protocol, text, and frames without an identity."""

    identities: list[str] = field(default_factory=list)
    text: str = ""
    frames: int = 0


def listen(plan: LinkPlan, signal: Signal) -> Told:
    """Return what a site's receivers say of a signal, made anew where they give up, as in the decoder."""
    links, told, now = TrackLinks(plan), Told(), None
    for until_us, events in _steps(signal):
        decided = links.feed(*events, until_us)
        for one in decided:
            text = getattr(one.item, "text", None)
            data = getattr(one.item, "data", None)
            told.text += text or (data.hex() if data else "")
            told.frames += hasattr(one.item, "payload")
        accepted = links.accepted(until_us)
        state = None if accepted is None else (accepted.link, accepted.identity.payload)
        if state is not None and state != now:
            told.identities.append(f"{plan.protocol(state[0])}:{state[1]}")
        now = state
    return told


def _steps(signal: Signal) -> Iterator[tuple[int, tuple[Times, Flags, Depths]]]:
    begin = 0
    for until_us in [*range(signal.from_us + STEP_US, signal.until_us, STEP_US), signal.until_us]:
        stop = int(np.searchsorted(signal.t_us, until_us))
        yield until_us, (signal.t_us[begin:stop], signal.on[begin:stop], signal.depth[begin:stop])
        begin = stop
