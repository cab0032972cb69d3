"""The tables and plots of study 7: what was told where there was nothing to tell, with the time that was listened."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, Final

from heliograph_services.cli.studies.study import Counts, Done, Dots, Figure, Row, Table

# Lights of a camera (`false_lights`).
CAMERA: Final = 32
HOUR_S: Final = 3600.0
# 95 %: of nothing found in T, ln 20 / T.
NOTHING: Final = 3.0
REPEATED: Final = ("read as a word", "square waves", "told wrongly", "a light, at most")
COLUMNS: Final = ("told wrongly", "track-hours", "camera-hours", "a track-hour, at most", "a camera-hour, at most")


def tables(done: Sequence[Done]) -> list[Table]:
    """Return false alarms, confusions, and what was told wrongly, light by light."""
    lights = [one for one in done if one["part"] in {"lights", "clocked"}]
    rows = _scene([one for one in done if one["part"] == "scene"])
    rows += _readers("clutter, pixel by pixel", [one for one in done if one["part"] == "clutter"])
    for part, what, camera in (
        ("lights", "clutter, tracks", CAMERA),
        ("clocked", "random bits at the reader's clock", 0),
    ):
        mine = [(one["protocol"], one.counts) for one in lights if one["part"] == part]
        rows += [_row(f"{what}: {name}", each, camera) for name, each in _by_protocol(mine).items()]
    others = _readers("beacons of others", [one for one in done if one["part"] == "strangers"])
    others += _readers("a crowd of `code`", [one for one in done if one["part"] == "crowd heard"])
    crowds = [_crowd(one) for one in done if one["part"] == "crowd"]
    repeated = [_repeated(one) for one in done if one["part"] == "repeaters"]
    note = "Bounds: 3 / T where nothing was found, else the rate that was found. No such figures are in the paper."
    return [
        Table("False alarms", COLUMNS, rows, note),
        Table("Confusions: readers of other protocols", COLUMNS, [*others], note),
        Table("A hundred beacons through the whole system", ("confusions", "false alarms", "frames right"), crowds),
        Table(
            "Lights that repeat themselves in step with a word",
            REPEATED,
            repeated,
            "Flashes, PWM and foreign words whose period is that of a word or a whole part of it. *Read*: as many equal"
            " frames as an identity takes, or more. *Square waves*: told as a payload that any PWM of that period is.",
        ),
        Table("Told wrongly, light by light", ("times",), _told(done), "`protocol@bit rate` of the reader."),
    ]


def panels(done: Sequence[Done]) -> list[Dots]:
    """Return what is told wrongly at most: by kind of light a dot for each protocol's reader."""
    found: dict[str, dict[str, dict[str, Figure]]] = {}
    for table in tables(done)[:2]:
        kinds = found.setdefault(table.title, {})
        for row in table.rows:
            kind, _, protocol = row.what.partition(": ")
            if protocol:
                kind = kind.replace(" of it", " of the room")
                kinds.setdefault(kind, {})[protocol] = row.figures["a track-hour, at most"]
    protocols = dict.fromkeys(name for kinds in found.values() for some in kinds.values() for name in some)
    label = "told wrongly a track-hour, at most (x: found)"
    return [
        Dots(
            title,
            label,
            list(kinds),
            {name: [some.get(name, Figure(None)) for some in kinds.values()] for name in protocols},
            log_x=True,
            bounds=True,
        )
        for title, kinds in found.items()
    ]


def _by_protocol(rows: Iterable[tuple[str, Counts]]) -> dict[str, dict[str, float]]:
    """Return heard seconds and what was told, of each protocol of (reader, counts)."""
    out: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for name, counts in rows:
        each = out[name.split("@")[0]]
        each["heard_s"] += counts["heard_s"]
        each["candidates"] += counts["candidates"]
        each["told"] += len(counts["told"])
    return out


def _bound(told: float, hours: float) -> Figure:
    if hours <= 0.0:
        return Figure(None)
    return Figure(float(f"{(told or NOTHING) / hours:.3g}"), unit="found" if told else "")


def _row(what: str, each: dict[str, float], camera: int) -> Row:
    hours, told = each["heard_s"] / HOUR_S, each["told"]
    of_camera = hours / camera if camera else 0.0
    figures = {
        "told wrongly": Figure(told),
        "track-hours": Figure(round(hours, 4)),
        "camera-hours": Figure(round(of_camera, 4)) if camera else Figure(None),
        "a track-hour, at most": _bound(told, hours),
        "a camera-hour, at most": _bound(told, of_camera),
    }
    return Row(what, "-", figures, f"{told:.0f} told" if told else "", f"{each['candidates']:.0f} lights x readers")


def _readers(what: str, done: Sequence[Done]) -> list[Row]:
    found = _by_protocol(item for one in done for item in one.counts["readers"].items())
    return [_row(f"{what}: {name}", each, 0) for name, each in found.items()]


def _scene(done: Sequence[Done]) -> list[Row]:
    out: list[Row] = []
    for one in done:
        each = _by_protocol(one.counts["readers"].items())
        whole = "side_px" not in one.cell.parameters
        if whole:
            told = sum(value["told"] for value in each.values())
            seconds = one.counts["seconds"]
            figures = {
                "told wrongly": Figure(told),
                "camera-hours": Figure(round(seconds / HOUR_S, 6)),
                "a camera-hour, at most": _bound(told, seconds / HOUR_S),
            }
            n = f"{len(one.counts['readers'])} readers, {one.counts['tracks']} tracks"
            out.append(Row("a room without a beacon", "-", figures, "", n, "recording"))
        else:
            rows = [_row(f"squares of {one['side_px']} px of it: {name}", value, 0) for name, value in each.items()]
            out += [Row(row.what, "-", row.figures, row.worse, row.n, "recording") for row in rows]
    return out


def _crowd(one: Done) -> Row:
    counts = one.counts
    right, n = counts["received"]["right"], counts["received"]["n"]
    figures = {
        "confusions": Figure(float(counts["confusions"])),
        "false alarms": Figure(float(counts["false_alarms"])),
        "frames right": Figure(round(right / n, 5) if n else None, n=n),
    }
    worse = "" if not counts["confusions"] + counts["false_alarms"] else "see the counts"
    told = f"{counts['identified']} identifications, {n} frames, {one['seconds']:g} s"
    return Row("`crowd`, `code20d4` at 1 kbit/s", "-", figures, worse, told)


def _repeated(one: Done) -> Row:
    counts = one.counts
    n, told = counts["candidates"], len(counts["told"])
    figures = {
        "read as a word": Figure(float(counts["read"])),
        "square waves": Figure(float(counts["square"])),
        "told wrongly": Figure(float(told)),
        "a light, at most": Figure(float(f"{(told or NOTHING) / n:.3g}"), unit="found" if told else ""),
    }
    return Row(f"{one['protocol']} at {one['rate']} bit/s", "-", figures, f"{told} told" if told else "", f"{n} lights")


def _told(done: Sequence[Done]) -> list[Row]:
    """Say what was told, light by light: a number alone helps nobody to avoid it."""
    found: dict[str, int] = defaultdict(int)
    for one in done:
        by: dict[str, Any] = one.counts.get("readers", {})
        if "told" in one.counts:
            by = {f"{one['protocol']}@{one['rate']}": one.counts}
        for name, counts in by.items():
            for each in counts["told"]:
                said = ", ".join(dict.fromkeys(map(str, each["identities"]))) or "text"
                found[f"{each['light']} read by `{name}` as {said}"] += 1
    return [Row(what, "-", {"times": Figure(float(n))}, "wrong", "1 run") for what, n in found.items()]
