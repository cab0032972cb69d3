"""A source that a test drives: plays a scene on the bus at real time, loses what it is told to, and lets time jump."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterator
from dataclasses import replace

from heliograph.core import Context
from heliograph.keys import key_of
from heliograph.messages import Message
from heliograph.shell.bus import Bus
from heliograph.shell.process import Stop
from heliograph.streams import Events, Onsets
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.stream import Step, steps


class Feeder:
    """Plays steps in the place of a source.

    Args:
        bus: to publish on.
        scene: the steps, in order; read as far as they are played.
    """

    def __init__(self, bus: Bus, scene: Iterator[Step]) -> None:
        self._bus = bus
        self._scene = scene
        self._played_us = 0
        self._stop = Stop()
        self.shift_us = 0  # added to every time from now on: the camera's clock jumps
        self.lost = 0

    def play(self, camera_s: float, lose: Container[str] = ()) -> None:
        """Publish so much of the scene, each step when its time has come.

        Args:
            camera_s: how much.
            lose: schemas that are numbered, and lost on the way.
        """
        until_us = self._played_us + round(camera_s * 1e6)
        began_s, first_us = time.monotonic(), self._played_us
        for step in self._scene:
            ahead_s = (step.t1_us - first_us) / 1e6 - (time.monotonic() - began_s)
            if ahead_s > 0:
                self._stop.wait(ahead_s)
            for message in step.messages:
                self._send(message, lost=message.SCHEMA in lose)
            self._played_us = step.t1_us
            if step.t1_us >= until_us:
                return

    def until(self, condition: Callable[[], bool], what: str, at_most_s: float = 30.0) -> None:
        """Play until the condition holds.

        Raises:
            AssertionError: it did not come to hold in so much of the scene.
        """
        end_us = self._played_us + round(at_most_s * 1e6)
        while not condition():
            assert self._played_us < end_us, f"played {at_most_s} s for {what}"
            self.play(0.1)

    def _send(self, message: Message, *, lost: bool) -> None:
        if not isinstance(message, (Events, Onsets)):
            return
        message = shifted(message, self.shift_us)
        if not lost:
            self._bus.publish(message)
            return
        key_text = key_of(self._bus.site, message)
        # What a full link drops has a number, and nobody gets it.
        self._bus._seq[key_text] = self._bus._seq.get(key_text, 0) + 1
        self.lost += 1


def shifted(message: Events | Onsets, by_us: int) -> Message:
    """Return the same record, later by so much."""
    if by_us == 0:
        return message
    fields = {name: getattr(message, name) for name in message.__struct_fields__}
    fields |= {"t0_us": message.t0_us + by_us, "t1_us": message.t1_us + by_us}
    if isinstance(message, Events):
        fields["batch"] = replace(message.batch, t_us=message.batch.t_us + by_us)
    return type(message)(**fields)


def five() -> Iterator[Step]:
    """Yield the steps of the scene "five" without end, as a live source makes them."""
    config = EventSourceConfig(backend="simulated", scenario="five", seed=3)
    return steps(config, Context(instance="feeder", boot="feeder", lockstep=False))
