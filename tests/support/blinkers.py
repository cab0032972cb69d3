"""Synthetic blinking discs for the decoder's tests, and a modulation simple enough to be decided by hand.

The modulation `pulse`: each frame of `FRAME_US` begins with the LED on; it goes off `SLOT_US` x (payload + 1) later. A
receiver decides a frame at each change from on to off; three equal ones in a row are an identity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.events import EventBatch, Flags, Times, concatenate
from heliograph.link.contract import Bits, Identity, LinkFrame, LinkQuality, Text, Verdict, edges_of
from heliograph.messages import Message, Tracks
from heliograph.streams import Events

FRAME_US = 10_000
SLOT_US = 500
EQUAL = 3
SILENT_US = 500_000

Path = Callable[[npt.NDArray[np.float64]], tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]


class PulseReceiver:
    """Reads `pulse`; `says` are texts that it releases, one at each frame once it is accepted."""

    def __init__(self, says: bool) -> None:
        self.refusals: Refusals = Refusals()
        self.heard = 0
        self._says = says
        self._on_us: int | None = None
        self._until_us: int | None = None
        self._run: list[int] = []
        self._identity: Identity | None = None
        self._last_us = 0

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        if self._until_us is not None:
            assert until_us >= self._until_us
            assert not len(t_us) or t_us[0] >= self._until_us, "an event came twice, or late"
        assert not len(t_us) or t_us[-1] < until_us
        assert np.all(np.diff(t_us) >= 0)
        self._until_us = until_us
        self.heard += len(t_us)
        out: list[LinkFrame | Text] = []
        for time_us, level in zip(t_us.tolist(), on.tolist(), strict=True):
            if level:
                # Latencies of one edge lie within a slot: the first event of a burst is the edge.
                self._on_us = time_us if self._on_us is None or time_us - self._on_us > FRAME_US // 2 else self._on_us
            elif self._on_us is not None and time_us - self._on_us >= SLOT_US // 2:
                out += self._decide(time_us, round((time_us - self._on_us) / SLOT_US) - 1)
                self._on_us = None
        return out

    def _decide(self, t_us: int, payload: int) -> list[LinkFrame | Text]:
        if not 0 <= payload < 16:
            self.refusals[Refusal.OFF_GRID] += 1
            return []
        self._run = [*self._run, payload][-EQUAL:]
        self._last_us = t_us
        held = self._identity
        if held is not None and held.payload == payload:
            self._identity = Identity(payload, held.since_us, t_us, held.frames_used + 1, held.margin, 0.99)
        elif self._run == [payload] * EQUAL:
            self._identity = Identity(payload, t_us, t_us, EQUAL, float(payload), 0.99)
        out: list[LinkFrame | Text] = [LinkFrame(t_us, payload, 0.9, 5.0)]
        if self._says and self._identity is not None:
            out.append(Text(t_us, "abcdefghijklmnop"[payload], None))
        return out

    def flush(self) -> list[LinkFrame | Text]:
        return []

    def identity(self) -> Identity | None:
        return self._identity

    def verdict(self, now_us: int) -> Verdict:
        return "valid" if self._identity is not None else "new"

    def quality(self, now_us: int) -> LinkQuality:
        return LinkQuality(100.0, 20.0, 3.0, None, 12.0, 1.0)


class Pulse:
    """The modulation of this module."""

    name = "pulse"
    frame_bits = 1

    def __init__(self, says: int = 0) -> None:
        self._says = bool(says)

    def encode(self, payload: Any) -> Bits:
        if not 0 <= payload < 16:
            raise ValueError(f"payload must be in [0, 15], not {payload}")
        return tuple(int(i <= payload) for i in range(FRAME_US // SLOT_US))

    def receiver(self, bit_rate: float, name: str = "default") -> PulseReceiver:
        if name != "default":
            raise ValueError(f"receiver of pulse must be default, not {name!r}")
        return PulseReceiver(self._says)


def pulse_only(name: str, **options: str | int) -> Pulse:
    """Return `Pulse` whatever its name is: two names are two links that read the same signal."""
    if not name.startswith("pulse"):
        raise ValueError(f"protocol must be pulse, not {name!r}")
    return Pulse(**{key: int(value) for key, value in options.items()})


@dataclass(frozen=True)
class Disc:
    """A blinking disc.

    Args:
        payload: what it sends with `pulse`; None for an LED that never blinks.
        path: centre in px at times in seconds.
        radius_px: its radius.
        lit_us: it is on only in [lit_us[0], lit_us[1]).
        gain: the share of its pixels that fire at an edge.
    """

    payload: int
    path: Path
    radius_px: float = 3.0
    lit_us: tuple[int, int] = (0, 2**60)
    gain: float = 0.8


def still(x_px: float, y_px: float) -> Path:
    """Return a path that stays."""
    return lambda s: (np.full_like(s, x_px), np.full_like(s, y_px))


def straight(x_px: float, y_px: float, vx_px_s: float, vy_px_s: float) -> Path:
    """Return a path of constant velocity."""
    return lambda s: (x_px + vx_px_s * s, y_px + vy_px_s * s)


def scene(
    discs: Iterable[Disc], t0_us: int, t1_us: int, width: int, height: int, noise_hz: float = 0.0, seed: int = 0
) -> EventBatch:
    """Return the events of all discs in [t0_us, t1_us), and of uniform noise."""
    rng = np.random.default_rng([seed, 7])
    parts: list[EventBatch] = []
    for disc in discs:
        starts = np.arange(-(-t0_us // FRAME_US) * FRAME_US, t1_us, FRAME_US)
        starts = starts[(starts >= disc.lit_us[0]) & (starts < disc.lit_us[1])]
        for level, shift_us in ((True, 0), (False, SLOT_US * (disc.payload + 1))):
            parts.append(_edges(rng, disc, starts + shift_us, level, width, height))
    n = rng.poisson(noise_hz * (t1_us - t0_us) / 1e6)
    parts.append(
        EventBatch(
            rng.integers(t0_us, t1_us, n, dtype=np.int64),
            rng.integers(0, width, n, dtype=np.uint16),
            rng.integers(0, height, n, dtype=np.uint16),
            rng.random(n) < 0.5,
        )
    )
    whole = merged(parts)
    first, behind = np.searchsorted(whole.t_us, [t0_us, t1_us])
    return whole.part(int(first), int(behind))


def _edges(
    rng: np.random.Generator, disc: Disc, at_us: npt.NDArray[np.int64], level: bool, width: int, height: int
) -> EventBatch:
    x0, y0 = disc.path(at_us / 1e6)
    side = np.arange(-np.ceil(disc.radius_px), np.ceil(disc.radius_px) + 1)
    ox, oy = (grid.ravel() for grid in np.meshgrid(side, side))
    x = np.round(x0)[:, None] + ox
    y = np.round(y0)[:, None] + oy
    near = (x - x0[:, None]) ** 2 + (y - y0[:, None]) ** 2 <= disc.radius_px**2
    fires = near & (rng.random(near.shape) < disc.gain) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    t = np.broadcast_to(at_us[:, None], near.shape) + rng.integers(0, 60, near.shape)
    n = int(fires.sum())
    return EventBatch(
        t[fires].astype(np.int64), x[fires].astype(np.uint16), y[fires].astype(np.uint16), np.full(n, level)
    )


def coded(
    path: Path, radius_px: float, bits: Sequence[int], bit_us: float, t1_us: int, width: int, height: int, seed: int
) -> EventBatch:
    """Return the events of a disc that repeats the bits from time 0 to t1_us; latencies of 60 +- 30 us."""
    rng = np.random.default_rng([seed, 8])
    n = int(t1_us / bit_us) + 1
    at_us, levels = edges_of((list(bits) * (n // len(bits) + 1))[:n], 0.0, bit_us)
    x0, y0 = path(at_us / 1e6)
    side = np.arange(-np.ceil(radius_px), np.ceil(radius_px) + 1)
    ox, oy = (grid.ravel() for grid in np.meshgrid(side, side))
    x = np.round(x0)[:, None] + ox
    y = np.round(y0)[:, None] + oy
    t = (at_us[:, None] + np.abs(rng.normal(60, 30, x.shape))).astype(np.int64)
    near = (x - x0[:, None]) ** 2 + (y - y0[:, None]) ** 2 <= radius_px**2
    fires = near & (rng.random(x.shape) < 0.8) & (x >= 0) & (x < width) & (y >= 0) & (y < height) & (t < t1_us)
    on = np.broadcast_to(levels[:, None], x.shape)
    return EventBatch(t[fires], x[fires].astype(np.uint16), y[fires].astype(np.uint16), on[fires])


def merged(parts: list[EventBatch]) -> EventBatch:
    """Return all events in the order of time."""
    whole = concatenate(parts)
    order = np.argsort(whole.t_us, kind="stable")
    return EventBatch(whole.t_us[order], whole.x_px[order], whole.y_px[order], whole.on[order])


def messages(
    batch: EventBatch,
    t0_us: int,
    t1_us: int,
    cuts: Iterable[int],
    width: int = 160,
    height: int = 120,
    *,
    end: bool = True,
    stream: str = "s",
    camera: str = "cam0",
) -> list[Message]:
    """Return the events as messages cut at the given times."""
    bounds = [t0_us, *sorted({cut for cut in cuts if t0_us < cut < t1_us}), t1_us]
    out: list[Message] = []
    for begin, stop in pairwise(bounds):
        first, behind = np.searchsorted(batch.t_us, [begin, stop])
        out.append(
            Events(
                camera=camera,
                stream=stream,
                width=width,
                height=height,
                t0_us=begin,
                t1_us=stop,
                batch=batch.part(int(first), int(behind)),
                end=end and stop == t1_us,
            )
        )
    return out


def tracks(as_of_us: int, rows: Iterable[tuple[str, Disc, int]], period_us: int = 100_000, **off: float) -> Tracks:
    """Return what an ideal tracker says at as_of_us: (name, disc, born_us) each.

    Args:
        as_of_us: the instant.
        rows: the tracks.
        period_us: the tracker's period.
        off: `speed` multiplies the velocity, `x_px` adds to x, `vx_px_s` to the velocity.
    """
    rows = list(rows)
    x: list[float] = []
    y: list[float] = []
    vx: list[float] = []
    vy: list[float] = []
    for _, disc, _ in rows:
        s = np.array([as_of_us / 1e6, as_of_us / 1e6 + 1e-3])
        px, py = disc.path(s)
        x.append(float(px[0]) + off.get("x_px", 0.0))
        y.append(float(py[0]))
        vx.append(float(px[1] - px[0]) * 1e3 * off.get("speed", 1.0) + off.get("vx_px_s", 0.0))
        vy.append(float(py[1] - py[0]) * 1e3 * off.get("speed", 1.0))
    n = len(rows)
    return Tracks(
        camera="cam0",
        as_of_us=as_of_us,
        period_us=period_us,
        track=[name for name, _, _ in rows],
        born_us=[born for _, _, born in rows],
        seen_us=[as_of_us] * n,
        x_px=x,
        y_px=y,
        vx_px_s=vx,
        vy_px_s=vy,
        x_var_px2=[0.1] * n,
        x_vx_cov_px2_s=[0.0] * n,
        vx_var_px2_s2=[1.0] * n,
        y_var_px2=[0.1] * n,
        y_vy_cov_px2_s=[0.0] * n,
        vy_var_px2_s2=[1.0] * n,
        radius_px=[disc.radius_px for _, disc, _ in rows],
        size_px=[30.0] * n,
        polarity=[0.0] * n,
        status=["new"] * n,
    )
