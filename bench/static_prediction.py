"""What scanning alone does to the paper's receiver: a prediction, made without the simulator's pixels.

    python bench/static_prediction.py [-o bench/results/static_prediction.json]

A still beacon sends payload 42 (1110 101010 1) for SECONDS_S. Every edge becomes EVENTS events of its polarity, all at
the end of the scan in which it falls; an OFF edge `asymmetry_us` later than an ON edge; scans of 199 us (VARIABLE_5000)
plus `stretch_us`. The paper's receiver reads them (`heliograph.link.paper`, its window of one bit, its rounding).
MAR = frames read with payload 42, matched one to one within half a frame / frames sent, from 0.5 s on.

Predicted in words, before the simulator's curve was run: an interval between two edges errs by less than a scan, and
rounding forgives less than half a bit, so all is well up to f = 1 / (2 T): 2.51 kHz at 199 us, 2.18 kHz at 229 us;
with an asymmetry a the first intervals go wrong from 1 / (2 (T + a)): 1.79 kHz at 80 us. Above, short runs are lost
first, so MAR falls steeply, since payload 42 has seven runs of one bit. Beyond 1 / T = 5.03 kHz nothing is left but
aliases: near f = 1 / T the scan beats with the bit clock, and intervals of one bit look right again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from heliograph.link.contract import LinkFrame, edges_of
from heliograph.link.modulations import modulation

PAYLOAD = 42
SECONDS_S = 4.0
SKIP_S = 0.5
EVENTS = 8
SCAN_US = 199.0
RATES = (250, 500, 1000, 1500, 1750, 2000, 2250, 2500, 2750, 3000, 3500, 4000, 4500, 5000)
ASYMMETRIES_US = (0, 20, 40, 60, 80)
STRETCHES_US = (0, 10, 30)
PHASES = 5


def mar(rate: float, asymmetry_us: float, stretch_us: float, phase: float) -> float:
    """Return the share of right frames of one run; phase in [0, 1) shifts the scan against the bit clock."""
    bit_us = 1e6 / rate
    code = modulation("seed11")
    frame = code.encode(PAYLOAD)
    repeats = int(SECONDS_S * rate) // len(frame)
    t_us, on = edges_of(frame * repeats, phase * SCAN_US, bit_us)
    scan_us = SCAN_US + stretch_us
    seen_us = np.ceil((t_us + np.where(on, 0.0, asymmetry_us)) / scan_us) * scan_us
    order = np.argsort(seen_us, kind="stable")
    times = np.repeat(np.round(seen_us[order]).astype(np.int64), EVENTS)
    flags = np.repeat(on[order], EVENTS)
    receiver = code.receiver(rate, "paper")
    frames = receiver.feed(times, flags, int(times[-1]) + 1) + receiver.flush()
    read_us = [f.t_us for f in frames if isinstance(f, LinkFrame) and f.payload == PAYLOAD]
    length_us = len(frame) * bit_us
    ends_us = phase * SCAN_US + length_us * np.arange(1, repeats + 1)
    ends_us = ends_us[ends_us > SKIP_S * 1e6]
    taken, right = 0, 0
    for end_us in ends_us:
        while taken < len(read_us) and read_us[taken] < end_us - length_us / 2:
            taken += 1
        if taken < len(read_us) and read_us[taken] <= end_us + length_us / 2:
            right, taken = right + 1, taken + 1
    return right / len(ends_us)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    arguments = parser.parse_args()
    rows = []
    for stretch_us in STRETCHES_US:
        for asymmetry_us in ASYMMETRIES_US:
            curve = [
                round(float(np.mean([mar(rate, asymmetry_us, stretch_us, k / PHASES) for k in range(PHASES)])), 3)
                for rate in RATES
            ]
            rows.append({"stretch_us": stretch_us, "asymmetry_us": asymmetry_us, "mar": curve})
            print(f"stretch {stretch_us:2d} us, asymmetry {asymmetry_us:2d} us:", *(f"{v:5.2f}" for v in curve))
    if arguments.o is not None:
        result = {"what": "prediction from scanning alone, no pixels", "rates": RATES, "rows": rows}
        arguments.o.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
