"""MAR of a still beacon at 50 cm over its bit rate, read by the paper's receiver behind a scan of 199 us.

    python bench/study_static.py [-o bench/results/static_mar.json] [--plot docs/plots/static_mar.png] [--receiver NAME]

With --receiver only the rows of that receiver are run; the others are kept as -o has them.

The paper's "Static OCC performance": DVXplorer Mini, 3.6 mm, indoors (2 W/m2), payload 42. Beside the quoted curve
(over .94 up to 2.5 kHz) stands the prediction from scanning alone (`static_prediction.py`, stored before this study was
first run). Rows with ideal edges have pixels without a time constant; they differ in how much later OFF events come
than ON events, and by how much the scan is stretched beyond what the load explains. Two rows have the preset's own
pixels: the paper's receiver and our default one. Nothing is fitted.

A first run showed what the prediction had left out: it began all edges within 160 us of the receiver's windows. The
paper's windows of one bit have no phase; where the slow end of an edge crosses into the next window, the next edge
drowns in it. So each rate is run at PHASES phases of the beacon against the windows, and the best and worst are told.
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
SECONDS_S = 1.25
PHASES = 5
# Of the predicted rates; a run costs three times its length.
RATES = (500, 1000, 2000, 2250, 2500, 2750, 3000, 3500, 4000, 5000)
# (stretch_us, asymmetry_us) of the rows with ideal edges.
SHOWN = {(0, 0), (0, 40), (0, 80), (10, 0), (30, 0)}
PREDICTED = Path(__file__).parent / "results" / "static_prediction.json"
SCENARIO = """
about = "a still beacon at 50 cm, indoors"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
mode = "VARIABLE_5000"
path = {{ kind = "still", at_m = [0.0, 0.0, 0.5] }}
lens = {{ focal_mm = 3.6, f_number = 2.0 }}
override = {{ {override} }}
[[beacon]]
name = "a"
protocol = "seed11"
payload = 42
bit_rate = {rate}
start_us = {start_us}
path = {{ kind = "still", at_m = [0.0, 0.0, 0.0] }}
"""


def measured(rate: float, asymmetry_us: float, stretch_us: float, *, receiver: str, ideal: bool) -> dict[str, Any]:
    """Return the counts of a run a phase, each with a seed of its own."""
    override = {"pixel.latency_off_extra_us": asymmetry_us, "readout.stretch_us": stretch_us}
    if ideal:
        override |= {"pixel.tau_ref_us": 0.01, "pixel.tau_min_us": 0.01}
    right, n, each = 0, 0, []
    for i in range(PHASES):
        seed = zlib.crc32(f"{NAME}/{rate}/{i}".encode())
        text = SCENARIO.format(
            override=", ".join(f'"{name}" = {float(value)}' for name, value in override.items()),
            rate=float(rate),
            start_us=i / PHASES * 1e6 / rate,
        )
        decoder = {"protocol": "seed11", "bit_rate": float(rate), "receiver": receiver}
        accuracy = run(Setting(text, seed, SECONDS_S, decoder)).summary.accuracy
        if accuracy is not None:
            mar = accuracy.mar_visible
            right, n = right + mar.right, n + mar.n
            each.append(round(mar.value or 0.0, 3))
    return {"rate": rate, "right": right, "n": n, "mar": round(right / n, 4), "phases": each}


def rows_of(predicted: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the settings of the rows, each with its prediction where there is one."""
    rows: list[dict[str, Any]] = [
        {"receiver": "paper", "ideal": False, "stretch_us": 0, "asymmetry_us": 0},
        {"receiver": "default", "ideal": False, "stretch_us": 0, "asymmetry_us": 0},
    ]
    for row in predicted["rows"]:
        if (row["stretch_us"], row["asymmetry_us"]) in SHOWN:
            known = dict(zip(predicted["rates"], row["mar"], strict=True))
            where = {"stretch_us": row["stretch_us"], "asymmetry_us": row["asymmetry_us"]}
            rows.append({"receiver": "paper", "ideal": True, **where, "predicted": [known[rate] for rate in RATES]})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--receiver", choices=("default", "paper"))
    arguments = parser.parse_args()
    rows = rows_of(json.loads(PREDICTED.read_text()))
    if arguments.receiver is not None:
        if arguments.o is None:
            parser.error("--receiver keeps other rows: it needs -o")
        kept = json.loads(arguments.o.read_text())["rows"]
        rows = [row if row["receiver"] == arguments.receiver else old for row, old in zip(rows, kept, strict=True)]
    for row in rows:
        if "mar" in row:
            continue
        delays = row["asymmetry_us"], row["stretch_us"]
        row["mar"] = [measured(rate, *delays, receiver=row["receiver"], ideal=row["ideal"]) for rate in RATES]
        print({name: value for name, value in row.items() if name not in {"mar", "predicted"}}, flush=True)
        for name, of in (("worst", min), ("mean", None), ("best", max)):
            print(f"   {name:5}", *(f"{of(p['phases']) if of else p['mar']:6.3f}" for p in row["mar"]), flush=True)
    result = {"study": NAME, "evidence": "simulated", "seconds": SECONDS_S, "phases": PHASES, "rows": rows}
    if arguments.o is not None:
        arguments.o.write_text(json.dumps(result, indent=1) + "\n")
    if arguments.plot is not None:
        plot(result, arguments.plot)


def plot(result: dict[str, Any], path: Path) -> None:
    """Draw a panel a stretch."""
    import matplotlib as mpl  # noqa: PLC0415 - not needed without a plot

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), sharey=True)
    titles = ("the preset's pixels", "ideal edges, OFF later than ON", "ideal edges, longer scans")
    groups = (
        [row for row in result["rows"] if not row["ideal"]],
        [row for row in result["rows"] if row["ideal"] and not row["stretch_us"]],
        [row for row in result["rows"] if row["ideal"] and not row["asymmetry_us"]],
    )
    for axis, title, rows in zip(axes, titles, groups, strict=True):
        axis.fill_between([0, 2500], 0.94, 1.0, color="0.88", label="the paper (quoted): over .94 up to 2.5 kHz")
        for row in rows:
            _draw(axis, row)
        axis.set(title=title, xlabel="bit/s", xlim=(0, 5200), ylim=(0, 1.02))
        axis.grid(alpha=0.3)
        axis.legend(fontsize=6, loc="lower left")
    axes[0].set_ylabel("MAR_sent (visible), simulated")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _draw(axis: Any, row: dict[str, Any]) -> None:
    rates = [point["rate"] for point in row["mar"]]
    label = f"{row['receiver']}, OFF + {row['asymmetry_us']} us, scan + {row['stretch_us']} us"
    (line,) = axis.plot(rates, [point["mar"] for point in row["mar"]], "o-", ms=3, label=label)
    worst, best = ([of(point["phases"]) for point in row["mar"]] for of in (min, max))
    axis.fill_between(rates, worst, best, color=line.get_color(), alpha=0.12)
    if "predicted" in row:
        axis.plot(rates, row["predicted"], ":", color=line.get_color(), label="predicted from scanning alone")


if __name__ == "__main__":
    main()
