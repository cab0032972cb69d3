"""The table of figures in README.md, written from stored results: `python bench/make_results.py`.

A row: what was measured, its evidence, the figure as the stored results give it, where it comes from. No figure is
typed here, but one that a test counts (`_beacon`): numbers of a row's first column are conditions (a bit rate, a
distance). Shares are told with three digits, or more where less than one would read as one.
A row whose result is not there is an error: README's figures are those of every result that the project ships.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from link_sections import table

ROOT: Final = Path(__file__).parents[1]
HEAD: Final = ("what", "evidence", "figure", "command, stored result")
# The table: its head to its last row.
TABLE: Final = re.compile(r"(?<=\n## Figures\n\n)(?:\|.*\n)+")
RECORDED: Final = "recording (Wang et al., 2022)"
SAME: Final = "the same"
TUNED: Final = "the paper's receiver, tuned"
# Bit rates of the study of distance.
RATES: Final = (100, 1000, 2500)
Row = tuple[str, str, str, str]


def written(readme: str) -> str:
    """Return README's text with its table of figures as the stored results give it."""
    text, n = TABLE.subn(lambda _: table(HEAD, rows()) + "\n", readme)
    if n != 1:
        raise ValueError("README.md has no table of figures")
    return text


def rows() -> Iterator[Row]:
    """Yield the rows of the table."""
    yield from _recordings()
    yield from _accuracy()
    yield from _elsewhere()
    yield from _beacon()
    yield from _cost()


def share(value: float) -> str:
    """Return a share of one with three digits, or as many as keep less than one from being told as one."""
    digits = 3
    while value < 1.0 and round(value, digits) == 1.0:
        digits += 1
    return f"{value:.{digits}f}".removeprefix("0")


def decimal(value: float, digits: int) -> str:
    """Return a number with so many digits, and no zero before its point."""
    return re.sub(r"^0\.", ".", f"{value:.{digits}f}")


def stored(path: str) -> Any:
    """Return a stored result: of a `.jsonl`, its records."""
    text = (ROOT / path).read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()] if path.endswith(".jsonl") else json.loads(text)


def study_row(study: str, title: str, what: str) -> Any:
    """Return a row of a study: of the table whose title begins so."""
    tables = [one for one in stored(f"results/{study}.json")["tables"] if one["title"].startswith(title)]
    (row,) = [row for one in tables for row in one["rows"] if row["what"] == what]
    return row


def value(row: Any, column: str = "ours") -> float:
    """Return a figure of a study's row."""
    return float(row["figures"][column]["value"])


def beside_genie(row: Any) -> str:
    return f"{share(value(row))} (genie {share(value(row, 'genie'))})"


def record(path: list[Any], **which: Any) -> Any:
    """Return the one record that has these values."""
    (one,) = [one for one in path if all(one.get(name) == what for name, what in which.items())]
    return one


def by_study(name: str) -> str:
    return f"`heliograph evaluate {name}`, [results](docs/results.md)"


def _recordings() -> Iterator[Row]:
    where = "`python bench/bench_recordings.py`, [recordings](bench/results/recordings.json)"
    told = [one for one in stored("bench/results/recordings.json") if one["told"] == "protocol and bit rate"]
    names = {"504hz_100m.mat": "100 m, outdoors, 504 bit/s", "3125hz_30m.mat": "30 m, outdoors, 3125 bit/s"}
    thinned = []
    for name, light in names.items():
        mine = [one for one in told if one["recording"] == name]
        whole = record(mine, seed=None)
        wrong = f"{whole['wrong'] * whole['printed']:.0f} of {whole['printed']}"
        yield f"text of a beacon at {light}: characters wrong", RECORDED, wrong, where
        cers = [one["cer"] for one in mine if one["seed"] is not None]
        thinned.append(decimal(sum(cers) / len(cers), 4))
        where = SAME
    yield "the same two with a tenth of the events, mean CER of three seeds", RECORDED, " and ".join(thinned), SAME


def _accuracy() -> Iterator[Row]:
    row = study_row("bit_rate", "Codes", "VARIABLE_5000, 2500 bit/s")
    paper = f"the paper's receiver, tuned, {share(value(row, TUNED))}; the paper, quoted, {row['published']}"
    yield (
        "a still beacon at 50 cm, 2.5 kbit/s, indoors, every frame on its own: frames right", "simulated",
        f"{share(value(row))} ({paper})", by_study("bit_rate"),
    )  # fmt: skip
    title = "2 m/s, seed11 at 2 kbit/s"
    far, near = (study_row("moving", title, f"{metres} m, 16 mm: MAR") for metres in (16, 5))
    what = "beacon at 2 m/s, 16 m away, 16 mm lens, 2 kbit/s, every frame on its own: frames right"
    yield what, "simulated", beside_genie(far), by_study("moving")
    yield "the same at 5 m, where its image is the largest", "simulated", beside_genie(near), SAME
    wide = [beside_genie(study_row("moving", title, f"{metres} m, 3.6 mm: MAR")) for metres in (16, 5)]
    yield "the same, 3.6 mm lens, 16 m and 5 m away", "simulated", " and ".join(wide), SAME
    yield _moving_text()
    row = study_row("moving", "Images compared", "construction_site_nrp: MAR")
    said = row["published"].partition(",")[0].removeprefix("with flow MAR ")
    paper = f"the paper's receiver, tuned, {share(value(row, TUNED))}; the paper, quoted, {said}"
    yield (
        "a drone over a construction site, the paper's simulated camera, 50 bit/s: frames right", "simulated",
        f"{share(value(row))} ({paper}; genie {share(value(row, 'genie'))})", SAME,
    )  # fmt: skip
    yield _range()
    row = study_row("false_alarms", "A hundred beacons", "`crowd`, `code20d4` at 1 kbit/s")
    n = row["figures"]["frames right"]["n"]
    named = row["n"].partition(" ")[0]
    right = f"{value(row, 'frames right') * n:,.0f} of {n:,}, {value(row, 'confusions'):.0f} of {named} identifications"
    what = "a hundred beacons at once, 30 s: published frames that are right, confusions"
    yield what, "simulated", right, by_study("false_alarms")
    packets = stored("bench/results/packet.json")["packet/1 soft rate=2/3 dropped=0.05 burst=20"]["counts"]
    n = packets["trials"]
    yield (
        "packets of 16 bytes with a twentieth of the transitions lost: delivered, corrupt", "simulated",
        f"{packets['delivered']:,} of {n:,}, {packets['corrupt']}",
        f"`python bench/study_packet.py soft --dropped 0.05 --n {n}`, [packet](bench/results/packet.json)",
    )  # fmt: skip


def _moving_text() -> Row:
    tables = stored("results/moving.json")["tables"]
    (texts,) = [one for one in tables if one["title"] == "2 m/s, text (uart)"]
    errors = [row["figures"]["ours"] for row in texts["rows"] if row["what"].endswith(": CER")]
    worst = max(errors, key=lambda one: one["value"])
    what = "text of a beacon at 2 m/s, 5 m and 16 m away, 504 to 3125 bit/s: characters wrong at most"
    return what, "simulated", f"{decimal(worst['value'], 4)} of {worst['n']:,}", SAME


def _range() -> Row:
    def metres(where: str) -> list[float]:
        return [value(study_row("distance", "R95", f"codes, {where}, 16 mm, {rate} bit/s")) for rate in RATES]

    inside, sun = metres("indoors"), metres("sun")
    told = ", ".join(f"{one:.0f}" for one in sun)
    what = (
        "twelve beacons of .4 W/sr, 16 mm lens, indoors, 100 bit/s to 2.5 kbit/s: range with 95 % of all frames right"
        " (95 % bound); in full sun at 100 bit/s, 1 and 2.5 kbit/s"
    )
    return what, "simulated", f"{min(inside):.0f} m (the farthest tried); {told} m", by_study("distance")


def _elsewhere() -> Iterator[Row]:
    title = "Accuracy"
    links = ("one host", "0.5 Mbit/s, 200 ms", "2 Mbit/s, 50 ms, cut for 2 s")
    here, far, cut = (study_row("distribution", title, link) for link in links)
    late = [f"{value(row, 'acquired: median'):.0f} ms" for row in (far, here)]
    yield (
        "the tracker elsewhere, .5 Mbit/s and 200 ms each way: frames right; median time to identify (one host)",
        "simulated light, real processes",
        f"{share(value(far, 'MAR_sent'))} ({share(value(here, 'MAR_sent'))}); {late[0]} ({late[1]})",
        by_study("distribution"),
    )  # fmt: skip
    what = "the same, 2 Mbit/s and 50 ms, with the link cut for two seconds of twelve: frames right"
    yield what, "simulated light, real processes", share(value(cut, "MAR_sent")), SAME


def _beacon() -> Iterator[Row]:
    # The one figure without a stored result: the test counts, and fails where a count is another.
    yield (
        "beacon's firmware, 1000 commands on a line with 5 % bad bytes and lost answers: applied, done twice",
        "simulated line, the firmware's own core", "1000, 0", "`pytest tests/beacon/test_exactly_once.py -s`",
    )  # fmt: skip
    avr = record(stored("bench/results/firmware.jsonl"), what="avr")
    yield (
        f"{avr['changes']} live changes of payload at 5 kbit/s: damaged frames, error of an interval",
        "emulated (simavr, AVR)", f"{avr['damaged']}, at most {avr['worst_error_ns']:.0f} ns",
        "`python bench/study_firmware.py`, [firmware](bench/results/firmware.jsonl)",
    )  # fmt: skip


def _cost() -> Iterator[Row]:
    cost = stored("bench/results/decoder_cost.json")
    flat = record(cost["flat"], what="decoder", scene_mev_s=5.0)
    where = "`python bench/bench_decoder.py`, [decoder_cost](bench/results/decoder_cost.json)"
    what = "the decoder from bus bytes, twenty beacons at 2 kbit/s, 5 Mev/s"
    yield what, "simulated", f"{decimal(flat['core'], 2)} of a core", where
    scans, none = (record(cost["scans"], beacons=20, scan_us=scan_us) for scan_us in (199.0, 0.0))
    yield (
        "the same twenty at 1 Mev/s behind scans of 199 us, as of a DVXplorer Mini (without scans)", "simulated",
        f"{decimal(scans['core'], 2)} of a core ({decimal(none['core'], 2)})", SAME,
    )  # fmt: skip
    lines = stored("bench/results/decode.jsonl")
    fragments = record(lines, rate_mev_s=1.0, texture="fragments")
    false_tracks = fragments["tracks"] - len(fragments["identified"])
    where = "`heliograph bench decode`, [decode](bench/results/decode.jsonl)"
    for what, line in (
        ("events read end to end in one process, five beacons among moving contours, 10 Mev/s of camera time",
         record(lines, rate_mev_s=10.0, texture="contours")),
        ("the same at 1 Mev/s", record(lines, rate_mev_s=1.0, texture="contours")),
        (f"the same, 1 Mev/s of faint fragments, of which {false_tracks} become false tracks", fragments),
    ):  # fmt: skip
        end = record(line["stages"], name="end to end")
        yield what, "simulated", f"{end['mev_s']:.1f} Mev/s, {decimal(end['core_share'], 2)} of a core", where
        where = SAME
    moving = record(stored("bench/results/simulation.json")["rows"], corpus="moving")
    yield (
        "a simulated second of a drone over textured ground, ten beacons at 2 kbit/s", "simulated",
        f"{decimal(moving['cpu_s_a_s'], 2)} CPU s",
        "`python bench/bench_simulation.py`, [simulation](bench/results/simulation.json)",
    )  # fmt: skip
