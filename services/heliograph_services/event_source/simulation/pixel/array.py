"""The array of pixels: light in, events out, interval by interval.

One pixel's law is in `response`; what lights do to pixels in `spots` and `claims`; pixels that no light rules are in
`surroundings`; what happens without any light in `noise`; the events' order in `order`.

Nothing depends on how many intervals are asked for at a time, only on where they end; random numbers are functions of
the seed, the pixel and the event (`simulation.random`).
"""

from __future__ import annotations

import numpy as np

from heliograph_services.event_source.simulation import random
from heliograph_services.event_source.simulation.contract import (
    CHUNK_US,
    NODES,
    Floats,
    LightChunk,
    PixelEvents,
    PixelNumbers,
    View,
)
from heliograph_services.event_source.simulation.pixel.kernels import FINISH, LIT, UNLIT
from heliograph_services.event_source.simulation.pixel.model import (
    BASE,
    COUNT,
    DEAD,
    DRIFT,
    NEVER,
    OFF,
    ON,
    REF,
    SENT,
    T,
    U,
    V,
    checked,
    fresh,
    signed,
)
from heliograph_services.event_source.simulation.pixel.noise import BLOCK_US
from heliograph_services.event_source.simulation.pixel.spots import LEVEL, Chunk, no_lights
from heliograph_services.event_source.simulation.pixel.surroundings import HISTORY, Past

# How often the bounds of sleeping pixels are computed anew, on the grid of time: drift times this stays far below what
# float32 resolves beside a threshold.
REBASE_US = 8_000_000


class PixelArray:
    """All pixels of a sensor.

    Args:
        numbers: what they obey.
        width: in px.
        height: in px.
        seed: of all that is random about them.
        first_view: (height, width) float32, ln(irradiance + dark), at which they have looked forever.

    Raises:
        ConfigError: one of the numbers is out of its range.
    """

    def __init__(self, numbers: PixelNumbers, width: int, height: int, seed: int, first_view: View) -> None:
        self._numbers = checked(numbers)
        self._width, self._height = width, height
        if first_view.shape != (height, width):
            raise ValueError(f"the view must be of shape {(height, width)}, not {first_view.shape}")
        self._seed = signed(seed)
        # The row beyond the past's is for the view at the present interval's end.
        views = np.tile(first_view.reshape(-1).astype(np.float32), (HISTORY + 1, 1))
        self._px = fresh(numbers, seed, views[0])
        self._object = first_view
        self._past = Past(np.zeros(HISTORY), np.arange(HISTORY), views)
        self._free = HISTORY
        self._out = np.empty((1 << 14, 2))
        self._held = 0
        self._mine, self._claimed = np.empty(width * height, np.int32), 0
        self._watch, self._watched = np.empty(width * height, np.int32), 0
        self._watched_until_us = -1.0
        self._hot = np.flatnonzero(random.uniforms(seed, random.HOT, np.arange(width * height)) < numbers.hot_pixels)
        self._block = 0
        self._chunk: LightChunk | None = None
        self._arrays: Chunk | None = None
        self._lights = no_lights(0, width, height)
        self._until_us: int | None = None

    def thresholds(self) -> tuple[Floats, Floats]:
        """Return (height, width) float64, ON and OFF."""
        shape = (self._height, self._width)
        return self._px.state[:, ON].reshape(shape), self._px.state[:, OFF].reshape(shape)

    def interval(self, t0_us: int, t1_us: int, view0: View, view1: View, chunk: LightChunk) -> PixelEvents:
        """Return the events of [t0_us, t1_us).

        Args:
            t0_us: where the interval before ended.
            t1_us: not beyond the chunk.
            view0: the very object that was view1 of the interval before (at first, first_view).
            view1: the same object, if nothing has changed; else straight lines lead from view0 to it.
            chunk: the lights.

        Raises:
            ValueError: the interval does not follow the one before, or leaves the chunk.
        """
        self._check(t0_us, t1_us, view0, view1, chunk)
        if self._until_us is None:
            self._begin(t0_us)
        if chunk is not self._chunk:
            first = self._chunk is None
            self._take(chunk, t0_us)
            if first:
                self._look_first(float(t0_us))
        still = view1 is view0
        row = int(self._past.rows[-1]) if still else self._free
        if not still:
            self._past.views[row] = view1.reshape(-1)
        until_us = float(t1_us)
        if still:
            until_us = float(t0_us - t0_us % CHUNK_US + CHUNK_US)
        self._play(float(t0_us), float(t1_us), until_us, row)
        search = not still or t0_us >= self._watched_until_us or self._watched > len(self._watch)
        self._out, self._held, self._watched = UNLIT(
            self._px, self._out, self._held, float(t0_us), float(t1_us), until_us,
            float(t0_us - t0_us % REBASE_US), search, self._past, row, self._watch, self._watched,
        )  # fmt: skip
        self._watched_until_us = until_us if still else -1.0
        self._remember(t1_us, row, still)
        self._until_us, self._object = t1_us, view1
        return self._finish(t0_us, t1_us)

    def _check(self, t0_us: int, t1_us: int, view0: View, view1: View, chunk: LightChunk) -> None:
        if self._until_us is not None and t0_us != self._until_us:
            raise ValueError(f"an interval must begin at {self._until_us} us, not {t0_us}")
        if not chunk.t0_us <= t0_us < t1_us <= chunk.t0_us + CHUNK_US:
            raise ValueError(f"an interval must lie in [{chunk.t0_us}, {chunk.t0_us + CHUNK_US}], not {t0_us} {t1_us}")
        if view0 is not self._object or view1.shape != view0.shape:
            raise ValueError("an interval must begin with the view that the one before ended with, of the same shape")
        if chunk.x_px.shape != (len(chunk.level0), NODES + 1):
            raise ValueError(f"a chunk must have {NODES + 1} nodes, not {chunk.x_px.shape[1]}")

    def _begin(self, t0_us: int) -> None:
        self._px.state[:, T] = t0_us
        self._px.state[:, REF] += self._px.law[DRIFT] * t0_us
        self._past.times[:] = t0_us
        self._block = t0_us // BLOCK_US
        # No base yet: the first interval computes all bounds.
        self._px.law[BASE] = -1.0

    def _take(self, chunk: LightChunk, t0_us: int) -> None:
        """Take the lights of a chunk; a level that has changed meanwhile changes at its beginning."""
        count = len(chunk.level0)
        if self._chunk is None:
            self._lights = no_lights(count, self._width, self._height)
            for i in range(count):
                past = chunk.edge_level[chunk.edge_first[i] : chunk.edge_first[i + 1]]
                past = past[chunk.edge_us[chunk.edge_first[i] : chunk.edge_first[i + 1]] < t0_us]
                self._lights.place[i, LEVEL] = past[-1] if len(past) else chunk.level0[i]
        if count != len(self._lights.place):
            raise ValueError(f"a chunk must have {len(self._lights.place)} lights as the first had, not {count}")
        jump = np.flatnonzero((self._lights.place[:, LEVEL] != chunk.level0) & (self._chunk is not None))
        edges, levels, firsts = chunk.edge_us, chunk.edge_level, chunk.edge_first
        if len(jump):
            at = firsts[jump]
            edges = np.insert(edges, at, float(chunk.t0_us))
            levels = np.insert(levels, at, chunk.level0[jump])
            firsts = firsts + np.searchsorted(jump, np.arange(count + 1))
        nodes = (chunk.x_px, chunk.y_px, chunk.sigma_px, chunk.flux_w_m2)
        x, y, sigma, flux = (np.ascontiguousarray(table, np.float64) for table in nodes)
        self._arrays = Chunk(
            float(chunk.t0_us), x, y, sigma, flux, np.ascontiguousarray(firsts, np.int64),
            np.ascontiguousarray(edges, np.float64), np.ascontiguousarray(levels, np.float64),
        )  # fmt: skip
        self._chunk = chunk

    def _look_first(self, t0_us: float) -> None:
        """Let the pixels have looked forever at the lights too that are lit at the beginning."""
        count = len(self._lights.place)
        if self._arrays is None or not (self._lights.place[:, LEVEL] > 0.0).any():
            return
        # A glance at the lights as they are, of 1 ns; what the pixels do in it is undone.
        arrays, levels = self._arrays, self._lights.place[:, LEVEL].copy()
        self._lights.place[:, LEVEL] = 0.0
        self._arrays = arrays._replace(
            edge_first=np.arange(count + 1), edge_us=np.full(count, t0_us), edge_level=levels
        )  # fmt: skip
        self._play(t0_us, t0_us + 1e-3, t0_us, int(self._past.rows[-1]))
        self._arrays, self._held = arrays, 0
        px, lit = self._px, self._mine[: self._claimed]
        px.state[lit, REF] += px.state[lit, U] - self._past.views[self._past.rows[-1], lit]
        px.state[lit, V], px.state[lit, T] = px.state[lit, U], t0_us
        px.state[lit, SENT], px.state[lit, DEAD], px.state[lit, COUNT] = NEVER, NEVER, 0.0

    def _play(self, t0_us: float, t1_us: float, horizon_us: float, row: int) -> None:
        if len(self._lights.place) == 0:
            return
        self._out, self._held, self._claimed, self._watched = LIT(
            self._px, self._lights, self._arrays, self._out, self._held, t0_us, t1_us, horizon_us, self._past, row,
            self._mine, self._claimed, self._watch, self._watched, self._width,
        )  # fmt: skip

    def _remember(self, t1_us: int, row: int, still: bool) -> None:
        times, rows = self._past.times, self._past.rows
        if not (still and rows[-2] == row):
            times[:-1], rows[:-1] = times[1:].copy(), rows[1:].copy()
            rows[-1] = row
            self._free = min(set(range(HISTORY + 1)) - set(rows.tolist()))
        times[-1] = t1_us

    def _finish(self, t0_us: int, t1_us: int) -> PixelEvents:
        after = -(-t1_us // BLOCK_US)
        self._out, self._held, t_us, pixel, on, cause = FINISH(
            self._out, self._held, self._seed, float(t0_us), float(t1_us), self._block, after,
            self._numbers.shot_noise_hz, len(self._px.low), self._numbers.hot_pixel_hz, self._hot,
        )  # fmt: skip
        self._block = after
        return PixelEvents(t_us, pixel, on, cause)


def warm() -> None:
    """Compile every kernel, or load it from the cache."""
    numbers = PixelNumbers(
        threshold_on=0.2, threshold_off=0.2, threshold_sd=0.03, tau_ref_us=50.0, irradiance_ref_w_m2=1.0,
        tau_min_us=10.0, dark_w_m2=0.0, refractory_us=0.0, leak_hz=0.1, shot_noise_hz=1.0, hot_pixels=0.1,
        hot_pixel_hz=10.0, latency_us=1.0, latency_off_extra_us=0.0, jitter_us=1.0,
    )  # fmt: skip
    view = np.zeros((8, 8), np.float32)
    one = np.ones((1, NODES + 1))
    chunk = LightChunk(
        0, 4.0 * one, 4.0 * one, one, one, np.zeros(1), np.array([0, 1]), np.array([100.0]), np.ones(1)
    )  # fmt: skip
    random.warm()
    PixelArray(numbers, 8, 8, 0, view).interval(0, 1000, view, view, chunk)
