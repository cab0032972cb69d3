"""What `--protocol auto --bit-rate auto` finds of single lights, and after how many seconds.

    python bench/study_auto.py [--runs 3] [--first-seed 0] [-o bench/results/auto.json]     some six minutes of one core
    python bench/study_auto.py --page bench/results/auto.json                               the table of a stored result

Each protocol that auto tries at each bit rate: one light of 40 pixels before an asynchronous sensor (3 us of jitter, 2
us of refractory time, 1000 noise events a second; `heliograph_services.cli.studies.asynchronous`), 150 ppm fast, seen
from the beginning for `SECONDS` or `BITS` bits, whichever is longer. The decoder is told nothing: `auto`, `auto`. Found
is what holds an identity of the right protocol and payload and no other at any time; the time is that of the first.
One run is one seed: the light's phase and the noise. Evidence: simulated, at the level of events. Rows that are in the
result already are not run again.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from heliograph_services.decoder.config import DecoderConfig
from support.lone_lights import SENT, heard

RATES: Final = (50, 100, 250, 500, 1_000, 2_000, 5_000, 10_000, 20_000)
SECONDS: Final = 3.0
# Four frames of 20 bits, a text's ten characters or a packet, twice, behind a cold start that failed once.
BITS: Final = 1_000
AUTO: Final = DecoderConfig(protocol="auto", bit_rate="auto")


def row(protocol: str, rate: int, seed: int) -> dict[str, Any]:
    """Return what was found of one light."""
    out = heard(protocol, rate, rate, max(SECONDS, BITS / rate), seed, AUTO)
    payload = SENT[protocol].payload
    right = f"{protocol}:{payload}" if payload is not None else protocol
    return {
        "protocol": protocol,
        "bit_rate": rate,
        "seed": seed,
        "found": out.identities == {right},
        "held": sorted(out.identities),
        "after_s": None if out.first_us is None else out.first_us / 1e6,
        "characters": len(out.text),
    }


def page(rows: list[dict[str, Any]]) -> str:
    """Return the table: seconds to the first identity, median of the runs, or what went wrong."""
    rates = sorted({one["bit_rate"] for one in rows})
    lines = ["| | " + " | ".join(str(rate) for rate in rates) + " |", "|---" * (len(rates) + 1) + "|"]
    for protocol in SENT:
        cells = []
        for rate in rates:
            here = [one for one in rows if (one["protocol"], one["bit_rate"]) == (protocol, rate)]
            found = sorted(one["after_s"] for one in here if one["found"])
            wrong = sum(bool(one["held"]) and not one["found"] for one in here)
            cell = f"{found[len(found) // 2]:.2g}" if found else "-"
            cell += f" ({len(found)} of {len(here)})" if 0 < len(found) < len(here) else ""
            cells.append(cell + (f", {wrong} wrong" if wrong else ""))
        lines.append(f"| `{protocol}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    if arguments.page:
        print(page(json.loads(arguments.page.read_text())))
        return
    stored = arguments.out is not None and arguments.out.exists()
    rows: list[dict[str, Any]] = json.loads(arguments.out.read_text()) if stored else []
    done = {(one["protocol"], one["bit_rate"], one["seed"]) for one in rows}
    for protocol in SENT:
        for rate in RATES:
            for seed in range(arguments.first_seed, arguments.first_seed + arguments.runs):
                if (protocol, rate, seed) not in done:
                    rows.append(row(protocol, rate, seed))
                    print(json.dumps(rows[-1]), flush=True)
            if arguments.out:
                arguments.out.write_text("[\n" + ",\n".join(json.dumps(one) for one in rows) + "\n]\n")
    print(page(rows))


if __name__ == "__main__":
    main()
