"""`heliograph bench link`: our receiver and others', on the events of single lights, better and worse.

No scene and no tracker: what a receiver hears of one light (cli/link_light.py), with one kind of damage at a time. For
each section (protocol and bit rate), condition and receiver: MAR sent and received, BAR, FER, BER, CER, goodput, false
identifications on lights that are no beacons, with n and 95 % intervals (heliograph.shares), and the share of a
core. A frame is decided on its own bits (K = 1) by all of them. *Tuned* receivers are tuned on development seeds for
each condition (cli/link_tuning.py); all are judged on the study's own seeds. The genie (cli/link_genie.py) knows clock,
alignment and light: what is to be had. Evidence: simulated.

With -o FILE a row that is there is not made again, unless the receivers' sources have changed: a run that was cut goes
on. The file counts the looks at the study's seeds; --development looks at seeds 0 to 99 instead.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from heliograph.accuracy import bits_right, mar_received, mar_sent
from heliograph.errors import ConfigError, FileError
from heliograph.shares import most_events
from heliograph.units import US_PER_S
from heliograph_services.cli.bench import this_machine
from heliograph_services.cli.link_genie import genie
from heliograph_services.cli.link_light import Damage
from heliograph_services.cli.link_trials import (
    NO_BEACONS,
    Scored,
    Section,
    alarms,
    blocks_of,
    make_trial,
    no_beacon,
    run_trial,
    score,
    slots_of,
)
from heliograph_services.cli.link_tuning import CONTENDERS, GENIE, Contender, maker, plain, tune

NAME: Final = "bench link, release 1"
# 40 pixels make 100 events an edge, 80 make 200: as many as the recordings of text at 3125 bit/s have.
SECTIONS: Final = (
    Section("seed11", 500.0, 40),
    Section("seed11", 2000.0, 40),
    Section("uart", 3125.0, 80),
)
CONDITIONS: Final = {
    "clean": Damage(),
    "lost 50 %": Damage(lost=0.5),
    "lost 80 %": Damage(lost=0.8),
    "lost 95 %": Damage(lost=0.95),
    "first 20 lost": Damage(first_lost=20),
    "first 80 lost": Damage(first_lost=80),
    "event jitter .1": Damage(event_jitter_bits=0.1),
    "event jitter .3": Damage(event_jitter_bits=0.3),
    "edge jitter .1": Damage(edge_jitter_bits=0.1),
    "edge jitter .2": Damage(edge_jitter_bits=0.2),
    "edge jitter .4": Damage(edge_jitter_bits=0.4),
    "noise 1e4/s": Damage(noise_hz=1e4),
    "noise 1e5/s": Damage(noise_hz=1e5),
    "dropped 2 %": Damage(dropped=0.02),
    "dropped 10 %": Damage(dropped=0.1),
}
# Identifications of these are false; a frame or a character is none.
ALARM: Final = "no beacon: "
_LINK: Final = Path(__file__).parents[3] / "common" / "heliograph" / "link"


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    parser = argparse.ArgumentParser(prog="heliograph bench link", description="Compare receivers on single lights.")
    parser.add_argument("--json", action="store_true", help="one JSON object a row")
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="keep results there, and go on from them")
    parser.add_argument("--runs", type=int, default=8, metavar="N", help="lights a condition (default: 8)")
    parser.add_argument("--seconds", type=float, default=2.5, metavar="S", help="of each light (default: 2.5)")
    parser.add_argument("--section", metavar="TEXT", default="", help="only sections with it in their names")
    parser.add_argument("--condition", metavar="TEXT", default="", help="only conditions with it in their names")
    parser.add_argument("--development", action="store_true", help="look at seeds 0 to 99, not at the study's")
    arguments = parser.parse_args(argv)
    if not 2 <= arguments.runs <= 96:
        raise ConfigError(f"--runs must be in [2, 96], not {arguments.runs}")
    if not 1.0 <= arguments.seconds <= 60.0:
        raise ConfigError(f"--seconds must be in [1, 60], not {arguments.seconds:g}")
    sections = [section for section in SECTIONS if arguments.section in section.name]
    names = [*CONDITIONS, *(ALARM + kind for kind in NO_BEACONS)]
    conditions = [name for name in names if arguments.condition in name]
    if not sections:
        raise ConfigError(f"--section must be part of {'; '.join(s.name for s in SECTIONS)}, not {arguments.section!r}")
    if not conditions:
        raise ConfigError(f"--condition must be part of {'; '.join(names)}, not {arguments.condition!r}")
    book = Book(arguments.out, arguments.runs, arguments.seconds, development=arguments.development)
    _warm(sections)
    for section in sections:
        if not arguments.json:
            print(_head(section, book))
        frames = set()
        for condition in conditions:
            for row in book.rows(section, condition):
                print(json.dumps({"type": "link", **row}) if arguments.json else line(row), flush=True)
                frames |= {row["n"]} if "n" in row else set()
        if frames and not arguments.json:
            print(
                f"  n: {min(frames)} frames a row, of {book.runs} lights; intervals by blocks of a light and a second"
            )
    return 0


class Book:
    """Rows that are made once, and kept in a file where there is one.

    Args:
        path: the file, or None.
        runs: lights a condition.
        seconds: of each.
        development: whose seeds.

    Raises:
        FileError: the file is there and not one of ours.
    """

    def __init__(self, path: Path | None, runs: int, seconds: float, *, development: bool) -> None:
        self._path = path
        self.runs = runs
        self.seconds = seconds
        # Tuning looks at 0 to 3.
        self.first_seed = 4 if development else study_seed(NAME)
        self.about: dict[str, Any] = {
            "study": NAME,
            "evidence": "simulated",
            "seeds": "development" if development else "study",
            "first_seed": self.first_seed,
            "runs": runs,
            "seconds": seconds,
            "sources": sources(),
        }
        self._looks = 0
        self._rows: dict[tuple[str, str, str], dict[str, Any]] = {}
        if path is not None and path.exists():
            self._load(path)

    def _load(self, path: Path) -> None:
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            looks, about, rows = int(kept["looks"]), kept["about"], list(kept["rows"])
            by_key = {(row["section"], row["condition"], row["receiver"]): row for row in rows}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FileError(f"{path}: no results of `heliograph bench link`: {error}") from None
        self._looks = looks
        if about == self.about:
            self._rows = by_key

    def rows(self, section: Section, condition: str) -> Iterator[dict[str, Any]]:
        """Yield the rows of all receivers in a condition."""
        for contender in CONTENDERS[section.protocol]:
            if condition.startswith(ALARM) and (contender.tuned or contender.name == GENIE):
                continue  # what would it be tuned to, and what should a genie know of it?
            key = (section.name, condition, contender.name)
            if key not in self._rows:
                make = self._alarms if condition.startswith(ALARM) else self._trials
                row = make(section, condition, contender)
                self._looks += not self._rows
                self._rows[key] = {"section": section.name, "condition": condition, "receiver": contender.name, **row}
                self._keep()
            yield self._rows[key]

    def _keep(self) -> None:
        if self._path is None:
            return
        head = json.dumps({"about": self.about, "machine": this_machine(), "looks": self._looks}, indent=1)
        rows = ",\n  ".join(json.dumps(row) for row in self._rows.values())  # a row a line: differences can be read
        beside = self._path.with_suffix(".part")
        try:
            beside.write_text(f'{head[:-2]},\n "rows": [\n  {rows}\n ]\n}}\n', encoding="utf-8")
            os.replace(beside, self._path)  # noqa: PTH105 - at once, so that a cut run leaves a whole file
        except OSError as error:
            raise FileError(f"{self._path}: cannot be written: {error}") from None

    def _trials(self, section: Section, condition: str, contender: Contender) -> dict[str, Any]:
        damage, slots = CONDITIONS[condition], slots_of(section)
        trials = (make_trial(section, damage, self.seconds, self.first_seed + i) for i in range(self.runs))
        parameters = tune(section, contender, damage, self.seconds) if contender.tuned else None
        if contender.name == GENIE:
            runs = [
                Scored(score(trial, genie(section, trial), slots), 0.0, trial.seen.until_us / US_PER_S)
                for trial in trials
            ]
        else:
            make = maker(section, contender, parameters)
            runs = [run_trial(trial, make, slots) for trial in trials]
        return {"parameters": plain(parameters), **figures(runs, section, slots.payload_bits)}

    def _alarms(self, section: Section, condition: str, contender: Contender) -> dict[str, Any]:
        kind = condition.removeprefix(ALARM)
        make = maker(section, contender)
        found = [
            alarms(make, no_beacon(kind, section, 2.0 * self.seconds, self.first_seed + i)) for i in range(self.runs)
        ]
        seconds = sum(one.seconds for one in found)
        identities, frames = sum(one.identities for one in found), sum(one.frames for one in found)
        return {
            "track_s": round(seconds, 1),
            "identities": identities,
            "identities_per_track_hour": round(identities / seconds * 3600.0, 1),
            "at_most_per_track_hour": round(most_events(identities) / seconds * 3600.0, 1),
            "frames": frames,
            "frames_per_s": round(frames / seconds, 3),
            "core_share": round(sum(one.cpu_s for one in found) / seconds, 4),
        }


def study_seed(name: str) -> int:
    """Return the first of a study's seeds, far beyond the development seeds."""
    return 1_000 + int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "little")


def sources() -> str:
    """Return a digest of all that the figures depend on: the link, and this bench."""
    beside = Path(__file__).parent
    own = [
        beside / name
        for name in ("bench_link.py", "link_genie.py", "link_light.py", "link_trials.py", "link_tuning.py")
    ]
    digest = hashlib.sha256()
    for path in [*sorted(_LINK.rglob("*.py")), *own]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def figures(runs: list[Scored], section: Section, payload_bits: int) -> dict[str, Any]:
    """Return the figures of a row: counts added over seconds and runs, then divided."""
    blocks = blocks_of(runs)
    total = {name: float(column.sum()) for name, column in blocks.items()}
    errors = total["sent"] - total["right"] + total["inserted"]
    camera_s = sum(run.camera_s for run in runs)
    row = {
        "n": int(total["sent"]),
        "runs": len(runs),
        "mar_sent": mar_sent(blocks["right"], blocks["sent"]).row(),
        "mar_received": mar_received(blocks["right"], blocks["wrong"], blocks["inserted"]).row(),
        "bar": bits_right(blocks["bits_right"], blocks["bits"]).row(),
        "bar_by_chance": round(total["chance"] / max(total["bits"], 1.0), 4),
        "fer": round(1.0 - total["right"] / max(total["sent"], 1.0), 5),
        "wrong": int(total["wrong"]),
        "inserted": int(total["inserted"]),
        "goodput_bit_s": round(total["right"] * payload_bits * 1e6 / max(total["sent_us"], 1.0), 1),
        "core_share": round(sum(run.cpu_s for run in runs) / camera_s, 4),
    }
    if total["bits_matched"]:
        row["ber"] = round(1.0 - total["bits_right"] / total["bits_matched"], 6)
    if section.protocol == "uart":
        row["cer"] = round(errors / max(total["sent"], 1.0), 5)
    return row


def _warm(sections: list[Section]) -> None:
    """Load all kernels: the decoder's, and a short light for every receiver."""
    from heliograph_services.decoder.warming import warm_all  # noqa: PLC0415 - numba, not needed for --help

    warm_all()
    for section in sections:
        light = make_trial(section, Damage(event_jitter_bits=0.1), 1.0, 0)
        for contender in CONTENDERS[section.protocol]:
            if contender.name == GENIE:
                continue
            run_trial(light, maker(section, contender), slots_of(section))


def _head(section: Section, book: Book) -> str:
    seeds = f"seeds {book.first_seed} to {book.first_seed + book.runs - 1}"
    return (
        f"\n{section.name}, {section.pixels} pixels, {book.runs} lights of {book.seconds:g} s, {seeds}; simulated\n"
        f"  {'condition':<16}{'receiver':<16}{'MAR sent [95 %]':<20}{'received':>8}{'BAR':>6}{'wrong':>6}{'core':>6}"
    )


def line(row: dict[str, Any]) -> str:
    """Return a row for people, at most 80 columns wide."""
    if "identities" in row:
        kind = row["condition"].removeprefix(ALARM)
        bound = f"{row['identities']} ids in {row['track_s']:g} s (<= {row['at_most_per_track_hour']:.0f}/h)"
        told = f"{bound}, {row['frames']} frames"
        return f"  {kind:<16}{row['receiver']:<16}{told:<40}{row['core_share']:>6.3f}"
    sent, received = row["mar_sent"], row["mar_received"]
    interval = f"{sent['value']:.3f} [{sent['low']:.3f} {sent['high']:.3f}]"
    got = f"{received['value']:.3f}" if received["n"] else "-"
    wrong = row["wrong"] + row["inserted"]
    return (
        f"  {row['condition']:<16}{row['receiver']:<16}{interval:<20}{got:>8}{row['bar'].get('value', 0.0):>6.2f}"
        f"{wrong:>6}{row['core_share']:>6.3f}"
    )
