"""Moving and static beacons against the genie: the optical link as a whole, from a cold start.

    python bench/study_link.py [--first 1000] [--runs 4] [--only WORD ...] [-o bench/results/link_moving.json]
    python bench/study_link.py --page [-o ...]           a section of Markdown
    python bench/study_link.py --summary [-o ...]        the same as lines

The conditions are those of `cli/studies/link_scenes.py`: DVXplorer Mini (VARIABLE_5000), shuttles at 2 m/s with both
lenses, the paper's static distances, text, sun, a hand-held camera, the paper's simulated camera. Who reads, the same
events for all:

    ours     source, tracker and decoder as shipped; cold start, nothing known but protocol and bit rate
    genie    our receivers along the true path at the true bit rate, with the better of two ears (core, whole)
    other    the paper's receiver (text: `wang2022`, parameters as published) on our tracks; the paper's takes it for
             granted that a payload repeats, so it has a run of its own, in which it does

MAR_sent (visible), K = 1, a new payload for every frame; of text CER = (wrong + missing + inserted) / sent, by slot.
95 % intervals and the paired difference ours - genie: bootstrap over run x beacon x 1 s. Every frame that ours lost has
a cause, the first that holds: *wrong* (published with other bits), *no track* (the tracker's newest message has none
within the beacon's gate), *region off* (none of the decoder's regions is within it), *refused* (heard, not read); and
whether the genie lost it too. Runs are stored one by one; a study goes on where it was broken off unless the code has
changed. All runs: about 6 min of CPU with --runs 4. Evidence: simulated; the paper's figures are quoted, not ranked.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heliograph.core import Core
from heliograph.messages import Frames, Message, Tracks
from heliograph.shares import Share, difference, share
from heliograph.truth import Truth
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.genie import Genie
from heliograph_services.cli.studies.link_scenes import CONDITIONS, Condition, scenario
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.cli.studies.running import Setting, opened
from heliograph_services.cli.studies.verdicts import (
    RIGHT,
    WRONG,
    Sent,
    Verdicts,
    gates_px,
    sent_frames,
    tracked,
    verdicts,
)
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import DecoderCore
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core

STUDY = "link_moving/1"
ROOT = Path(__file__).parents[1]
OTHERS = {"seed11": "paper", "uart": "wang2022"}
EARS = ("core", "whole")
ARMS = ("ours", "other", *EARS)
CAUSES = ("wrong", "no track", "region off", "refused")
# The paper, hardware (published): moving 2 kbit/s at 2 m/s; static. It does not say with which lens it moved.
QUOTED = {"5 m, 3.6 mm": 0.65, "16 m, 16 mm": 0.27, "11.5 m, 1 kbit/s": 0.87, "16 m, 100 bit/s": 1.00}

Ints = npt.NDArray[np.int64]


class Watched(DecoderCore):
    """The decoder, and where its regions are."""

    def places(self) -> npt.NDArray[np.float64]:
        """Return (2, n) x and y of all regions, now."""
        return np.zeros((2, 0)) if self._following is None else self._following.regions.motion()[:2]


class Heard:
    """One reader: what it published, and the CPU time that it took."""

    def __init__(self, core: Genie | Pipeline, decoder: Watched | None) -> None:
        self.frames: list[Frames] = []
        self.tracks: list[Tracks] = []
        self.cpu_s = 0.0
        self._core = core
        self._decoder = decoder
        self.places: list[npt.NDArray[np.float64]] = []

    def feed(self, messages: list[Message]) -> None:
        """Take a step of the source."""
        began_s = time.process_time()
        if isinstance(self._core, Pipeline):
            out = self._core.feed(messages)
        else:
            out = [one for message in messages for one in self._core.feed(message)]
        self.cpu_s += time.process_time() - began_s
        self.frames += [one for one in out if isinstance(one, Frames)]
        self.tracks += [one for one in out if isinstance(one, Tracks)]
        if self._decoder is not None:
            self.places.append(self._decoder.places())


def reader(arm: str, condition: Condition, paths: TruePaths) -> Heard:
    """Return a reader that has heard nothing."""
    if arm == "core":
        return Heard(Genie(paths), None)
    if arm == "whole":
        return Heard(Genie(paths, ear="whole"), None)
    receiver = "default" if arm == "ours" else OTHERS[condition.protocol]
    config = DecoderConfig(protocol=condition.protocol, bit_rate=condition.bit_rate, receiver=receiver)
    decoder = Watched(config, ONE_PROCESS)
    tracker: Core = make_core(TrackerConfig(), ONE_PROCESS)
    return Heard(Pipeline(tracker, decoder), decoder)


@dataclass(frozen=True, slots=True)
class Run:
    """A run before some readers: what was sent, what each made of it, the ends of the source's steps."""

    paths: TruePaths
    sent: Sent
    heard: dict[str, Heard]
    found: dict[str, Verdicts]
    ends_us: list[int]
    cpu_s: float


def watch(condition: Condition, text: str, seed: int, arms: Sequence[str]) -> Run:
    """Run a scenario before these readers."""
    setting = Setting(text, seed, condition.seconds, source={"fidelity": "live"})
    truths: list[Truth] = []
    ends_us: list[int] = []
    with tempfile.TemporaryDirectory() as folder, opened(setting, Path(folder)) as stream:
        camera = stream.camera
        if not isinstance(camera, SimulatedCamera):
            raise TypeError("the camera must be simulated")
        paths = true_paths(camera.scene, round((condition.seconds + 0.01) * 1e6))
        heard = {arm: reader(arm, condition, paths) for arm in arms}
        began_s = time.process_time()
        for step in stream:
            truths += [message for message in step.messages if isinstance(message, Truth)]
            ends_us.append(step.t1_us)
            for one in heard.values():
                one.feed(step.messages)
        cpu_s = time.process_time() - began_s
    sent = sent_frames(truths, paths)
    return Run(
        paths, sent, heard, {arm: verdicts(sent, one.frames, paths) for arm, one in heard.items()}, ends_us, cpu_s
    )


def row_of(condition: Condition, seed: int) -> dict[str, Any]:
    """Run a condition before all readers; return counts by beacon and second."""
    paired = ("ours", "core", "whole") if condition.protocol == "seed11" else ARMS
    one = watch(condition, scenario(condition, seed), seed, paired)
    of, found = one.sent.visible, one.found
    cause = causes(one)
    row: dict[str, Any] = {"condition": condition.name, "group": condition.group, "seed": seed}
    row["blocks"] = {arm: blocks(one.sent, found[arm]) for arm in paired}
    row["insertions"] = {arm: found[arm].insertions for arm in paired}
    cpu_s = one.cpu_s
    if "other" not in paired:
        other = watch(condition, scenario(condition, seed, repeats=True), seed, ("other",))
        row["blocks"]["other"] = blocks(other.sent, other.found["other"])
        row["insertions"]["other"] = other.found["other"].insertions
        cpu_s += other.cpu_s
    lost = [of & (cause == i) for i in range(len(CAUSES))]
    row["causes"] = {
        name: [int(gone.sum()), *(int((gone & (found[arm].outcome == RIGHT)).sum()) for arm in EARS)]
        for name, gone in zip(CAUSES, lost, strict=True)
    }
    frames = one.heard["ours"].frames
    row["first_frame_us"] = next((int(frame.t_us[0]) for frame in frames if frame.t_us), None)
    return row | {"cpu_s": round(cpu_s, 1)}


def causes(one: Run) -> Ints:
    """Return (n,) the number in CAUSES of each frame that ours lost, -1 where it was read."""
    sent, ours, heard = one.sent, one.found["ours"], one.heard["ours"]
    out = np.full(len(sent.t1_us), CAUSES.index("refused"), np.int64)
    middle_us = (sent.t0_us + sent.t1_us) // 2
    # Regions as of the end of the source's step in which the frame's middle lies.
    step = np.minimum(np.searchsorted(one.ends_us, middle_us), len(one.ends_us) - 1)
    at_us = np.asarray(one.ends_us, np.int64)[step]
    x_px, y_px = one.paths.places(at_us)
    gate = gates_px(one.paths, at_us)
    for j in range(len(out)):
        px, py = heard.places[int(step[j])]
        i = int(sent.beacon[j])
        if not np.any(np.hypot(px - x_px[i, j], py - y_px[i, j]) <= gate[i, j]):
            out[j] = CAUSES.index("region off")
    out[~tracked(sent, heard.tracks, one.paths)] = CAUSES.index("no track")
    out[ours.outcome == WRONG] = CAUSES.index("wrong")
    out[ours.outcome == RIGHT] = -1
    return out


def blocks(sent: Sent, found: Verdicts) -> list[list[int]]:
    """Return, by beacon and second of the frames that count: both, and frames sent, read right and read wrong."""
    of = sent.visible
    if not of.any():
        return []
    names = np.stack([sent.beacon[of], sent.t1_us[of] // 1_000_000], axis=1)
    key, at = np.unique(names, axis=0, return_inverse=True)
    at, outcome = at.reshape(-1), found.outcome[of]
    columns = [np.bincount(at, minlength=len(key))]
    columns += [np.bincount(at[outcome == what], minlength=len(key)) for what in (RIGHT, WRONG)]
    return [[*map(int, name), *map(int, counts)] for name, *counts in zip(key, *columns, strict=True)]


def figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of one condition's runs."""
    table = {arm: np.array([b for row in rows for b in row["blocks"][arm]], np.int64) for arm in ARMS}
    right = {arm: one[:, 3] for arm, one in table.items()}
    whole = table["ours"][:, 2]
    ear = max(reversed(EARS), key=lambda arm: int(right[arm].sum()))
    inserted = {arm: sum(row["insertions"][arm] for row in rows) for arm in ARMS}
    out: dict[str, Any] = {"group": rows[0]["group"], "runs": len(rows), "seeds": [row["seed"] for row in rows]}
    out |= {"ours": share(right["ours"], whole).row(), "genie": share(right[ear], whole).row(), "ear": ear}
    out["other"] = share(right["other"], table["other"][:, 2]).row()
    out["minus_genie"] = difference(right["ours"], right[ear], whole).row()
    out["wrong"] = {arm: int(one[:, 4].sum()) for arm, one in table.items()}
    out["insertions"] = inserted
    error = {
        arm: (int(one[:, 2].sum() - one[:, 3].sum()) + inserted[arm]) / one[:, 2].sum() for arm, one in table.items()
    }
    # Insertions have no block of their own: they are added to the upper bound as they are.
    error["ours_high"] = 1.0 - out["ours"]["low"] + inserted["ours"] / whole.sum()
    out["cer"] = {arm: round(float(value), 5) for arm, value in error.items()}
    column = 1 + EARS.index(ear)
    lost = {name: np.array([row["causes"][name] for row in rows]).sum(axis=0) for name in CAUSES}
    out["lost"] = {name: [int(one[0]), int(one[column])] for name, one in lost.items()}
    firsts = sorted(row["first_frame_us"] or -1 for row in rows)
    out["first_frame_ms"] = round(firsts[len(firsts) // 2] / 1000, 1)
    out["cpu_s"] = round(sum(row["cpu_s"] for row in rows), 1)
    return out


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of each condition, in the order of CONDITIONS."""
    told = {}
    for condition in CONDITIONS:
        mine = [row for row in rows if row["condition"] == condition.name]
        if any(row["blocks"]["ours"] for row in mine):
            told[condition.name] = figures(mine)
    return told


def _words(one: dict[str, Any]) -> str:
    return str(Share(one["value"], one["low"], one["high"], one["n"])) if one["n"] else "-"


def page(told: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    lines = ["## Moving beacons beside the genie", "", "Evidence: simulated; quoted: hardware (published), not ranked."]
    group = ""
    for name, one in told.items():
        if one["group"] != group:
            group = one["group"]
            text = "uart" in group
            other = "`wang2022` on our tracks" if text else "the paper's receiver on our tracks"
            lines += ["", f"### {group[0].upper()}{group[1:]}", ""]
            lines += [
                f"| | paper (quoted) | {other} | ours | genie | ours - genie | lost by ours | n |",
                "|" + "---|" * 8,
            ]
        lost = ", ".join(f"{k} {n} ({g})" for k, (n, g) in one["lost"].items() if n) or "none"
        ours = _words(one["ours"])
        if "uart" in group:
            ours = f"{ours}; CER {one['cer']['ours']:.4f}"
        cells = [name, str(QUOTED.get(name, "-")), _words(one["other"]), ours, f"{_words(one['genie'])} {one['ear']}"]
        cells += [_words(one["minus_genie"]), lost, f"{one['ours']['n']} frames, {one['runs']} runs"]
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "",
        "MAR_sent (visible), K = 1; intervals: 95 %, bootstrap over run x beacon x 1 s. Lost: frames by cause, in",
    ]
    lines += ["brackets those that the genie read; `core`, `whole`: its better ear."]
    return "\n".join(lines)


def line(name: str, one: dict[str, Any]) -> str:
    """Return a condition's figures as one line."""
    lost = ", ".join(f"{k} {n}/{g}" for k, (n, g) in one["lost"].items() if n)
    return (
        f"{name:42} ours {_words(one['ours'])} genie {_words(one['genie'])} {one['ear']:5}"
        f" - {_words(one['minus_genie'])} other {_words(one['other'])} cer {one['cer']['ours']:.4f}"
        f" n {one['ours']['n']} first {one['first_frame_ms']} ms ins {one['insertions']['ours']} lost {lost}"
        f" cpu {one['cpu_s']}"
    )


def code() -> str:
    """Return what tells one state of the code from another."""
    digest = hashlib.sha256()
    for folder in ("common", "services"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in {".py", ".toml"}:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, default=ROOT / "bench/results/link_moving.json")
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--only", nargs="+", default=[""], help="conditions whose name or group holds one of these")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--summary", action="store_true")
    args = parser.parse_args()
    stored = json.loads(args.o.read_text()) if args.o.exists() else {}
    now = code()
    if args.page or args.summary:
        told = summary(stored.get("rows", []))
        print(page(told) if args.page else "\n".join(line(name, one) for name, one in told.items()))
        return
    rows: list[dict[str, Any]] = stored.get("rows", []) if stored.get("code") == now else []
    done = {(row["condition"], row["seed"]) for row in rows}
    for condition in CONDITIONS:
        if not any(word in condition.name or word in condition.group for word in args.only):
            continue
        for seed in range(args.first, args.first + args.runs):
            if (condition.name, seed) in done:
                continue
            rows.append(row_of(condition, seed))
            save(args.o, now, rows)
        print(line(condition.name, figures([row for row in rows if row["condition"] == condition.name])), flush=True)


def save(path: Path, now: str, rows: list[dict[str, Any]]) -> None:
    """Write what there is, a run a line."""
    result: dict[str, Any] = {"study": STUDY, "evidence": "simulated", "fidelity": "live", "code": now}
    result |= {"hardware (published)": QUOTED, "figures": summary(rows), "rows": rows}
    text = json.dumps(result, separators=(",", ":")).replace('{"condition"', '\n{"condition"')
    path.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
