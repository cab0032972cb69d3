"""Runs of the tracker: streams of onsets, cut at will, and what the core publishes of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np

from heliograph.core import Context
from heliograph.messages import Message, Tracks
from heliograph.streams import Onsets
from heliograph.wire import pack_body
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import TrackerCore, make_core
from support.onset_scenes import Disc, Scene, line

PERIOD = 100_000
TWO = Scene((Disc(line(60, 60)), Disc(line(200, 120, 50, 0))), noise_hz=2e4, seed=5)


def new_core(lockstep: bool = False, boot: str = "b00t", **settings_: object) -> TrackerCore:
    return make_core(TrackerConfig(**settings_), Context("0", boot, lockstep))  # type: ignore[arg-type]


def feed(core: TrackerCore, messages: Iterable[Message]) -> list[Tracks]:
    """Return what is published for the periods; without what is published at once between them."""
    return [m for m in feed_all(core, messages) if m.as_of_us % m.period_us == 0]


def feed_all(core: TrackerCore, messages: Iterable[Message]) -> list[Tracks]:
    out: list[Tracks] = []
    for message in messages:
        for one in core.feed(message):
            assert isinstance(one, Tracks)
            out.append(one)
    return out


def silence(t0_us: int, t1_us: int, stream: str = "scene", side: int = 320, end: bool = False) -> Onsets:
    nothing = np.empty(0, np.uint16)
    return Onsets(
        camera="cam0", stream=stream, width=side, height=1 if side == 1 else 240, t0_us=t0_us, t1_us=t1_us,
        tick_us=5_000, pool_px=1, tick=nothing, x_px=nothing, y_px=nothing,
        on_count=nothing.astype(np.uint8), off_count=nothing.astype(np.uint8), end=end,
    )  # fmt: skip


def cut(onsets: list[Onsets], sizes: list[int]) -> list[Onsets]:
    """Return the same stream in messages of other numbers of ticks, in turn."""
    whole = onsets[0].t0_us
    tick_us = onsets[0].tick_us
    tick = np.concatenate([m.tick.astype(np.int64) + (m.t0_us - whole) // tick_us for m in onsets])
    columns = [np.concatenate([getattr(m, c) for m in onsets]) for c in ("x_px", "y_px", "on_count", "off_count")]
    last = (onsets[-1].t1_us - whole) // tick_us
    out: list[Onsets] = []
    at, turn = 0, 0
    while at < last:
        to = min(last, at + sizes[turn % len(sizes)])
        turn += 1
        part = slice(*np.searchsorted(tick, [at, to]))
        m = onsets[0]
        out.append(
            Onsets(
                camera=m.camera, stream=m.stream, width=m.width, height=m.height, t0_us=whole + at * tick_us,
                t1_us=whole + to * tick_us, tick_us=tick_us, pool_px=m.pool_px,
                tick=(tick[part] - at).astype(np.uint16),
                x_px=columns[0][part], y_px=columns[1][part], on_count=columns[2][part], off_count=columns[3][part],
                end=to == last,
            )
        )  # fmt: skip
        at = to
    return out


def bodies(messages: Iterable[Tracks]) -> list[bytes]:
    return [pack_body(m) for m in messages]


@cache
def second() -> list[Onsets]:
    return list(TWO.onsets(1.0))


@cache
def late_start() -> list[Onsets]:
    return list(replace(TWO, t0_us=15_000).onsets(0.5))
