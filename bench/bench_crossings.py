"""How many scripted crossings two beacons survive with their names.

By position alone: no code, no flow; or with `--read` with the decoder in the loop, which says who is who: the scenes'
raw events go through source, tracker and decoder in lockstep, and where both had one word the second has another.

Ideal pixels (`tests/support/crossings.py`): discs of 2 to 4 px radius in the middle of 640 x 480 pixels, 0 to 2 px
apart when they meet, 20 kev/s of noise, 95 % of the events seen; one of four words each, at one of four bit rates.
Each kind of crossing is drawn from the ranges printed. `kept`: at the end both have the names that they had before;
`swapped`: each other's; else one is without a track, or has a third name. Bound: the lower 95 % bound of the share
kept (Clopper and Pearson, one-sided). Seeds 0 to 99 were for development; these are others.

Run: python bench/bench_crossings.py [--first 1000] [--n 200] [--read]
"""

from __future__ import annotations

import argparse
import platform
import sys
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from heliograph.shares import lower_bound
from support.crossings import Kind, outcomes
from support.crossings_read import outcomes_read

KINDS: Final = {
    "straight": Kind(),
    "bent": Kind(acceleration_px_s2=(0.0, 300.0)),
    "50 and 100 bit/s": Kind(bit_rates=(50.0, 100.0)),
    "at a small angle": Kind(angle_deg=(10.0, 20.0), speed_px_s=(50.0, 200.0)),
    "slow": Kind(speed_px_s=(10.0, 60.0)),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000, help="the first seed")
    parser.add_argument("--n", type=int, default=200, help="crossings of each kind")
    parser.add_argument("--read", action="store_true", help="with the decoder in the loop")
    args = parser.parse_args()
    print(
        f"simulated (ideal pixels), Python {platform.python_version()}, seeds {args.first} to {args.first + args.n - 1}"
    )
    print(f"{'crossing':<18} {'angle deg':>10} {'px/s':>10} {'px/s2':>9} {'kept':>5} {'bound':>6}  others")
    for name, kind in KINDS.items():
        found = (outcomes_read if args.read else outcomes)(range(args.first, args.first + args.n), kind)
        kept = found.pop("kept", 0)
        ranges = [f"{a:.0f}..{b:.0f}" for a, b in (kind.angle_deg, kind.speed_px_s, kind.acceleration_px_s2)]
        others = ", ".join(f"{what} {n}" for what, n in sorted(found.items()))
        bound = lower_bound(kept, args.n)
        print(f"{name:<18} {ranges[0]:>10} {ranges[1]:>10} {ranges[2]:>9} {kept:>5} {bound:>6.3f}  {others}".rstrip())


if __name__ == "__main__":
    main()
