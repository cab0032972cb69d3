"""Scenes for the tracker: blinking discs that move, as onsets, and how well tracks follow them.

A pixel inside a lit disc is bright; each change of a pixel between two steps of `STEP_US` is an event (or two), seen
with probability `seen`. So blinking fills the disc, and a lit disc that moves draws crescents, as on a sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heliograph.messages import Tracks
from heliograph.streams import Onsets

Path = Callable[[float], tuple[float, float]]
Word = tuple[int, ...]
US = 1e-6


def bits(text: str) -> Word:
    """Return the bits of "1110 101010 1"."""
    return tuple(int(c) for c in text if c in "01")


# Payload 42 with even parity, the paper's example.
CODE_42 = bits("1110 101010 1")


def line(x_px: float, y_px: float, vx_px_s: float = 0.0, vy_px_s: float = 0.0) -> Path:
    """Return a path at constant velocity."""
    return lambda t_s: (x_px + vx_px_s * t_s, y_px + vy_px_s * t_s)


def circle(x_px: float, y_px: float, radius_px: float, speed_px_s: float) -> Path:
    """Return a circular path."""
    w = speed_px_s / radius_px
    return lambda t_s: (x_px + radius_px * np.cos(w * t_s), y_px + radius_px * np.sin(w * t_s))


@dataclass(frozen=True)
class Disc:
    """A beacon; dark outside its windows of time, if it has any."""

    path: Path
    radius_px: float = 3.0
    bit_rate: float = 1000.0
    word: Word = CODE_42
    dark_s: tuple[tuple[float, float], ...] = ()

    def lit(self, t_us: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Return whether it shines at each time."""
        bit = (t_us * self.bit_rate // 1_000_000).astype(np.int64)
        on: npt.NDArray[np.bool_] = np.array(self.word, np.bool_)[bit % len(self.word)]
        for start, stop in self.dark_s:
            on &= ~((t_us >= start * 1e6) & (t_us < stop * 1e6))
        return on


@dataclass(frozen=True)
class Scene:
    """What a camera of width x height pixels sees."""

    discs: tuple[Disc, ...]
    width: int = 320
    height: int = 240
    noise_hz: float = 0.0  # events a second, all over the sensor
    seen: float = 0.95
    seed: int = 0
    tick_us: int = 5_000
    pool_px: int = 1
    step_us: int = 500
    gated: bool = False
    t0_us: int = 0
    camera: str = "cam0"
    stream: str = "scene"

    def onsets(self, duration_s: float, ticks_a_message: int = 2) -> Iterator[Onsets]:
        """Yield the onsets of the first seconds."""
        rng = np.random.default_rng(self.seed)
        ticks = round(duration_s * 1e6 / self.tick_us)
        before: list[npt.NDArray[np.int64]] = [np.empty(0, np.int64) for _ in self.discs]
        columns: list[list[npt.NDArray[np.int64]]] = []
        for k in range(ticks):
            columns.append(self._tick(k, rng, before))
            if len(columns) == ticks_a_message or k == ticks - 1:
                yield self._message(k + 1 - len(columns), columns, end=k == ticks - 1)
                columns = []

    def _tick(
        self, k: int, rng: np.random.Generator, before: list[npt.NDArray[np.int64]]
    ) -> list[npt.NDArray[np.int64]]:
        """Return pixel, on, off of the active onset pixels of a tick, by (y, x); `before` holds who was bright."""
        on: list[npt.NDArray[np.int64]] = []
        off: list[npt.NDArray[np.int64]] = []
        steps = np.arange(k * self.tick_us, (k + 1) * self.tick_us, self.step_us, dtype=np.int64)
        for d, disc in enumerate(self.discs):
            for t_us, lit in zip(steps.tolist(), disc.lit(steps).tolist(), strict=True):
                bright = self.cover(disc, t_us * US) if lit else np.empty(0, np.int64)
                on.append(np.setdiff1d(bright, before[d], assume_unique=True))
                off.append(np.setdiff1d(before[d], bright, assume_unique=True))
                before[d] = bright
        n_noise = rng.poisson(self.noise_hz * self.tick_us * US)
        noise = rng.integers(0, self.width * self.height, n_noise)
        half = rng.random(n_noise) < 0.5
        counts = []
        for parts, stray in ((on, noise[half]), (off, noise[~half])):
            pixel = np.concatenate([*parts, np.empty(0, np.int64)])
            pixel = pixel[rng.random(len(pixel)) < self.seen]
            again = pixel[rng.random(len(pixel)) < 0.3]
            counts.append(np.concatenate([pixel, again, stray]))
        return self._pooled(counts[0], counts[1])

    def cover(self, disc: Disc, t_s: float) -> npt.NDArray[np.int64]:
        """Return the pixels, y * width + x, that a disc covers at a time."""
        cx, cy = disc.path(t_s)
        r = disc.radius_px
        y, x = np.mgrid[int(cy - r) - 1 : int(cy + r) + 3, int(cx - r) - 1 : int(cx + r) + 3]
        inside = ((x - cx) ** 2 + (y - cy) ** 2 <= r * r) & (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return np.asarray(y[inside] * self.width + x[inside], np.int64)

    def _pooled(self, on: npt.NDArray[np.int64], off: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
        columns = -(-self.width // self.pool_px)
        cells = [(p // self.width // self.pool_px) * columns + p % self.width // self.pool_px for p in (on, off)]
        pixel, place = np.unique(np.concatenate(cells), return_inverse=True)
        n_on = np.bincount(place[: len(on)], minlength=len(pixel))
        n_off = np.bincount(place[len(on) :], minlength=len(pixel))
        if self.gated and len(pixel):
            # The source's gate: at least two events in the 3 x 3 neighbourhood.
            image = np.zeros((-(-self.height // self.pool_px) + 2, columns + 2), np.int64)
            image[pixel // columns + 1, pixel % columns + 1] = n_on + n_off
            near = sum(image[pixel // columns + dy, pixel % columns + dx] for dy in range(3) for dx in range(3))
            keep = np.asarray(near >= 2)
            pixel, n_on, n_off = pixel[keep], n_on[keep], n_off[keep]
        return [pixel, np.minimum(n_on, 255), np.minimum(n_off, 255)]

    def _message(self, first: int, ticks: list[list[npt.NDArray[np.int64]]], end: bool) -> Onsets:
        columns = -(-self.width // self.pool_px)
        pixel, on, off = (np.concatenate(c) for c in zip(*ticks, strict=True))
        t0_us = self.t0_us + first * self.tick_us
        return Onsets(
            camera=self.camera,
            stream=self.stream,
            width=self.width,
            height=self.height,
            t0_us=t0_us,
            t1_us=t0_us + len(ticks) * self.tick_us,
            tick_us=self.tick_us,
            pool_px=self.pool_px,
            tick=np.repeat(np.arange(len(ticks), dtype=np.uint16), [len(c[0]) for c in ticks]),
            x_px=(pixel % columns).astype(np.uint16),
            y_px=(pixel // columns).astype(np.uint16),
            on_count=on.astype(np.uint8),
            off_count=off.astype(np.uint8),
            end=end,
        )


@dataclass
class Score:
    """How tracks fit a scene, over the published instants from `since_s` on."""

    instants: int = 0
    found: int = 0
    missed: int = 0
    strays: int = 0  # tracks that belong to no beacon
    switches: int = 0  # a beacon's track has another name than before
    names: set[str] = field(default_factory=set)
    squares: list[float] = field(default_factory=list)
    speed_squares: list[float] = field(default_factory=list)

    @property
    def rmse_px(self) -> float:
        """Root mean square of the distance."""
        return float(np.sqrt(np.mean(self.squares)))

    @property
    def speed_rmse_px_s(self) -> float:
        """Root mean square of the velocity's error."""
        return float(np.sqrt(np.mean(self.speed_squares)))


def score(scene: Scene, tracks: Iterable[Tracks], since_s: float = 0.2, near_px: float = 6.0) -> Score:
    """Match each beacon with its nearest track, one to one in the order of the beacons."""
    out = Score()
    last: dict[int, str] = {}
    for message in tracks:
        t_s = (message.as_of_us - scene.t0_us) * US
        out.names.update(message.track)
        if t_s < since_s:
            continue
        out.instants += 1
        free = dict(zip(message.track, zip(message.x_px, message.y_px, strict=True), strict=True))
        velocity = dict(zip(message.track, zip(message.vx_px_s, message.vy_px_s, strict=True), strict=True))
        for d, disc in enumerate(scene.discs):
            cx, cy = disc.path(t_s)
            if not (0 <= cx < scene.width and 0 <= cy < scene.height):
                continue
            away = {name: float(np.hypot(x - cx, y - cy)) for name, (x, y) in free.items()}
            name = min(away, key=lambda n: away[n], default=None)
            if name is None or away[name] > near_px:
                out.missed += 1
                continue
            del free[name]
            ax, ay = disc.path(t_s - 1e-4)
            vx, vy = velocity[name]
            out.found += 1
            out.squares.append(away[name] ** 2)
            out.speed_squares.append(((cx - ax) * 1e4 - vx) ** 2 + ((cy - ay) * 1e4 - vy) ** 2)
            out.switches += last.get(d, name) != name
            last[d] = name
        out.strays += len(free)
    return out
