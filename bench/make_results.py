"""Write docs/results.md from stored results: one function a section, every number from bench/results.

    python bench/make_results.py [--check]

`--check` writes nothing and fails if the page is not what the results give. A section whose results are not there is
left out. Bounds are for 95 %: of nothing found in T, 3 / T (ln 20 = 3.0).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import link_sections
from false_lights import CAMERA
from link_sections import table

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "bench" / "results"
PAGE = ROOT / "docs" / "results.md"
HEAD = """# Results

Written by `bench/make_results.py` from the results stored in `bench/results`; definitions: [metrics](metrics.md).
Nothing is ranked across kinds of evidence. A bound is what nothing found excludes with 95 %: 3 / T.
"""
Rows = list[dict[str, Any]]


def number(value: float) -> str:
    """Return a number as people read it."""
    if value >= 1e5 or 0.0 < value < 1e-2:
        return f"{value:.1e}"
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def bound(found: int, amount: float) -> str:
    """Return the 95 % bound of a rate: 3 / T where nothing was found, else found / T."""
    if amount <= 0.0:
        return "-"
    return f"< {number(3.0 / amount)}" if not found else f"**{number(found / amount)}**"


def alarm_rows() -> Rows:
    """Return the lines of the study of false alarms; of its releases the newest alone."""
    path = RESULTS / "false_alarms.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    return [row for row in rows if row["release"] == rows[-1]["release"]]


def _by_protocol(rows: Iterable[tuple[str, dict[str, Any]]]) -> dict[str, dict[str, float]]:
    """Return heard seconds, candidates, frames and what was told, of each protocol of (reader, row)."""
    out: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for name, row in rows:
        protocol = name.split("@")[0]
        out[protocol]["heard_s"] += row["heard_s"]
        out[protocol]["candidates"] += row["candidates"]
        out[protocol]["frames"] += row["frames"]
        out[protocol]["told"] += len(row["told"])
    return out


def _readers(rows: Rows, part: str) -> list[tuple[str, dict[str, Any]]]:
    return [item for row in rows if row["part"] == part for item in row.get("readers", {}).items()]


def scene_section(rows: Rows) -> str:
    """The recorded scene without a beacon."""
    mine = [row for row in rows if row["part"] == "scene"]
    whole = next((row for row in mine if "side_px" not in row), None)
    if whole is None:
        return ""
    told = sum(len(row["told"]) for row in whole["readers"].values())
    text = (
        "### A room without a beacon\n\n"
        f"Mains flicker, {whole['seconds']:.2f} s, 640 x 480 pixels, through source, tracker and"
        f" {len(whole['readers'])} readers: every protocol at every bit rate (50 to 20,000 bit/s and faster ones), with"
        f" its rate measured, and `auto`. The tracker makes {whole['tracks']} tracks of it; told: {told}. Evidence:"
        " recording, n = 1.\n"
    )
    squares = [item for row in mine if "side_px" in row for item in row["readers"].items()]
    lines = [
        (name, f"{each['candidates']:.0f}", f"{each['heard_s'] / 3600:.2f}", f"{each['told']:.0f}",
         bound(int(each["told"]), each["heard_s"] / 3600))
        for name, each in _by_protocol(squares).items()
    ]  # fmt: skip
    head = ("protocol", "squares x readers", "track-hours", "identified or text", "a track-hour")
    if not lines:
        return text
    more = "\nEach square of it that holds light, given to every reader as though it were a track:\n\n"
    return text + more + table(head, lines) + "\n"


def clutter_section(rows: Rows) -> str:
    """Lights that are no beacons, by pixels and by tracks."""
    pixels, lights = _readers(rows, "clutter"), [row for row in rows if row["part"] == "lights"]
    if not lights:
        return ""
    by_pixels = _by_protocol(pixels)
    by_track = _by_protocol((row["protocol"], row) for row in lights)
    camera_s = sum(row["seconds"] for row in rows if row["part"] == "clutter")
    lines = []
    for protocol, each in by_track.items():
        other = by_pixels.get(protocol, {"heard_s": 0.0, "told": 0.0})
        hours, told = each["heard_s"] / 3600.0, int(each["told"])
        lines.append((
            protocol, f"{other['heard_s'] / 3600:.2f}", f"{other['told']:.0f}", f"{hours / CAMERA:.2f}",
            f"{hours:.1f}", told, bound(told, hours / CAMERA), bound(told, hours),
        ))  # fmt: skip
    head = ("protocol", "pixels: track-hours", "told", "tracks: camera-hours", "track-hours", "told",
            "a camera-hour", "a track-hour")  # fmt: skip
    return (
        "### Clutter\n\n"
        "Everything that blinks and is no beacon: random bits, telegraphs, lamps, PWM, glints, moving edges, monitors,"
        f" noise. *Pixels*: {camera_s:.0f} s of the scenario `clutter` through source, tracker and regions, what each"
        " track hears read by every reader (at most 20,000 bits). *Tracks*: lights of the same kinds as events of a"
        f" track, fresh parameters for each, {CAMERA} a camera, the time shared over the bit rates so that each hears"
        " as many bits. Counted are identifications and texts. Evidence: simulated.\n\n" + table(head, lines) + "\n"
    )


def clocked_section(rows: Rows) -> str:
    """Random bits at the reader's own clock."""
    mine = [row for row in rows if row["part"] == "clocked"]
    if not mine:
        return ""
    cells: dict[str, dict[float, list[float]]] = defaultdict(lambda: defaultdict(lambda: [0.0, 0.0]))
    for row in mine:
        cell = cells[row["protocol"]][row["rate"]]
        cell[0] += row["heard_s"]
        cell[1] += len(row["told"])
    lines = []
    for protocol, each in cells.items():
        bits = sum(rate * heard_s for rate, (heard_s, _) in each.items())
        told = int(sum(n for _, n in each.values()))
        minutes = [heard_s / 60.0 for heard_s, _ in each.values()]
        lines.append((protocol, len(each), f"{min(minutes):.1f} to {max(minutes):.1f}", number(bits), told,
                      bound(told, bits)))  # fmt: skip
    head = ("protocol", "bit rates", "minutes each", "bits", "identified or text", "a bit position")
    return (
        "### Random bits at the reader's own clock\n\n"
        "The worst there is: a light on a clock within .2 % of the reader's, each bit lit by chance (.3, .5 or .7)."
        " Evidence: simulated, as events of a track.\n\n" + table(head, lines) + "\n"
    )


def frames_section() -> str:
    """Random frames through the decisions."""
    path = RESULTS / "false_frames.json"
    if not path.is_file():
        return ""
    stored = json.loads(path.read_text())
    lines = []
    for name, row in stored["rows"].items():
        counts = row["counts"]
        stages = ", ".join(
            f"{key.split('_')[1]}: {value:,}" for key, value in counts.items() if key.startswith("equal_")
        )
        lines.append((name, f"{counts['frames']:,}", f"{counts['accepted']:,}", stages, counts["identities"],
                      bound(counts["identities"], counts["frames"])))  # fmt: skip
    head = ("code, light", "frames", "accepted", "rows of equal (uart: good) ones", "identities", "a frame")
    return (
        "### Random frames\n\n"
        "Random bits at the very clock, each bit position taken for the beginning of a frame, through the decisions of"
        " the receivers (`bench/random_frames.py`). `clear`: 20 events a change, `dim`: 3. Rows of equal frames are"
        " counted whatever their evidence; an identity asks for that too. Evidence: simulated, at the level of slots"
        " and bits.\n\n" + table(head, lines) + "\n"
    )


def confusion_section(rows: Rows) -> str:
    """Beacons taken for others."""
    crowds = [row for row in rows if row["part"] == "crowd"]
    heard, strangers = _readers(rows, "crowd heard"), _readers(rows, "strangers")
    if not crowds and not strangers:
        return ""
    out = "### Confusions\n\n"
    if crowds:
        total = {
            key: sum(row[key] for row in crowds) for key in ("identified", "confusions", "false_alarms", "seconds")
        }
        out += (
            f"`crowd`, a hundred beacons of `code`, {total['seconds']:.0f} s through the whole system"
            f" (n = {len(crowds)} runs): {total['identified']} identifications, {total['confusions']} confusions"
            f" ({bound(total['confusions'], total['identified'])} an identification), {total['false_alarms']} false"
            " alarms. Evidence: simulated.\n\n"
        )
    lines = []
    of_beacons, of_crowds = _by_protocol(strangers), _by_protocol(heard)
    for protocol, each in of_beacons.items():
        other = of_crowds.get(protocol, {"heard_s": 0.0, "told": 0.0})
        told = int(each["told"] + other["told"])
        hours = (each["heard_s"] + other["heard_s"]) / 3600.0
        spans = [f"{one['heard_s'] / 3600:.2f}" for one in (each, other)]
        lines.append((protocol, spans[0], f"{each['told']:.0f}", spans[1], f"{other['told']:.0f}", bound(told, hours)))
    head = ("reader", "beacons of others: track-hours", "told", "crowd: track-hours", "told", "a track-hour")
    return out + (
        "Beacons of the other protocols, with random payloads, read at their bit rate and those about it (a fifth to"
        " five times); `auto` has to say nothing but what is sent.\n\n"
        + table(head, lines)
        + "\n"
        + _told_wrongly(rows)
    )


def _told_wrongly(rows: Rows) -> str:
    """Say what was told, light by light: a number alone helps nobody to avoid it."""
    found = [
        (f"{row['protocol']}@{row['rate']}", one) for row in rows if row["part"] == "lights" for one in row["told"]
    ]
    found += [(name, one) for row in rows for name, each in row.get("readers", {}).items() for one in each["told"]]
    told = [
        f"- {one['light']} read by `{name}` as {', '.join(dict.fromkeys(one['identities'])) or 'text'}"
        for name, one in found
    ]
    return "\nTold wrongly (`protocol@bit rate`):\n\n" + "\n".join(told) + "\n" if told else ""


def sections() -> list[Callable[[], str]]:
    """Return what writes the sections, in their order."""
    rows = alarm_rows()
    return [
        *link_sections.sections(),
        lambda: f"## False alarms and confusions\n\nSeeds of release `{rows[-1]['release']}`.\n" if rows else "",
        lambda: scene_section(rows),
        lambda: clutter_section(rows),
        lambda: clocked_section(rows),
        frames_section,
        lambda: confusion_section(rows),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    text = "\n".join([HEAD, *(part for part in (section() for section in sections()) if part)])
    if arguments.check:
        return int(not PAGE.is_file() or PAGE.read_text() != text)
    PAGE.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
