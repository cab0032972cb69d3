"""Whether the link's own figures are right: what receivers say of the last second, beside what the light was.

    python bench/study_quality.py [--runs 4] [--first-seed 0] [-o bench/results/quality.json]       a minute of one core
    python bench/study_quality.py --page bench/results/quality.json                                 the table

Lights, damage and trials are those of `heliograph bench link`: 8 s each, clocks within 400 ppm, a step response for
each pixel. Each second from the second one on the receiver is asked for its quality, as the decoder asks it; its
answers are averaged. True are: MAR_sent of the same seconds (right frames / frames sent); the light's events over its
edges (without noise); the clock's error against the nominal rate; the displacement of the edges, to which the centre of
an edge's events adds its own, sd of an event / sqrt(events).
Evidence: simulated, at the level of events; n = runs of 7 s a row.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from heliograph.link.contract import LinkFrame, LinkQuality, Text
from heliograph.link.modulations import modulation
from heliograph_services.cli.bench_link import CONDITIONS, SECTIONS
from heliograph_services.cli.link_light import Damage
from heliograph_services.cli.link_trials import Section, Trial, make_trial, score, slots_of

SECONDS: Final = 8
WINDOW_US: Final = 5_000
FIGURES: Final = ("bit_rate", "snr_db", "jitter_us", "clock_ppm", "events_per_transition", "mar_estimate")


def asked(trial: Trial, section: Section) -> tuple[list[LinkFrame], list[LinkQuality]]:
    """Return the frames of a receiver, and what it says at each whole second from the second one on."""
    receiver = modulation(section.protocol).receiver(section.bit_rate)
    out: list[LinkFrame | Text] = []
    said: list[LinkQuality] = []
    before = 0
    for until_us in range(WINDOW_US, SECONDS * 1_000_000 + 1, WINDOW_US):
        at = int(np.searchsorted(trial.seen.t_us, until_us))
        out += receiver.feed(trial.seen.t_us[before:at], trial.seen.on[before:at], until_us)
        before = at
        if until_us % 1_000_000 == 0 and until_us > 1_000_000:
            said.append(receiver.quality(until_us))
    return [one for one in out if isinstance(one, LinkFrame)], said


def row(section: Section, name: str, seed: int) -> dict[str, Any]:
    """Return the true figures of one light and those that its receiver tells."""
    damage = CONDITIONS[name]
    trial = make_trial(section, damage, float(SECONDS), seed)
    frames, said = asked(trial, section)
    counts = score(trial, frames, slots_of(section))
    scored = [counts[k] for k in range(1, SECONDS - 1) if k in counts]
    bit_us = (trial.frames[0].t1_us - trial.frames[0].t0_us) / len(
        slots_of(section).word(trial.frames[0].payload) or ()
    )
    told: dict[str, float | None] = {}
    for figure in FIGURES:
        values = [value for one in said if (value := getattr(one, figure)) is not None]
        told[figure] = float(np.mean(values)) if values else None
    return {
        "section": section.name,
        "condition": name,
        "seed": seed,
        "told": told,
        "true": {
            "mar_estimate": sum(one.right for one in scored) / max(sum(one.sent for one in scored), 1),
            "clock_ppm": (1e6 / section.bit_rate / bit_us - 1.0) * 1e6,
            "events_per_transition": events_an_edge(trial, section, damage),
            "jitter_us": damage.edge_jitter_bits * bit_us,
        },
    }


def events_an_edge(trial: Trial, section: Section, damage: Damage) -> float:
    """Return the light's events over its edges that were not dropped: all events less the noise, over changes."""
    slots = slots_of(section)
    begin, end = trial.frames[0].t0_us, trial.frames[-1].t1_us
    n = int(np.sum((trial.seen.t_us >= begin) & (trial.seen.t_us < end)))
    bits = [bit for frame in trial.frames for bit in (slots.word(frame.payload) or ())]
    # Between two characters the light may rest, lit as at their ends: no change.
    edges = np.count_nonzero(np.diff([1, *bits])) * (1.0 - damage.dropped)
    return float((n - damage.noise_hz * (end - begin) * 1e-6) / edges)


def page(rows: list[dict[str, Any]]) -> str:
    """Return the table: true and told, mean over the runs."""
    lines = [
        "| light | MAR true, told | events a transition | clock error, ppm | edges' jitter, us | SNR told, dB |",
        "|---|---|---|---|---|---|",
    ]
    for key in dict.fromkeys((one["section"], one["condition"]) for one in rows):
        here = [one for one in rows if (one["section"], one["condition"]) == key]

        def mean(side: str, figure: str, some: list[dict[str, Any]] = here) -> str:
            values = [one[side][figure] for one in some if one[side].get(figure) is not None]
            return f"{np.mean(values):.3g}" if values else "-"

        off = [abs(one["told"]["clock_ppm"] - one["true"]["clock_ppm"]) for one in here if one["told"]["clock_ppm"]]
        cells = [f"{mean('true', name)}, {mean('told', name)}" for name in ("mar_estimate", "events_per_transition")]
        cells += [f"off by {max(off):.0f} at most" if off else "-"]
        cells += [f"{mean('true', 'jitter_us')}, {mean('told', 'jitter_us')}", mean("told", "snr_db")]
        lines.append(f"| {key[0]}, {key[1]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    if arguments.page:
        print(page(json.loads(arguments.page.read_text())))
        return
    rows = [
        row(section, name, seed)
        for section in SECTIONS
        for name in CONDITIONS
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.runs)
    ]
    if arguments.out:
        arguments.out.write_text("[\n" + ",\n".join(json.dumps(one) for one in rows) + "\n]\n")
    print(page(rows))


if __name__ == "__main__":
    main()
