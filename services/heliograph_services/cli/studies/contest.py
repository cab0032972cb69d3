"""One scene before several readers, and what each made of every frame: what most studies are made of.

Readers (*arms*) get the very same events. `ours` is tracker and decoder as shipped, from a cold start; `paper`,
`wang2022`, `binning` another receiver on our tracks, as published, and with `_tuned` behind the name with the setting
that reads most on development seeds (`heliograph.link.paper`, `wang2022`, `binning`); `core` and `whole` the genie with
one of its ears (`genie`); `MODULE:NAME` a decoder that was plugged in (`peers`, docs/compare.md). The paper's receiver
takes it for granted that a payload repeats, so scenes are told whether it does.

The counts of an arm are blocks of a beacon and a second: both, then frames sent, read right and read wrong, bits sent
and bits right by slot, of the frames that count for MAR_sent (visible), K = 1 (docs/metrics.md).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from heliograph.core import Core
from heliograph.errors import ConfigError
from heliograph.messages import Frames, Identification, Message, Tracks
from heliograph.shares import share
from heliograph.site import Beacon
from heliograph.truth import Truth
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.genie import Genie
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.cli.studies.peers import Plugged, Told, is_peer
from heliograph_services.cli.studies.running import Setting, opened
from heliograph_services.cli.studies.study import Blocks, Counts, Done, Figure, Row, worse_than
from heliograph_services.cli.studies.verdicts import RIGHT, WRONG, Sent, Verdicts, sent_frames, verdicts
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.metrics_sink.slots import Slots
from heliograph_services.tracker.config import TrackerConfig

OURS: Final = "ours"
EARS: Final = ("core", "whole")
# Arms of ours with another receiver.
RECEIVERS: Final = ("paper", "paper_tuned", "wang2022", "wang2022_tuned", "binning", "binning_tuned")
# Columns of others' receivers: as published, and with the one setting that reads most on development seeds.
PAPERS: Final = {"the paper's receiver": "paper", "the paper's receiver, tuned": "paper_tuned"}
WANGS: Final = {"wang2022": "wang2022", "wang2022, tuned": "wang2022_tuned"}
# Columns of a block.
SENT: Final = 2
READ: Final = 3
MISREAD: Final = 4
BITS: Final = 5
BITS_READ: Final = 6

DecoderMaker = Callable[[DecoderConfig], Core]
_Feed = Callable[[list[Message]], list[Message]]


@dataclass(frozen=True, slots=True)
class Scene:
    """What is seen, and what readers are told of it.

    Args:
        text: of the scenario, or the name of a built-in one.
        seconds: of camera time.
        protocol: of the beacons.
        bit_rate: of the beacons, nominal.
        fidelity: of the surroundings.
        tracker: settings of our tracker, by arm.
        options: of the modulation.
    """

    text: str
    seconds: float
    protocol: str
    bit_rate: float
    fidelity: str = "live"
    tracker: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    options: Mapping[str, str | int] = field(default_factory=dict)


@dataclass(slots=True)
class Heard:
    """What one arm published."""

    frames: list[Frames] = field(default_factory=list)
    tracks: list[Tracks] = field(default_factory=list)
    identities: list[Identification] = field(default_factory=list)

    def take(self, messages: Sequence[Message]) -> None:
        """Keep what is scored."""
        for one in messages:
            if isinstance(one, Frames):
                self.frames.append(one)
            elif isinstance(one, Tracks):
                self.tracks.append(one)
            elif isinstance(one, Identification):
                self.identities.append(one)


@dataclass(frozen=True, slots=True)
class Run:
    """A scene before some arms: what was sent, what each made of it, the ends of the source's steps.

    Args:
        paths: of the beacons.
        sent: their frames.
        heard: what each arm published.
        found: what became of the frames with each.
        ends_us: of the source's steps.
    """

    paths: TruePaths
    sent: Sent
    heard: dict[str, Heard]
    found: dict[str, Verdicts]
    ends_us: list[int]


def watch(
    scene: Scene,
    seed: int,
    arms: Sequence[str],
    *,
    ours: DecoderMaker | None = None,
    step: Callable[[], None] | None = None,
) -> Run:
    """Run a scene before these arms.

    Args:
        scene: what is seen.
        seed: of the simulation.
        arms: who reads.
        ours: makes the decoder of ours; None: as shipped.
        step: called after each of the source's steps.

    Raises:
        ConfigError: there is no such arm, the scene is wrong, or its truth holds no frames that count.
    """
    setting = Setting(scene.text, seed, scene.seconds, source={"fidelity": scene.fidelity})
    truths: list[Truth] = []
    ends_us: list[int] = []
    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as folder, opened(setting, Path(folder)) as stream:
        camera = stream.camera
        if not isinstance(camera, SimulatedCamera):
            raise TypeError(f"a study's camera must be simulated, not {type(camera).__name__}")
        paths = true_paths(camera.scene, round((scene.seconds + 0.01) * 1e6))
        readers = {arm: _reader(arm, scene, paths, ours) for arm in arms}
        heard = {arm: Heard() for arm in arms}
        for one in stream:
            truths += [message for message in one.messages if isinstance(message, Truth)]
            ends_us.append(one.t1_us)
            for arm, reader in readers.items():
                heard[arm].take(reader(one.messages))
            if step is not None:
                step()
    sent = sent_frames(truths, paths)
    if not sent.visible.any():
        raise ConfigError(f"the truth holds no frames that count in {scene.seconds:g} s: nothing can be scored")
    return Run(paths, sent, heard, {arm: verdicts(sent, one.frames, paths) for arm, one in heard.items()}, ends_us)


def _reader(arm: str, scene: Scene, paths: TruePaths, ours: DecoderMaker | None) -> _Feed:
    from heliograph_services.decoder.core import make_core as make_decoder  # noqa: PLC0415 - compiles on import
    from heliograph_services.tracker.core import make_core as make_tracker  # noqa: PLC0415

    if arm in EARS:
        genie = Genie(paths, ear="core" if arm == "core" else "whole")
        return lambda messages: [out for message in messages for out in genie.feed(message)]
    name = arm.split("/", maxsplit=1)[0]
    if name == OURS or name in RECEIVERS:
        config = DecoderConfig(
            protocol=scene.protocol,
            bit_rate=scene.bit_rate,
            receiver="default" if name == OURS else name,
            options=dict(scene.options),
        )
        decoder = ours(config) if ours is not None and arm == OURS else make_decoder(config, ONE_PROCESS)
        tracker: Core = make_tracker(TrackerConfig(**scene.tracker.get(arm, {})), ONE_PROCESS)
        return Pipeline(tracker, decoder).feed
    if not is_peer(arm):
        raise ConfigError(f"an arm must be {', '.join((OURS, *RECEIVERS, *EARS))} or MODULE:NAME, not {arm!r}")
    return Plugged(arm, Told(scene.protocol, scene.bit_rate)).feed


def blocks(run: Run, arm: str) -> list[list[int]]:
    """Return the rows of the module's table for an arm."""
    sent, found = run.sent, run.found[arm]
    of = sent.visible
    slots = _slots(run.paths)
    bits = np.array([len(slots[k].word(p) or ()) for k, p in zip(sent.beacon[of], sent.payload[of], strict=True)])
    right = np.array(
        [
            slots[k].right(p, q) if q >= 0 else 0
            for k, p, q in zip(sent.beacon[of], sent.payload[of].tolist(), found.payload[of].tolist(), strict=True)
        ]
    )
    outcome = found.outcome[of]
    columns = [np.ones(int(of.sum()), np.int64), outcome == RIGHT, outcome == WRONG, bits, right]
    key, at = np.unique(np.stack([sent.beacon[of], sent.t1_us[of] // 1_000_000], axis=1), axis=0, return_inverse=True)
    sums = [np.bincount(at.reshape(-1), one, len(key)).astype(np.int64) for one in columns]
    return [[*map(int, name), *map(int, counts)] for name, *counts in zip(key, *sums, strict=True)]


def _slots(paths: TruePaths) -> list[Slots]:
    return [
        Slots(Beacon(name=one.name, protocol=one.protocol, bit_rate=one.bit_rate, options=one.options))
        for one in paths.beacons
    ]


def counts(run: Run) -> Counts:
    """Return the counts of a run: blocks and insertions by arm."""
    arms = list(run.found)
    return {
        "blocks": {arm: blocks(run, arm) for arm in arms},
        "inserted": {arm: run.found[arm].insertions for arm in arms},
    }


def table_of(cells: Sequence[Done], arm: str) -> Blocks:
    """Return (k, 7) the blocks of an arm in all cells that have it, in the order of cells."""
    rows = [row for one in cells for row in one.counts["blocks"].get(arm, [])]
    return np.array(rows, np.int64).reshape(-1, 7)


def mar(cells: Sequence[Done], arm: str) -> Figure:
    """Return MAR_sent (visible) of an arm."""
    of = table_of(cells, arm)
    return Figure.of(share(of[:, READ], of[:, SENT]))


def bar(cells: Sequence[Done], arm: str) -> Figure:
    """Return BAR of an arm."""
    of = table_of(cells, arm)
    return Figure.of(share(of[:, BITS_READ], of[:, BITS]))


def received(cells: Sequence[Done], arm: str) -> str:
    """Return in words how many frames an arm published wrongly, insertions included, of all that it published."""
    of = table_of(cells, arm)
    wrong = int(of[:, MISREAD].sum()) + sum(one.counts["inserted"].get(arm, 0) for one in cells)
    return f"{wrong} of {int(of[:, READ].sum()) + wrong}"


def better_ear(cells: Sequence[Done]) -> str:
    """Return the genie's ear that reads more: the ceiling of a path."""
    return max(reversed(EARS), key=lambda ear: int(table_of(cells, ear)[:, READ].sum()))


def row(what: str, cells: Sequence[Done], columns: Mapping[str, str], published: str = "-") -> Row:
    """Return a line of MARs, with what ours publishes wrongly.

    Args:
        what: the condition.
        cells: of the condition.
        columns: arm by column; `genie` stands for its better ear.
        published: the paper's value.
    """
    arm_of = {name: better_ear(cells) if arm == "genie" else arm for name, arm in columns.items()}
    figures = {name: mar(cells, arm) for name, arm in arm_of.items()}
    compared = {name: table_of(cells, arm)[:, [SENT, READ]] for name, arm in arm_of.items()}
    mine = compared.pop(OURS)
    runs = sum(OURS in one.counts["blocks"] for one in cells)
    n = f"{figures[OURS].n} frames, {runs} runs; wrong {received(cells, OURS)}"
    return Row(what, published, figures, worse_than(mine, compared), n)


def grouped(cells: Sequence[Done], *names: str) -> dict[tuple[Any, ...], list[Done]]:
    """Return cells by the values of parameters, in their order."""
    out: dict[tuple[Any, ...], list[Done]] = {}
    for one in cells:
        out.setdefault(tuple(one[name] for name in names), []).append(one)
    return out


def plugged(cells: Sequence[Done]) -> dict[str, str]:
    """Return a column for each peer that was plugged in."""
    arms = dict.fromkeys(arm for one in cells for arm in one.counts["blocks"])
    return {arm: arm for arm in arms if is_peer(arm)}
