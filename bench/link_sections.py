"""Sections of docs/results.md that tell the link's accuracy and cost: one function each, numbers from bench/results."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
HOPS = ("half bit", "batch", "source", "bus", "wait", "decode", "publish", "subscriber", "whole")


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table in Markdown."""
    lines = [list(head)]
    lines.append(["---"] * len(lines[0]))
    lines += [[str(value) for value in row] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _stored(name: str) -> Any:
    path = RESULTS / name
    return json.loads(path.read_text()) if path.is_file() else None


def packet_section() -> str:
    """What of the packets arrives, and whether any is corrupt."""
    stored = _stored("packet.json")
    if not stored:
        return ""
    rows = []
    for name, one in stored.items():
        _, mode, *settings = name.split()
        counts = one["counts"]
        n = counts["trials"]
        rows.append((
            mode, ", ".join(settings), f"{n:,}", f"{counts['delivered'] / n:.5f}" if mode != "noise" else "-",
            counts["corrupt"], f"< {3.0 / n:.1e}" if not counts["corrupt"] else f"{counts['corrupt'] / n:.1e}",
        ))  # fmt: skip
    head = ("level", "setting", "packets or messages", "delivered", "corrupt", "corrupt, a packet")
    return (
        "## Packets\n\n`bench/study_packet.py`; 5 kbit/s, 16 bytes a message. `soft`: likelihoods of slots, `light`:"
        " events of a track, `events`: simulated scenes through the whole system, `noise`: no light at all. Evidence:"
        " simulated.\n\n" + table(head, rows) + "\n"
    )


def _recording_lines(rows: list[dict[str, Any]]) -> list[tuple[object, ...]]:
    out: list[tuple[object, ...]] = []
    told = dict.fromkeys((row["recording"], row["told"]) for row in rows)
    for recording, how in told:
        mine = [row for row in rows if (row["recording"], row["told"]) == (recording, how)]
        whole = next(row for row in mine if row["seed"] is None)
        thinned = [row["cer"] for row in mine if row["seed"] is not None]
        each = " ".join(f"{value:.4f}" for value in thinned)
        out.append((
            recording, how, whole["printed"], f"{whole['whole_pass_cer']:.4f}", f"{whole['wrong']:.4f}",
            f"{sum(thinned) / len(thinned):.4f} [{each}]",
        ))  # fmt: skip
    return out


def recordings_section() -> str:
    """The recordings of a real beacon."""
    rows = _stored("recordings.json")
    if not rows:
        return ""
    head = ("recording", "told", "printed", "CER, whole pass", "wrong of all printed", "CER, a tenth of the events")
    return (
        "## Recordings of a real beacon\n\n`python bench/bench_recordings.py FOLDER`; recordings of Wang et al. (2022),"
        " academic use only, not shipped. Cold start within a pass, causal. Development data: the receiver was built"
        " while looking at them. Evidence: recording, n = 1 each; the tenth: three seeds.\n\n"
        + table(head, _recording_lines(rows))
        + "\n"
    )


def cost_section() -> str:
    """What the decoder costs."""
    stored = _stored("decoder_cost.json")
    if not stored:
        return ""
    flat = [
        (row["what"], row["scene_mev_s"], row["core"], row["mev_s_flat_out"], row.get("routed", "-"))
        for row in stored.get("flat", [])
    ]
    text = (
        "## Cost of the decoder\n\n`bench/bench_decoder.py`: from bus bytes to records, one thread; twenty beacons at 2"
        f" kbit/s, the least of {stored['flat'][0]['n']} runs of {stored['seconds']} s. Evidence: simulated.\n\n"
        + table(("what", "scene, Mev/s", "core at real time", "Mev/s flat out", "in regions"), flat)
        + "\n"
    )
    if "windows" in stored:
        rows = [(row["window_us"], row["core"]) for row in stored["windows"]]
        text += "\n" + table(("window, us", "core at 5 Mev/s"), rows) + "\n"
    if "events" in stored:
        line = stored["events"]
        rows = [(row["scene_mev_s"], row["core"], row["mev_s_flat_out"]) for row in line["rows"]]
        text += (
            "\n" + table(("Mev/s", "core", "Mev/s flat out"), rows) + f"\n\nA straight line: {line['core_fixed']} of a"
            f" core and {line['core_a_mev_s']} for each Mev/s; largest departure {100 * line['largest_departure']:.0f}"
            " %.\n"
        )
    if "scans" in stored:
        rows = [
            (row["beacons"], row["scan_us"] or "none", row["core"], row["frames_s"], row["n"])
            for row in stored["scans"]
        ]
        text += "\n" + table(("beacons, 1 Mev/s", "scans, us", "core", "frames a second", "runs"), rows) + "\n"
    if "idle" in stored:
        rows = [(row["idle"], row["core"], row["ratio"], row["tracks"]) for row in stored["idle"]]
        text += "\n" + table(("idle tracks", "core", "ratio", "of it the tracker's messages"), rows) + "\n"
    return text


def latency_section() -> str:
    """How long from the end of a frame to a subscriber in another process."""
    stored = _stored("latency.json")
    if not stored:
        return ""
    out = (
        "## Latency\n\n`bench/bench_latency.py`: from the end of a frame to a subscriber in another process, ms;"
        " source, router, tracker and decoder as processes on one host, batches of 1 ms. Counted are the"
        " seconds in which the source was on time. Evidence: simulated light, real processes.\n"
    )
    for run in stored["runs"]:
        rows = [(hop, *(run[hop][p] for p in ("p50", "p90", "p99", "max"))) for hop in HOPS]
        out += (
            f"\n{run.get('beacons', 20)} beacons at 2 kbit/s, windows of {run['window_us']} us, {run['seconds']:.0f} s,"
            f" {run['frames']:,} frames; on time (at most {run['most_late_us'] / 1e3:g} ms late):"
            f" {100 * run['share_of_seconds_on_time']:.0f} % of the seconds. Cores:"
            f" {', '.join(f'{name} {share:.2f}' for name, share in run['cores'].items())}.\n\n"
        )
        out += table(("hop", "p50", "p90", "p99", "largest"), rows) + "\n"
    return out


def sections() -> list[Callable[[], str]]:
    """Return what writes the sections, in their order."""
    return [recordings_section, packet_section, cost_section, latency_section]
