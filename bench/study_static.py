"""MAR of a still beacon at 50 cm over its bit rate, read by the paper's receiver behind a scan of 199 us.

    python bench/study_static.py [-o bench/results/static_mar.json] [--plot docs/plots/static_mar.png]

The paper's "Static OCC performance": DVXplorer Mini, 3.6 mm, indoors (2 W/m2), payload 42. Beside its two quoted
statements (over .94 up to 2.5 kHz) stand the prediction from scanning alone (`static_prediction.py`, stored before
this study was first run) and our default receiver. What differs between the rows: how much later OFF events come than
ON events, and by how much the scan is stretched beyond what the load explains. Nothing is fitted.
Evidence: simulated. MAR_sent (visible), K = 1, one payload (so a receiver that remembers could do well; ours does not).
"""

from __future__ import annotations

import argparse
import json
import zlib
from pathlib import Path
from typing import Any

from heliograph_services.cli.studies.running import Setting, run

NAME = "static_mar/1"
SECONDS_S = 4.0
RUNS = 3
PREDICTED = Path(__file__).parent / "results" / "static_prediction.json"
SCENARIO = """
about = "a still beacon at 50 cm, indoors"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
mode = "VARIABLE_5000"
path = {{ kind = "still", at_m = [0.0, 0.0, 0.5] }}
lens = {{ focal_mm = 3.6, f_number = 2.0 }}
override = {{ "pixel.latency_off_extra_us" = {asymmetry_us}, "readout.stretch_us" = {stretch_us} }}
[[beacon]]
name = "a"
protocol = "seed11"
payload = 42
bit_rate = {rate}
start_us = {start_us}
path = {{ kind = "still", at_m = [0.0, 0.0, 0.0] }}
"""


def measured(rate: float, asymmetry_us: float, stretch_us: float, receiver: str) -> dict[str, Any]:
    """Return the counts of RUNS runs with their own seeds and phases."""
    right, n = 0, 0
    for i in range(RUNS):
        seed = zlib.crc32(f"{NAME}/{rate}/{i}".encode())
        text = SCENARIO.format(
            asymmetry_us=float(asymmetry_us), stretch_us=float(stretch_us), rate=float(rate), start_us=float(seed % 997)
        )
        decoder = {"protocol": "seed11", "bit_rate": float(rate), "receiver": receiver}
        accuracy = run(Setting(text, seed, SECONDS_S, decoder)).summary.accuracy
        if accuracy is not None:
            right, n = right + accuracy.mar_visible.right, n + accuracy.mar_visible.n
    return {"rate": rate, "right": right, "n": n, "mar": round(right / n, 4) if n else None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    predicted = json.loads(PREDICTED.read_text())
    rows = []
    for row in predicted["rows"]:
        if row["stretch_us"] and row["asymmetry_us"] not in {0, 40, 80}:
            continue
        curve = [measured(rate, row["asymmetry_us"], row["stretch_us"], "paper") for rate in predicted["rates"]]
        rows.append({"receiver": "paper", **row, "predicted": row["mar"], "mar": curve})
        print(f"paper, stretch {row['stretch_us']}, asymmetry {row['asymmetry_us']}:", *(f"{p['mar']}" for p in curve))
    ours = [measured(rate, 0, 0, "default") for rate in predicted["rates"]]
    print("default, ideal edges:", *(f"{p['mar']}" for p in ours))
    rows.append({"receiver": "default", "stretch_us": 0, "asymmetry_us": 0, "mar": ours})
    result = {"study": NAME, "evidence": "simulated", "seconds": SECONDS_S, "runs": RUNS, "rows": rows}
    if arguments.o is not None:
        arguments.o.write_text(json.dumps(result, indent=1) + "\n")
    if arguments.plot is not None:
        plot(result, arguments.plot)


def plot(result: dict[str, Any], path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415 - not needed without a plot

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    stretches = sorted({row["stretch_us"] for row in result["rows"]})
    figure, axes = plt.subplots(1, len(stretches), figsize=(12, 4), sharey=True)
    for axis, stretch_us in zip(axes, stretches, strict=True):
        axis.axhspan(0.94, 1.0, xmax=2500 / 5200, color="0.9", label="paper (quoted): over .94 up to 2.5 kHz")
        for row in result["rows"]:
            if row["stretch_us"] != stretch_us:
                continue
            rates = [point["rate"] for point in row["mar"]]
            mars = [point["mar"] for point in row["mar"]]
            if row["receiver"] == "default":
                axis.plot(rates, mars, "k-", lw=2, label="our default receiver, ideal edges")
                continue
            (line,) = axis.plot(rates, mars, "o-", ms=3, label=f"paper's receiver, OFF {row['asymmetry_us']} us later")
            axis.plot(
                rates, row["predicted"], ":", color=line.get_color(), label="the same, predicted from scanning alone"
            )
        axis.set(
            title=f"scan 199 us + load + {stretch_us} us", xlabel="bit rate (bit/s)", xlim=(0, 5200), ylim=(0, 1.02)
        )
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("MAR_sent (visible), simulated")
    axes[0].legend(fontsize=6)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
