"""A scene as files: the events as NPZ, the truth as JSON lines.

The NPZ has the arrays of `cameras/formats/npz.py`; with labels also `cause` int16: the number of the light that made
an event (those of beacons first, each LED one, then those of clutter), or -1 surroundings, -2 shot noise, -3 hot
pixel, -4 leak. Each line of the truth has a `type`; fields have the names of `heliograph.truth`, one beacon or frame a
line::

    scenario   scenario, seed, stream, width, height, duration_us, sensor, mode, fidelity, preset: the numbers used,
               beacons: [name, protocol, payload, text, fresh, bit_rate]
    beacon     t_us, beacon, protocol, x_px, y_px, radius_px, x_m, y_m, z_m, in_view, visible: a state, every 50 ms
    visible    beacon, t0_us, t1_us: it could be seen from t0_us to t1_us (to 50 ms)
    frame      beacon, protocol, frame_t0_us, frame_t1_us, frame_payload, frame_x_px, frame_y_px, frame_visible
    edge       beacon, t_us, on: the LED's change, to a tenth of a microsecond

Lines stand in the order of time of the windows that they end in; `visible` when the interval has ended.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Final, Protocol, Self

import numpy as np

from heliograph.errors import FileError
from heliograph.events import EventBatch
from heliograph.messages import Message
from heliograph.truth import Fidelity, Truth
from heliograph_services.event_source.cameras.formats.npz import write_labelled_npz, write_npz
from heliograph_services.event_source.simulation.contract import Labels
from heliograph_services.event_source.simulation.readout.numbers import ScanNumbers, Sensor
from heliograph_services.event_source.simulation.world.spec import BeaconSpec

_Value = str | int | float | bool | None
Field = _Value | list[dict[str, _Value]] | Mapping[str, object]

# A beacon's place is told to a thousandth of a pixel, and to a tenth of a millimetre.
_PX_DIGITS: Final = 3
_M_DIGITS: Final = 4


class Step(Protocol):
    """The next window of a simulated camera (`cameras.contract.Window`), and what made its events."""

    @property
    def t1_us(self) -> int:
        """Its end."""
        ...

    @property
    def batch(self) -> EventBatch:
        """Its events."""
        ...

    @property
    def labels(self) -> Labels | None:
        """The cause of each."""
        ...

    @property
    def truth(self) -> Message | None:
        """The truth since the last, where it is due."""
        ...

    @property
    def end(self) -> bool:
        """Whether nothing follows."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What is simulated: all that a result depends on.

    Args:
        scenario: name or file.
        seed: of all that is random.
        fidelity: of the rendering.
        stream: name of the stream.
        duration_us: of the whole run.
        sensor: with the numbers that are used, overrides included.
        focal_mm: of the lens.
        f_number: of the lens.
        beacons: crowds expanded.
    """

    scenario: str
    seed: int
    fidelity: Fidelity
    stream: str
    duration_us: int
    sensor: Sensor
    focal_mm: float
    f_number: float
    beacons: Sequence[BeaconSpec]

    @property
    def mode(self) -> str:
        """The mode of the sensor's read-out; empty where it has one alone."""
        readout = self.sensor.readout
        return readout.mode if isinstance(readout, ScanNumbers) else ""


@dataclass(frozen=True, slots=True)
class Written:
    """What has been written: number of events and of frames sent, and the stream's name."""

    events: int
    frames: int
    stream: str


def write_files(
    run: Run,
    steps: Iterable[Step],
    out: Path,
    truth_file: Path | None = None,
    *,
    labels: bool = False,
    watch: Callable[[Step], None] | None = None,
) -> Written:
    """Write a scene as NPZ, and its truth; neither file is there before it is whole.

    Args:
        run: what is simulated.
        steps: of the camera, in order of time; read to their end.
        out: the NPZ file.
        truth_file: where the truth goes; None: nowhere.
        labels: whether the NPZ tells what made each event.
        watch: sees every step, once it is written: for a bar, or a picture.

    Raises:
        FileError: a file cannot be written.
    """
    frames = 0
    with ExitStack() as stack:
        lines = None if truth_file is None else _TruthLines(stack.enter_context(_Whole(truth_file)).file)
        if lines is not None:
            lines.scenario(run)

        def parts() -> Iterator[tuple[EventBatch, Labels]]:
            nonlocal frames
            for step in steps:
                if isinstance(step.truth, Truth):
                    frames += len(step.truth.frame_t1_us)
                    if lines is not None:
                        lines.window(step.truth, end=step.end)
                yield step.batch, np.empty(0, np.int16) if step.labels is None else step.labels
                if watch is not None:
                    watch(step)

        width, height = run.sensor.width, run.sensor.height
        if labels:
            events = write_labelled_npz(out, width, height, parts())
        else:
            events = write_npz(out, width, height, (batch for batch, _ in parts()))
    return Written(events, frames, run.stream)


def write_truth(run: Run, truths: Iterable[Truth], path: Path | None) -> int:
    """Write the truth alone, or only count its frames; return their number.

    Raises:
        FileError: the file cannot be written.
    """
    frames = 0
    with ExitStack() as stack:
        lines = None if path is None else _TruthLines(stack.enter_context(_Whole(path)).file)
        if lines is not None:
            lines.scenario(run)
        for truth in truths:
            frames += len(truth.frame_t1_us)
            if lines is not None:
                lines.window(truth, end=truth.t1_us == run.duration_us)
    return frames


class _Whole:
    """A text file that takes its name only when all of it has been written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")
        try:
            self.file: IO[str] = self._part.open("w", encoding="utf-8", newline="\n")
        except OSError as error:
            raise FileError(f"{path}: {error.strerror}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.file.close()
            if kind is None:
                self._part.replace(self._path)
        except OSError as error:
            raise FileError(f"{self._path}: {error.strerror}") from None
        finally:
            self._part.unlink(missing_ok=True)


class _TruthLines:
    """Writes the lines of the module's table."""

    def __init__(self, file: IO[str]) -> None:
        self._file = file
        self._visible_since: dict[str, int] = {}

    def _line(self, kind: str, **fields: Field) -> None:
        self._file.write(json.dumps({"type": kind} | fields, separators=(",", ":")) + "\n")

    def scenario(self, run: Run) -> None:
        sensor = run.sensor
        self._line(
            "scenario",
            scenario=run.scenario,
            seed=run.seed,
            stream=run.stream,
            width=sensor.width,
            height=sensor.height,
            duration_us=run.duration_us,
            sensor=sensor.name,
            mode=run.mode,
            fidelity=run.fidelity,
            preset={"kind": sensor.kind, "pixel": asdict(sensor.pixel), "readout": asdict(sensor.readout)},
            beacons=[
                {
                    "name": beacon.name,
                    "protocol": beacon.protocol,
                    "payload": beacon.payload,
                    "text": beacon.text,
                    "fresh": beacon.fresh,
                    "bit_rate": beacon.bit_rate,
                }
                for beacon in run.beacons
            ],
        )

    def window(self, truth: Truth, *, end: bool) -> None:
        order = np.lexsort((truth.edge_beacon, truth.edge_us))
        for i in order.tolist():
            self._line(
                "edge",
                beacon=truth.beacon[truth.edge_beacon[i]],
                t_us=round(float(truth.edge_us[i]), 1),
                on=bool(truth.edge_on[i]),
            )
        for i in range(len(truth.frame_t1_us)):
            beacon = truth.frame_beacon[i]
            self._line(
                "frame",
                beacon=truth.beacon[beacon],
                protocol=truth.protocol[beacon],
                frame_t0_us=truth.frame_t0_us[i],
                frame_t1_us=truth.frame_t1_us[i],
                frame_payload=truth.frame_payload[i],
                frame_x_px=round(truth.frame_x_px[i], _PX_DIGITS),
                frame_y_px=round(truth.frame_y_px[i], _PX_DIGITS),
                frame_visible=truth.frame_visible[i],
            )
        for i, name in enumerate(truth.beacon):
            self._line(
                "beacon",
                t_us=truth.t1_us,
                beacon=name,
                protocol=truth.protocol[i],
                x_px=round(truth.x_px[i], _PX_DIGITS),
                y_px=round(truth.y_px[i], _PX_DIGITS),
                radius_px=round(truth.radius_px[i], _PX_DIGITS),
                x_m=round(truth.x_m[i], _M_DIGITS),
                y_m=round(truth.y_m[i], _M_DIGITS),
                z_m=round(truth.z_m[i], _M_DIGITS),
                in_view=truth.in_view[i],
                visible=truth.visible[i],
            )
            self._seen(name, truth, visible=truth.visible[i], end=end)

    def _seen(self, name: str, truth: Truth, *, visible: bool, end: bool) -> None:
        if visible:
            self._visible_since.setdefault(name, truth.t0_us)
        if name in self._visible_since and (end or not visible):
            t1_us = truth.t1_us if visible else truth.t0_us
            self._line("visible", beacon=name, t0_us=self._visible_since.pop(name), t1_us=t1_us)
