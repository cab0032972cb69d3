"""`heliograph metrics show [FILE]`: what the metrics sink has kept of a run."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import Final

import msgspec

from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.summary import Accuracy, Acquisition, Ratio, Summary, summarise

# A long mission has thousands of sightings; the newest are what one looks for. `--json` has all.
SIGHTINGS_SHOWN: Final = 20


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status."""
    parser = argparse.ArgumentParser(prog="heliograph metrics", description=__doc__)
    parser.add_argument("action", choices=("show",))
    parser.add_argument("file", nargs="?", default=MetricsSinkConfig().file, metavar="FILE")
    parser.add_argument("--run", type=int, metavar="N", help="which start of the sink (default: the newest)")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    arguments = parser.parse_args(argv)
    found = summarise(arguments.file, arguments.run)
    print(json.dumps({"type": "metrics", **msgspec.to_builtins(found)}) if arguments.json else table(found))
    return 0


def table(found: Summary) -> str:
    """Return a summary for people, at most 80 columns wide."""
    lines = [
        f"{found.file}, run {found.run}: {found.seconds} s of {', '.join(found.cameras) or 'no camera'}",
        f"  frames {found.frames}, characters {found.characters}, late {found.late}",
    ]
    lines += _counts("refused", found.refused) + _counts("identified", found.identified)
    lines += _counts("missing on the bus", found.missing) + _counts("dropped in queues", found.dropped)
    if found.accuracy is None:
        estimate = "unknown" if found.mar_estimated is None else f"{found.mar_estimated:.3f} (by the receivers)"
        lines.append(f"  no truth: accuracy is not known; MAR estimated {estimate}")
    else:
        lines += _accuracy(found.accuracy)
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
    lines += [f"    {'CER ' + name:<24}{value:.4f}" for name, value in accuracy.cer.items()]
    lines.append(
        f"    identifications judged {accuracy.judged}: {accuracy.false_alarms} false alarms,"
        f" {accuracy.confusions} confusions"
    )
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
