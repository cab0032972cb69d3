"""A picture of a scene: the view with the beacons' ways and the assets, and what the sensor made of it.

Four panels: the view; the events of 5 ms from the middle of the run, as an image; row over time of the lights' events
in the tenth of a second about them; events a second over the whole run, by what made them. Its title names all that it
depends on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.errors import ConfigError, FileError
from heliograph.events import EventBatch, Flags
from heliograph.truth import Truth
from heliograph.units import US_PER_MS, US_PER_S
from heliograph_services.event_source.simulation.contract import BACKGROUND, Floats, Labels
from heliograph_services.event_source.simulation.output.write import Run, Step
from heliograph_services.event_source.simulation.world.projection import Projection

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INSTANT_US: Final = 5_000
STRETCH_US: Final = 100_000
_BINS: Final = 400
# More points than these make the same picture.
_POINTS: Final = 60_000
# A flash over the whole sensor must not fill the memory of whoever only wanted a picture.
_HELD_EVENTS: Final = 4_000_000
_WAY_POINTS: Final = 20_000
_ON, _OFF = "#c8102e", "#1f4e9c"
_CAUSES: Final = ("lights", "surroundings", "noise", "not told")


class _World(Protocol):
    @property
    def projection(self) -> Projection: ...

    def camera(self, t_us: Floats) -> tuple[Floats, Floats]: ...

    def assets(self, t_us: float) -> tuple[Floats, Floats]: ...


@dataclass(slots=True)
class _Way:
    protocol: str
    x_px: list[float] = field(default_factory=list)
    y_px: list[float] = field(default_factory=list)
    visible: list[bool] = field(default_factory=list)


class Picture:
    """Watches a run (`write_files(watch=picture.watch)`), then draws it.

    Args:
        path: of the PNG file.
        run: what is simulated.
        world: for the assets, and where they are in the view.

    Raises:
        ConfigError: matplotlib is not installed.
        FileError: there is no such folder.
    """

    def __init__(self, path: Path, run: Run, world: _World) -> None:
        if find_spec("matplotlib") is None:
            raise ConfigError("--plot needs matplotlib; install it with: pip install 'heliograph[analysis]'")
        if not path.parent.is_dir():  # told now, not after an hour of simulation
            raise FileError(f"{path}: No such file or directory")
        self._path = path
        self._run = run
        self._world = world
        self._t0_us = max(0, (run.duration_us - STRETCH_US) // 2)
        self._held: list[EventBatch] = []
        self._lights: list[EventBatch] = []
        self._held_events = 0
        self._ways: dict[str, _Way] = {}
        self._bin_us = max(US_PER_MS, -(-run.duration_us // _BINS))
        self._rates = np.zeros((len(_CAUSES), -(-run.duration_us // self._bin_us)), np.int64)

    def watch(self, step: Step) -> None:
        """Take a step of the run."""
        batch = step.batch
        low, high = (int(i) for i in np.searchsorted(batch.t_us, (self._t0_us, self._t0_us + STRETCH_US)))
        if high > low and self._held_events < _HELD_EVENTS:
            part = batch.part(low, high)
            self._held.append(part)
            self._lights.append(part if step.labels is None else _chosen(part, step.labels[low:high] >= 0))
            self._held_events += high - low
        if len(batch):
            at = np.minimum(batch.t_us // self._bin_us, self._rates.shape[1] - 1)
            np.add.at(self._rates, (_groups(step.labels, len(batch)), at), 1)
        if isinstance(step.truth, Truth):
            self._follow(step.truth)

    def save(self) -> None:
        """Draw what was watched.

        Raises:
            FileError: the file cannot be written.
        """
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - half a second
        from matplotlib.figure import Figure  # noqa: PLC0415

        figure = Figure(figsize=(13.0, 9.5), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(2, 2)
        self._draw_view(axes[0, 0])
        self._draw_instant(axes[0, 1])
        self._draw_stretch(axes[1, 0])
        self._draw_rates(axes[1, 1])
        figure.suptitle(title_of(self._run))
        try:
            figure.savefig(self._path, format="png", dpi=110)
        except OSError as error:
            raise FileError(f"{self._path}: {error.strerror}") from None

    def _follow(self, truth: Truth) -> None:
        for i, name in enumerate(truth.beacon):
            way = self._ways.setdefault(name, _Way(truth.protocol[i]))
            if len(way.x_px) < _WAY_POINTS and truth.in_view[i]:
                way.x_px.append(truth.x_px[i])
                way.y_px.append(truth.y_px[i])
                way.visible.append(truth.visible[i])

    def _draw_view(self, axes: Axes) -> None:
        from matplotlib.patches import Polygon  # noqa: PLC0415

        t_us = self._t0_us + STRETCH_US / 2
        position, rotation = self._world.camera(np.array([t_us]))
        corners, _ = self._world.assets(t_us)
        for corner in corners:
            x_px, y_px, depth_m = self._world.projection.pixels(position, rotation, corner[:, None, :])
            if (depth_m > 0.0).all():
                outline = np.column_stack([x_px[:, 0], y_px[:, 0]])
                axes.add_patch(Polygon(outline, closed=True, facecolor="0.9", edgecolor="0.5"))
        named = len(self._ways) <= 20
        for number, (name, way) in enumerate(self._ways.items()):
            if not way.x_px:
                continue
            colour = f"C{number % 10}"
            axes.plot(way.x_px, way.y_px, ".", markersize=2.0, color=colour, alpha=0.6)
            hidden = ~np.array(way.visible, np.bool_)
            axes.plot(np.array(way.x_px)[hidden], np.array(way.y_px)[hidden], "x", markersize=4.0, color="0.3")
            if named:
                axes.annotate(f"{name} ({way.protocol})", (way.x_px[-1], way.y_px[-1]), fontsize=7, color=colour)
        _frame(axes, self._run)
        axes.set_title(f"{len(self._ways)} beacons, every 50 ms (x: hidden); assets at {t_us / US_PER_S:.2f} s")

    def _draw_instant(self, axes: Axes) -> None:
        t0_us = self._t0_us + (STRETCH_US - INSTANT_US) // 2
        parts = [_cut(batch, t0_us, t0_us + INSTANT_US) for batch in self._held]
        for is_on, colour in ((True, _ON), (False, _OFF)):
            x_px, y_px = _column(parts, "x_px", is_on=is_on), _column(parts, "y_px", is_on=is_on)
            axes.plot(x_px, y_px, ",", color=colour)
        _frame(axes, self._run)
        axes.set_title(f"events of {INSTANT_US / US_PER_MS:g} ms from {t0_us / US_PER_S:.3f} s (red: brighter)")

    def _draw_stretch(self, axes: Axes) -> None:
        for is_on, colour in ((True, _ON), (False, _OFF)):
            t_us, y_px = (_column(self._lights, name, is_on=is_on) for name in ("t_us", "y_px"))
            every = max(1, len(t_us) // _POINTS)
            axes.plot(t_us[::every] / US_PER_MS, y_px[::every], ",", color=colour)
        axes.set_xlim(self._t0_us / US_PER_MS, (self._t0_us + STRETCH_US) / US_PER_MS)
        axes.set_ylim(self._run.sensor.height - 0.5, -0.5)
        axes.set_xlabel("time, ms")
        axes.set_ylabel("row, px")
        axes.set_title("rows over time, the lights' events")

    def _draw_rates(self, axes: Axes) -> None:
        t_s = (np.arange(self._rates.shape[1]) + 0.5) * self._bin_us / US_PER_S
        for name, counts in zip(_CAUSES, self._rates, strict=True):
            if counts.any():
                axes.step(t_s, counts * (US_PER_S / self._bin_us) / 1e6, where="mid", label=name)
        if self._rates.any():
            axes.legend(fontsize=8)
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("time, s")
        axes.set_ylabel("million events a second")
        axes.set_title(f"{int(self._rates.sum())} events, by what made them")


def title_of(run: Run) -> str:
    """Return what a result of the run depends on, in a line."""
    sensor = f"{run.sensor.name} {run.mode}".strip()
    lens = f"{run.focal_mm:g} mm f/{run.f_number:g}"
    return f"{run.scenario}: {sensor}, {lens}, fidelity {run.fidelity}, seed {run.seed} (simulated)"


def _groups(labels: Labels | None, n: int) -> npt.NDArray[np.int64]:
    """Return (n,) the index in _CAUSES of what made each event."""
    if labels is None:
        return np.full(n, len(_CAUSES) - 1, np.int64)
    return np.where(labels >= 0, 0, np.where(labels == BACKGROUND, 1, 2))


def _cut(batch: EventBatch, t0_us: int, t1_us: int) -> EventBatch:
    low, high = (int(i) for i in np.searchsorted(batch.t_us, (t0_us, t1_us)))
    return batch.part(low, high)


def _chosen(batch: EventBatch, which: Flags) -> EventBatch:
    return EventBatch(batch.t_us[which], batch.x_px[which], batch.y_px[which], batch.on[which])


def _column(batches: Sequence[EventBatch], name: str, *, is_on: bool) -> npt.NDArray[np.int64]:
    parts = [getattr(batch, name)[batch.on == is_on].astype(np.int64) for batch in batches]
    return np.concatenate([np.empty(0, np.int64), *parts])


def _frame(axes: Axes, run: Run) -> None:
    axes.set_xlim(-0.5, run.sensor.width - 0.5)
    axes.set_ylim(run.sensor.height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("x, px")
    axes.set_ylabel("y, px")
