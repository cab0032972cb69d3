"""`heliograph metrics show|export [FILE]`: what the metrics sink has kept.

`show` adds up a run (the newest, or `--run N`), or its last hours (`--last 2h`). `export` writes one table, of all
runs or of one, as CSV or Parquet.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from typing import Final

import msgspec

from heliograph.errors import ConfigError
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.export import TABLES, export
from heliograph_services.metrics_sink.summary import Accuracy, Acquisition, Hop, Load, Ratio, Summary, summarise

# A long mission has thousands of sightings; the newest are what one looks for. `--json` has all.
SIGHTINGS_SHOWN: Final = 20
LAST_LIMIT_S: Final = 3_650 * 86_400
_UNITS_S: Final = {"s": 1, "m": 60, "h": 3_600, "d": 86_400}


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    arguments = _parser().parse_args(argv)
    if arguments.action == "export":
        try:
            n = export(arguments.file, arguments.table, arguments.output, arguments.run)
            sys.stdout.flush()
        except BrokenPipeError:
            # `... -o - | head` has seen enough; Python would flush once more at its end, and complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        print(f"{n} rows of {arguments.table} in {arguments.output}", file=sys.stderr)
        return 0
    last_s = None if arguments.last is None else seconds_of(arguments.last)
    found = summarise(arguments.file, arguments.run, last_s)
    print(json.dumps({"type": "metrics", **msgspec.to_builtins(found)}) if arguments.json else table(found))
    return 0


def _parser() -> argparse.ArgumentParser:
    default = MetricsSinkConfig().file
    parser = argparse.ArgumentParser(prog="heliograph metrics", description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(dest="action", required=True, metavar="show|export")
    show = actions.add_parser("show", help="counts, accuracy, latency and sightings of a run")
    write = actions.add_parser("export", help="one table as CSV or Parquet")
    for each in (show, write):
        each.add_argument("file", nargs="?", default=default, metavar="FILE", help=f"default: {default}")
        each.add_argument("--run", type=int, metavar="N", help="which start of the sink")
    show.add_argument("--last", metavar="TIME", help="only the last while, e.g. 90s, 10m, 2h, 7d")
    show.add_argument("--json", action="store_true", help="one JSON object")
    write.add_argument(
        "--table", default="counts", metavar="NAME", help=f"one of {', '.join(TABLES)} (default: counts)"
    )
    write.add_argument("-o", "--output", required=True, metavar="FILE", help=".csv, .parquet, or - for CSV on stdout")
    return parser


def seconds_of(text: str) -> float:
    """Return the length of a time like 90s, 10m, 2h or 7d.

    Raises:
        ConfigError: it is no such time, or 0.
    """
    number, unit = text[:-1], _UNITS_S.get(text[-1:])
    if unit is None or not number.isascii() or not number.isdigit() or not 0 < int(number) * unit <= LAST_LIMIT_S:
        raise ConfigError(f"--last must be a whole number of s, m, h or d, at most 3650d, not {text!r}")
    return float(int(number) * unit)


def table(found: Summary) -> str:
    """Return a summary for people, at most 80 columns wide."""
    lines = [
        f"{found.file}, run {found.run}: {found.seconds} s of {', '.join(found.cameras) or 'no camera'}",
        f"  frames {found.frames}, characters {found.characters}, late {found.late} with {found.late_frames} frames",
    ]
    lines += _counts("refused", found.refused) + _counts("identified", found.identified)
    lines += _counts("missing on the bus", found.missing) + _counts("dropped in queues", found.dropped)
    if found.accuracy is None:
        estimate = "unknown" if found.mar_estimated is None else f"{found.mar_estimated:.3f} (by the receivers)"
        lines.append(f"  no truth: accuracy is not known; MAR estimated {estimate}")
    else:
        if not found.frames:
            lines.append("  truth without frames: nobody has read what was sent (does a decoder run?)")
        lines += _accuracy(found.accuracy)
        if found.block_s > 1:
            lines.append(f"    (a long time: the intervals' blocks are {found.block_s} s of a beacon, not 1 s)")
    lines += _hops(found.hops) + _loads(found.loads)
    if found.sightings:
        lines += _sightings(found)
    return "\n".join(lines)


def _counts(title: str, counts: dict[str, int]) -> list[str]:
    if not counts:
        return []
    return [f"  {title}:"] + [f"    {n:>10}  {name}" for name, n in counts.items()]


def _accuracy(accuracy: Accuracy) -> list[str]:
    lines = ["  accuracy against the truth (95 % intervals):"]
    rows = (
        ("MAR sent, visible", accuracy.mar_visible),
        ("MAR sent, in view", accuracy.mar_in_view),
        ("MAR received", accuracy.mar_received),
        ("MAR sent, close pairs", accuracy.mar_close),
        ("BAR", accuracy.bar),
        ("FER, visible", accuracy.fer),
        ("BER, matched frames", accuracy.ber),
    )
    lines += [f"    {name:<24}{_ratio(ratio)}" for name, ratio in rows if ratio.n]
    if accuracy.bar_by_chance is not None:
        lines.append(f"    {'BAR by chance':<24}{accuracy.bar_by_chance:.3f}")
    if accuracy.goodput_bit_s is not None:
        lines.append(f"    {'goodput a beacon':<24}{accuracy.goodput_bit_s:.1f} bit/s")
    lines += [f"    {'CER ' + name:<24}{_ratio(ratio)}" for name, ratio in accuracy.cer.items()]
    lines.append(
        f"    identifications judged {accuracy.judged}: {accuracy.false_alarms} false alarms,"
        f" {accuracy.confusions} confusions"
    )
    for name, bound in (
        ("false alarms a camera hour", accuracy.false_alarms_per_camera_hour_at_most),
        ("false alarms a track hour", accuracy.false_alarms_per_track_hour_at_most),
        ("confusions an identification", accuracy.confusions_at_most),
    ):
        if bound is not None:
            lines.append(f"      {name}: at most {bound:.3g} (95 %)")
    for name, times in (("first", accuracy.first), ("after 0.5 s unseen", accuracy.again)):
        if times.intervals:
            lines.append(f"    acquired, {name}: {_acquisition(times)}")
    return lines


def _ratio(ratio: Ratio) -> str:
    if ratio.value is None or ratio.low is None or ratio.high is None:
        return "unknown"
    return f"{ratio.value:.4f}  [{ratio.low:.4f}, {ratio.high:.4f}]  {ratio.right} of {ratio.n}"


def _acquisition(times: Acquisition) -> str:
    def shown(value_ms: float | None) -> str:
        return "never" if value_ms is None else f"{value_ms:.0f} ms"

    return (
        f"median {shown(times.median_ms)}, p95 {shown(times.p95_ms)}, n {times.intervals},"
        f" not in 1 s {times.never_in_1_s or 0.0:.2f}"
    )


def _hops(hops: list[Hop]) -> list[str]:
    if not hops:
        return []
    lines = ["  latency, ms (mean of the seconds' p50; greatest p95, p99 of a second):"]
    for each in hops:
        figures = f"{each.p50_ms:9.3f} {each.p95_ms:9.3f} {each.p99_ms:9.3f}"
        lines.append(f"    {each.process:<30.30} {each.hop:<8.8} {figures}  n {each.n}")
    return lines


def _loads(loads: list[Load]) -> list[str]:
    if not loads:
        return []
    lines = ["  processes (most in a second): queue, share of a core:"]
    return lines + [f"    {each.process:<30.30} {each.queue_most:>8} {each.cpu_share_most:8.3f}" for each in loads]


def _sightings(found: Summary) -> list[str]:
    lines = [f"  sightings ({len(found.sightings)}):"]
    for each in found.sightings[-SIGHTINGS_SHOWN:]:
        seconds = (each.last_us - each.first_us) / 1e6
        ended = "" if each.ended else ", still there"
        lines.append(
            f"    {each.camera:<8.8} {each.beacon:<20.20} from {each.first_us / 1e6:9.3f} s for {seconds:7.1f} s,"
            f" {each.frames} frames{ended}"
        )
    return lines
