"""Motion everywhere and at every speed: the network at several scales, and what they say together.

Each scale has its own tick and pooling (`settings`), on the absolute grid of its tick, so that nothing depends on how
the stream was cut into messages. A scale that a stream's tick or pooling is too coarse for is made as much coarser.

A place is asked by `at`: the samples within a radius, each moved on with its own motion since it was taken, averaged
by slowness, scale by scale. The scale that answers is the one with the most coherent evidence among those that see a
speed within their own range; no truth is used, and none of it is tuned to a scene. The whole view is asked by
`surroundings`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph.streams import Onsets
from heliograph.units import US_PER_S
from heliograph_services.tracker.flow.holding import Columns, Holding
from heliograph_services.tracker.flow.intake import Intake
from heliograph_services.tracker.flow.kernel import make_runtime
from heliograph_services.tracker.flow.local import local_motions
from heliograph_services.tracker.flow.network import FlowNetwork, paper_network
from heliograph_services.tracker.flow.noise import NoiseMeter, is_due
from heliograph_services.tracker.flow.readout import Reader
from heliograph_services.tracker.flow.sampling import Sampler
from heliograph_services.tracker.flow.settings import FlowSettings, Scale
from heliograph_services.tracker.flow.spikes import TICKS, Runtime
from heliograph_services.tracker.flow.surroundings import Motion, fit_motion

Floats = npt.NDArray[np.float64]

# Beyond its own range a scale answers only as far as rounding blurs it.
RANGE_SLACK: Final = 1.25
# More samples in a fit of the whole view cost time and say little more.
SURROUNDINGS_LIMIT: Final = 1_000


@dataclass(frozen=True, slots=True, eq=False)
class FlowSamples:
    """n samples of motion of one network tick of one scale, sensor pixels.

    Args:
        t_us: the end of the tick.
        scale: index in the settings.
        x_px: (n,) float64, where the front was at t_us.
        y_px: (n,) float64.
        vx_px_s: (n,) float64; of a straight front only the motion across it is seen.
        vy_px_s: (n,) float64.
        weight: (n,) float64, see `readout.Samples`.
    """

    t_us: int
    scale: int
    x_px: Floats
    y_px: Floats
    vx_px_s: Floats
    vy_px_s: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.x_px)


class FlowPyramid:
    """The flow of one stream.

    Args:
        settings: see there.
        width: sensor columns.
        height: sensor rows.
        tick_us: of the stream.
        pool_px: of the stream.
        network: what runs at every scale; the paper's with the settings' l_tau and v_th if None.
        runtime: makes what runs it, for an image of so many columns and rows; the fastest exact one.

    Attributes:
        counters: "ticks", "inputs", "spikes", "samples", "unread" (rows of 64 outputs that were left out) and "flashes"
            (ticks skipped for too many inputs).
    """

    def __init__(
        self,
        settings: FlowSettings,
        *,
        width: int,
        height: int,
        tick_us: int,
        pool_px: int = 1,
        network: FlowNetwork | None = None,
        runtime: Callable[[FlowNetwork, int, int], Runtime] = make_runtime,
    ) -> None:
        self.counters = dict.fromkeys(("ticks", "inputs", "spikes", "samples", "unread", "flashes"), 0)
        network = network or paper_network(settings.l_tau, settings.v_th)
        self._until_us: int | None = None
        self._size = (width, height)
        self._tick_us = tick_us
        self._noise = NoiseMeter(-(-width // pool_px), -(-height // pool_px), tick_us)
        scales = dict.fromkeys(fitted(scale, tick_us, pool_px) for scale in settings.scales)
        self._scales = [
            _ScaleRun(i, scale, settings, network, width, height, tick_us, pool_px, self.counters, runtime)
            for i, scale in enumerate(scales)
        ]

    @property
    def scales(self) -> tuple[Scale, ...]:
        """The scales in use, fitted to the stream."""
        return tuple(run.scale for run in self._scales)

    def feed(self, onsets: Onsets) -> list[FlowSamples]:
        """Take the next message of the stream; return the samples of the ticks that it completes.

        A gap before it counts as silence. Messages must not overlap, and be of the stream that this was made for.
        """
        out: list[FlowSamples] = []
        edges = np.searchsorted(onsets.tick, np.arange(onsets.ticks + 1))
        # Copies, writable and in one piece: numba compiles anew for each other kind of array.
        columns = tuple(np.array(c) for c in (onsets.x_px, onsets.y_px, onsets.on_count, onsets.off_count))
        occupied = np.flatnonzero(np.diff(edges)).tolist()
        for k in occupied:
            part = slice(int(edges[k]), int(edges[k + 1]))
            entries = columns[0][part], columns[1][part], columns[2][part], columns[3][part]
            for run in self._scales:
                out += run.collect(onsets.t0_us + k * self._tick_us, self._noise.events, *entries)
            # After: a network tick that ended before this tick knows nothing of it, however messages are cut.
            if is_due(onsets.t0_us // self._tick_us + k, self._noise.ticks):
                self._noise.measure(*entries)
        for run in self._scales:
            out += run.finish(onsets.t1_us, self._noise.events)
            run.forget(onsets.t0_us)
        self._until_us = onsets.t1_us
        return sorted(out, key=lambda samples: (samples.t_us, samples.scale))

    def at(self, x_px: float, y_px: float, radius_px: float, t_us: int | None = None) -> tuple[float, float, float]:
        """Return (vx, vy, confidence) of what moves at a place: px/s, and 0 to 1; zeros where nothing does.

        Args:
            x_px: of the place.
            y_px: of the place.
            radius_px: samples within it count.
            t_us: when, within the last message; its end if None. What is fed beyond t_us changes nothing, so the answer
                does not depend on how the stream was cut.
        """
        place = np.array([[x_px], [y_px], [radius_px]], np.float64)
        vx, vy, confidence = self.at_places(place[0], place[1], place[2], t_us)[0].tolist()
        return vx, vy, confidence

    def at_places(self, x_px: Floats, y_px: Floats, radius_px: Floats, t_us: int | None = None) -> Floats:
        """Return (n, 3) float64, what `at` says of n places; arguments (n,) float64."""
        at_us = self._until_us if t_us is None else t_us
        best = np.zeros((len(x_px), 3))
        if at_us is None:
            return best
        for run in self._scales:
            answer = run.at(x_px, y_px, radius_px, at_us)
            surer = answer[:, 2] > best[:, 2]
            best[surer] = answer[surer]
        return best

    def surroundings(self, t_us: int | None = None) -> Motion | None:
        """Return the motion of the whole view, or None where too little of it moves to say.

        Args:
            t_us: when, within the last message; its end if None.
        """
        at_us = self._until_us if t_us is None else t_us
        if at_us is None:
            return None
        best: Motion | None = None
        centre = (self._size[0] - 1) / 2, (self._size[1] - 1) / 2
        seen = [(run, run.some(at_us)) for run in self._scales]
        for _, samples in seen:
            motion = fit_motion(samples, *centre)
            if motion is not None and (best is None or motion.confidence > best.confidence):
                best = motion
        if best is None:
            return None
        # A view that rolls has all speeds: each scale adds what it sees where its own speeds are.
        parts = [run.within(best, samples) for run, samples in seen]
        x, y, vx, vy, weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return fit_motion((x, y, vx, vy, weight), *centre, best) or best


def fitted(scale: Scale, tick_us: int, pool_px: int) -> Scale:
    """Return the scale, made as coarse as a stream's tick and pooling ask for; its speeds stay where they were.

    Its step becomes a multiple of the tick, its pooling one of the stream's.
    """
    pool = -(-scale.pool_px // pool_px) * pool_px
    step_us = scale.step_us * pool / scale.pool_px
    ticks = max(1, round(step_us / tick_us))
    if ticks * tick_us > 1.5 * step_us:
        wider = round(pool / pool_px * ticks * tick_us / step_us)
        pool = max(1, wider) * pool_px
    return Scale(ticks * tick_us, pool, scale.silence_ticks)


class _ScaleRun:
    """One scale of one stream: its network, and its samples of late."""

    def __init__(
        self,
        index: int,
        scale: Scale,
        settings: FlowSettings,
        network: FlowNetwork,
        width: int,
        height: int,
        tick_us: int,
        pool_px: int,
        counters: dict[str, int],
        runtime: Callable[[FlowNetwork, int, int], Runtime],
    ) -> None:
        columns, rows = -(-width // scale.pool_px), -(-height // scale.pool_px)
        self.scale = scale
        self._index = index
        self._counters = counters
        self._limit = settings.limit_pixels
        self._tick_us = tick_us
        self._intake = Intake(columns, rows, scale.pool_px // pool_px, scale.silence_ticks, settings.noise_share)
        self._runtime = runtime(network, columns, rows)
        self._sampler = Sampler(columns, rows, settings.tile_inputs * max(1.0, scale.step_us / 10_000), network.v_th)
        self._reader = Reader(network, columns, rows, settings.readout == "fit")
        self._now: int | None = None  # the tick that is being collected
        self._quiet = TICKS  # ticks without input
        self._holding = Holding(settings.hold_ticks * scale.step_us)
        # Stream pixels and ticks in one of the network's.
        self._cell_ticks = (scale.pool_px // pool_px) ** 2 * scale.step_us / tick_us
        # px/s of one pixel a tick.
        self._unit = scale.pool_px * US_PER_S / scale.step_us
        speed = np.hypot(*network.velocity.T) * self._unit
        self._range = float(speed.min()) / RANGE_SLACK, float(speed.max()) * RANGE_SLACK

    def collect(
        self,
        t_us: int,
        noise: float,
        x_px: npt.NDArray[Any],
        y_px: npt.NDArray[Any],
        on: npt.NDArray[Any],
        off: npt.NDArray[Any],
    ) -> list[FlowSamples]:
        """Take the entries of one stream tick; return the samples of the network ticks that ended before it."""
        tick = t_us // self.scale.step_us
        out = self._advance(tick, noise)
        part = (t_us + self._tick_us / 2) / self.scale.step_us - tick
        self._intake.collect(x_px, y_px, on, off, part)
        return out

    def finish(self, t1_us: int, noise: float) -> list[FlowSamples]:
        """Return the samples of the network ticks that end by t1."""
        return self._advance(t1_us // self.scale.step_us, noise)

    def forget(self, t0_us: int) -> None:
        """Drop the samples that answer nothing from t0 on."""
        self._holding.forget(t0_us)

    def at(self, x_px: Floats, y_px: Floats, radius_px: Floats, at_us: int) -> Floats:
        """Return this scale's answers; see FlowPyramid.at_places."""
        out = np.zeros((len(x_px), 3))
        recent = self._holding.at(at_us)
        if recent is not None:
            local_motions(*recent, x_px, y_px, radius_px, out)
            speed = np.hypot(out[:, 0], out[:, 1])
            out[(speed < self._range[0]) | (speed > self._range[1])] = 0.0
        return out

    def some(self, at_us: int) -> Columns:
        """Return the samples that answer at a time, evenly chosen ones if there are many."""
        return self._holding.some(at_us, SURROUNDINGS_LIMIT) or (np.empty(0),) * 5

    def within(self, motion: Motion, samples: Columns) -> Columns:
        """Return the samples at whose places the motion has a speed of this scale."""
        speed = np.hypot(*motion.along(samples[0], samples[1]))
        mine = (speed >= self._range[0]) & (speed <= self._range[1])
        x, y, vx, vy, weight = (column[mine] for column in samples)
        return x, y, vx, vy, weight

    def _advance(self, tick: int, noise: float) -> list[FlowSamples]:
        """Run the network up to the beginning of a tick."""
        if self._now is None:
            self._now = tick
        out: list[FlowSamples] = []
        # After so many silent ticks nothing is left that could fire.
        while self._now < tick and (self._intake.pending or self._quiet < TICKS):
            out += self._tick(noise * self._cell_ticks)
        if self._now < tick:
            self._runtime.skip(tick - self._now)
            self._sampler.skip(tick - self._now)
            self._now = tick
        return out

    def _tick(self, noise: float) -> list[FlowSamples]:
        assert self._now is not None  # noqa: S101 - for the type checker: _advance has set it
        cells = self._intake.release(self._now, noise)
        self._counters["ticks"] += 1
        if cells.shape[1] > self._limit:
            self._counters["flashes"] += 1
            cells = cells[:, :0]
        self._quiet = 0 if cells.shape[1] else self._quiet + 1
        wanted, unread = self._sampler.choose(cells[0], cells[1], self._now)
        spikes = self._runtime.step(cells[0], cells[1], wanted)
        samples = self._reader.read(spikes, self._intake.arrival, self._now)
        self._now += 1
        self._counters["inputs"] += cells.shape[1]
        self._counters["unread"] += unread
        self._counters["spikes"] += len(spikes)
        self._counters["samples"] += len(samples)
        if len(samples) == 0:
            return []
        pool, square = self.scale.pool_px, samples.gx**2 + samples.gy**2
        middle = (pool - 1) / 2
        out = FlowSamples(
            self._now * self.scale.step_us,
            self._index,
            samples.x * pool + middle,
            samples.y * pool + middle,
            samples.gx / square * self._unit,
            samples.gy / square * self._unit,
            samples.weight,
        )
        self._holding.add(out.t_us, (out.x_px, out.y_px, out.vx_px_s, out.vy_px_s, out.weight))
        return [out]


def warm() -> None:
    """Compile every kernel, or load it from the cache: a bar crosses a small image, without memory and with."""
    y = np.arange(64, dtype=np.uint16)
    for l_tau in (0.0, 0.5):
        flow = FlowPyramid(FlowSettings(l_tau=l_tau), width=64, height=64, tick_us=5_000)
        for i in range(24):
            one = np.ones(64, np.uint8)
            x = np.full(64, 2 * i, np.uint16)
            flow.feed(
                Onsets(
                    camera="warm", stream="warm", width=64, height=64, t0_us=5_000 * i, t1_us=5_000 * (i + 1),
                    tick_us=5_000, pool_px=1, tick=np.zeros(64, np.uint16), x_px=x, y_px=y, on_count=one, off_count=one,
                )
            )  # fmt: skip
        flow.at(30.0, 30.0, 20.0)
        flow.surroundings()
