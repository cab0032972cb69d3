"""Every shipped scenario through source, tracker and decoder, scored: what a user sees who runs it.

    python bench/study_scenarios.py [-o bench/results/scenarios.json] [--only NAME ...] [--seeds 0 1 2] [--seconds 20]

Development seeds; at most 20 s of each scenario's story, the surroundings rendered coarsely (`live`). Listed beacons,
default receiver; `construction_site_nrp` also with the paper's. Scenarios without beacons are read with every protocol
at several rates, and all that is identified there is a false alarm: each is listed with its place and time.
Evidence: simulated, K = 1, by the metrics sink (docs/metrics.md). Nothing is tuned on these runs.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import msgspec

from heliograph_services.cli.studies.running import Outcome, Setting, run
from heliograph_services.event_source.simulation.world.load import built_in, load_scenario, site_beacons

NAME = "scenarios/1"
# Of the lights of `clutter`: the rates of its blinkers, those between, and whatever can be measured.
RATES: tuple[float | str, ...] = (50.0, 300.0, 1000.0, 3000.0, "auto")
PROTOCOLS = ("seed11", "code", "uart")


def readers(name: str) -> list[dict[str, Any]]:
    """Return the decoder's settings that a scenario is read with."""
    beacons = site_beacons(load_scenario(name))
    if not beacons:
        return [{"protocol": protocol, "bit_rate": rate} for protocol in PROTOCOLS for rate in RATES]
    listed: dict[str, Any] = {"beacons": msgspec.to_builtins(beacons)}
    papers = [{**listed, "receiver": "paper"}] if load_scenario(name).camera.sensor == "nrp" else []
    return [listed, *papers]


def row(name: str, seed: int, seconds: float, decoder: dict[str, Any]) -> dict[str, Any]:
    """Run a scenario once and return what came of it."""
    outcome = run(Setting(name, seed, seconds, decoder, source={"fidelity": "live"}))
    told = {key: value for key, value in decoder.items() if key != "beacons"}
    return {"scenario": name, "seed": seed, "seconds": seconds, "reader": told, **told_of(outcome, seconds)}


def told_of(outcome: Outcome, seconds: float) -> dict[str, Any]:
    """Return an outcome as plain values."""
    summary = outcome.summary
    out: dict[str, Any] = {
        "events_s": round(outcome.events / seconds),
        "tracks": outcome.tracks,
        "frames": summary.frames,
        "identified": summary.identified,
    }
    accuracy = summary.accuracy
    if accuracy is None:
        return out | {"sightings": msgspec.to_builtins(summary.sightings)}
    for key in ("mar_visible", "mar_in_view", "mar_received", "cer"):
        out[key] = msgspec.to_builtins(getattr(accuracy, key))
    out |= {
        "acquisition_ms": accuracy.first.median_ms,
        "never_in_1_s": accuracy.first.never_in_1_s,
        "false_alarms": accuracy.false_alarms,
        "confusions": accuracy.confusions,
    }
    if accuracy.false_alarms or accuracy.confusions:
        out["sightings"] = msgspec.to_builtins(summary.sightings)
    return out


def line(one: dict[str, Any]) -> str:
    """Return a row of the printed table."""

    def share(key: str) -> str:
        ratio = one.get(key)
        if not ratio or ratio["value"] is None:
            return "-"
        return f"{ratio['value']:.3f} [{ratio['low']:.2f} {ratio['high']:.2f}]"

    reader = " ".join(str(value) for value in one["reader"].values()) or "default"
    return (
        f"{one['scenario']:27} {one['seed']} {reader:12} {share('mar_visible'):18} {share('mar_in_view'):18}"
        f" {share('mar_received'):18} {one.get('acquisition_ms') or 0:7.0f} {one.get('false_alarms', 0):3}"
        f" {one.get('confusions', 0):3} {one['events_s']:9} {one['tracks']:5}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--only", nargs="+", default=built_in())
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()
    names = ("scenario", "seed reader", "visible", "in view", "received", "acq ms", "FA con", "events/s tracks")
    print("{:26}{:15}{:19}{:19}{:19}{:9}{:8}{}".format(*names))
    rows = []
    for name in arguments.only:
        seconds = min(arguments.seconds, load_scenario(name).duration_s)
        for decoder in readers(name):
            for seed in arguments.seeds:
                rows.append(row(name, seed, seconds, decoder))
                print(line(rows[-1]), flush=True)
                if arguments.o is not None:
                    result = {"study": NAME, "evidence": "simulated", "fidelity": "live", "rows": rows}
                    arguments.o.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
