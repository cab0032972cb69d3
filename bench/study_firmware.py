"""The light that the firmware makes, edge by edge: the ESP32 port on the model of its RMT, and the AVR port in simavr.

    python bench/study_firmware.py [--rates 100] [--changes 1000] [--seconds 2] [--seed N]

For each of ESP32, C3 and S3: so many random rates from 50 bit/s to 5 kbit/s, each from its own start. In simavr, where
it and gcc-avr are installed: so many live changes of the payload at 5 kbit/s. Prints a JSON object for each: frames,
damaged ones, the worst error of an interval and the drift over the whole, ns.
"""

from __future__ import annotations

import argparse
import json
import random
import struct
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.beacon_wire import ARM, SEED11, SET, record  # noqa: E402 - found by the line above
from support.firmware import Script, edge_check, live_changes, make  # noqa: E402

HOUR = struct.pack(">I", 3_600_000)


def told(what: str, reports: list[edge_check.Report], **more: object) -> None:
    """Print what the light held."""
    line = {
        "what": what,
        "frames": sum(len(report.frames) for report in reports),
        "damaged": sum(len(report.damaged) for report in reports),
        "worst_error_ns": max(report.worst_error_ns for report in reports),
        "worst_drift_ns": max(abs(report.worst_drift_ns) for report in reports),
    }
    print(json.dumps(line | more), flush=True)


def at_rate(program: Path, bit_rate: float, seconds: float) -> edge_check.Report:
    """Return what a chip's light held at a rate, from its start."""
    with Script(program) as beacon:
        beacon.run(0.01)
        beacon.host.hello()
        beacon.host.done(SET, record(SEED11, 42, bit_rate=bit_rate))
        beacon.host.done(ARM, HOUR)
        beacon.run(seconds)
        return beacon.check("seed11", bit_rate)


def main() -> None:
    """Run all that can be built here."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rates", type=int, default=100)
    parser.add_argument("--changes", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for chip in make.CHIPS:
            (program,) = make.build(chip, folder)
            draw = random.Random(arguments.seed)
            rates = [round(draw.uniform(50, 5000), 3) for _ in range(arguments.rates)]
            told(chip, [at_rate(program, rate, arguments.seconds) for rate in rates], rates=len(rates))
        absent = make.missing("avr")
        if absent:
            print(json.dumps({"what": "avr", "skipped": absent}))
            return
        firmware, machine = make.build("avr", folder)
        with Script(machine, firmware) as beacon:
            beacon.run(0.02)
            beacon.host.hello()
            report, same = live_changes(beacon, arguments.changes)
            told("avr", [report], changes=arguments.changes, in_order=same, late=beacon.host.status().late)


if __name__ == "__main__":
    main()
