"""The page and the plot of the flow's figures, from what `bench_flow.py` and `train_flow.py` stored.

Run: python bench/flow_page.py [--page docs/flow.md] [--plot docs/plots/flow.png]
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
DOCS = Path(__file__).parents[1] / "docs"
NAMES = {
    "network": "network (default)",
    "network_population": "network, population",
    "plane": "plane (Benosman)",
    "orchard": "Orchard",
    "centroid": "centroid",
}
QUOTED = """## Quoted, not run, not ranked

Both are learned on other data (driving, recorded), give dense flow, and ran on other computers; nothing here is
comparable with the tables above.

- E-RAFT (Gehrig et al., 3DV 2021; [project page](https://rpg.ifi.uzh.ch/ERAFT.html)): end-point error lower by 23 % on
  MVSEC and by 66 % on DSEC than what it was compared with there.
- Schnider et al. 2023 (*Neuromorphic optical flow and real-time implementation with event cameras*; the paper names it
  beside its own network): a deep spiking network, trained on the same kind of data. We found no figure
  that we could check, and give none.
"""


def median(row: dict[str, Any]) -> str:
    """Return a row's median error and its interval in percent."""
    low, high = row["epe_median_95"]
    return f"{100 * row['epe_median']:.0f} ({100 * low:.0f}-{100 * high:.0f})"


def accuracy(result: dict[str, Any]) -> list[str]:
    """Return a table for each kind and noise: methods by speeds."""
    lines = []
    kinds = dict.fromkeys((row["kind"], row["noise_hz"]) for row in result["rows"])
    for kind, noise in kinds:
        rows = [
            r for r in result["rows"] if (r["kind"], r["noise_hz"]) == (kind, noise) and r["epe_median"] is not None
        ]
        speeds = sorted({row["speed_px_s"] for row in rows})
        n = {speed: max(row["n"] for row in rows if row["speed_px_s"] == speed) for speed in speeds}
        own = " (the preset's own)" if noise == 0 and " " in kind else ""
        lines += [f"### {kind}, {noise / 1e6:g} Mev/s of noise{own}", ""]
        asked = " | ".join(f"{s:g} px/s, n={n[s]}" for s in speeds)
        lines.append(f"| error %, angle deg, answered % | {asked} | core |")
        lines.append("|---" * (len(speeds) + 2) + "|")
        for method, name in NAMES.items():
            mine = {row["speed_px_s"]: row for row in rows if row["method"] == method}
            if not mine:
                continue
            cells = [_cell(mine.get(speed)) for speed in speeds]
            core = sum(row["core"] for row in mine.values()) / len(mine)
            lines.append(f"| {name} | " + " | ".join(cells) + f" | {core:.2f} |")
        lines.append("")
    return lines


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ""
    angle = row["angle_median_deg"]
    return f"{median(row)}, {'-' if angle is None else f'{angle:.0f}'}, {100 * row['answered']:.0f}"


def costs(cost: dict[str, Any]) -> list[str]:
    """Return the tables of costs."""
    lines = ["| scene (simulated, 640 x 480, active gate) | events/s | entries/s | core | core before |"]
    lines.append("|---|---|---|---|---|")
    for row in cost["pyramid"]:
        cells = (row["scene"], row["events_s"], row["entries_s"], row["core"], row["core_before"])
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    lines += [
        "",
        "One network, every spike asked for, ms a tick (median, least), beside a dense torch convolution:",
        "",
    ]
    lines += ["| corpus | active pixels | words | tables | tables, l_tau .5 | torch |", "|---|---|---|---|---|---|"]
    for row in cost["ticks"]:
        cells = [
            f"{row[f'{name}_ms']:.1f}, {row[f'{name}_least_ms']:.1f}"
            for name in ("words", "tables", "tables_l_tau_0.5", "torch_dense")
        ]
        lines.append(f"| {row['corpus']} | {row['active_pixels']} | " + " | ".join(cells) + " |")
    return lines


def learned(result: dict[str, Any]) -> list[str]:
    """Return the words on learned weights."""
    mean, n = result["mean_of_medians"], len(result["rows"])
    words = (
        f"Weights trained in torch (`bench/train_flow.py`; {result['patches']} patches, {result['cpu_s']} s of a core,"
        f" loss {result['losses'][0]} to {result['losses'][-1]}), tested on {n} scenes of other seeds and of the"
        " simulator: mean over the scenes of the median error, and the scenes on which learned weights are better."
    )
    lines = [
        words,
        "",
        "| read-out | weights of 1 | learned | better on |",
        "|---|---|---|---|",
    ]
    for readout in ("fit", "population"):
        hand, other = (100 * mean[f"{readout}_{name}"] for name in ("hand", "learned"))
        lines.append(f"| {readout} | {hand:.1f} % | {other:.1f} % | {result['better'][readout]} of {n} |")
    lines += [
        "",
        "Learned weights are no multiples of 1 and run by tables, several times slower. They are not shipped.",
    ]
    return lines


def page(flow: dict[str, Any], training: dict[str, Any] | None) -> str:
    """Return the page."""
    result = flow["accuracy"]
    source = (
        "Generated by `python bench/flow_page.py` from `bench/results/flow.json`; how it works:"
        " [flow](../services/heliograph_services/tracker/flow/README.md)."
    )
    words = (
        f"Evidence: {result['evidence']}. Seeds {result['seeds']}; the others' settings tuned on seeds"
        f" {result['tuning_seeds']}: {json.dumps(result['tuned'])}. Cells: median endpoint error in % of the speed"
        " (95 % interval: bootstrap over seed x place x 1 s; no answer counts 100 %), median angle error of the"
        " answers, share of the places asked that got one. Noise is of the whole sensor, of which the scenes are a"
        " cut-out of 160 x 120; core: mean share of one core over the row's scenes, feeding and asking. The centroid"
        " is told where the discs are. Where tuning chooses l_tau 0 and our input for it, Orchard's form is that of the"
        " population read-out."
    )
    lines = [
        "# Flow: how well, at what cost",
        "",
        source,
        "",
        words,
        "",
        "![median endpoint error over speed](plots/flow.png)",
        "",
        "## Accuracy",
        "",
        *accuracy(result),
        "## Cost",
        "",
        *costs(flow["cost"]),
        "",
    ]
    if training is not None:
        lines += ["## Learned weights", "", *learned(training), ""]
    return "\n".join(lines) + "\n" + QUOTED


def plot(result: dict[str, Any], path: Path) -> None:
    """Draw the median endpoint error over speed, with its interval, a panel for each kind and noise."""
    import matplotlib as mpl  # noqa: PLC0415 - not needed without a plot

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    kinds = list(dict.fromkeys(row["kind"] for row in result["rows"]))
    noises = sorted({row["noise_hz"] for row in result["rows"]})
    size = (4 * len(noises), 2.8 * len(kinds))
    figure, axes = plt.subplots(len(kinds), len(noises), figsize=size, sharex=True, sharey=True)
    shown: set[tuple[int, int]] = set()
    for (i, kind), (j, noise) in itertools.product(enumerate(kinds), enumerate(noises)):
        for method, name in NAMES.items():
            rows = [r for r in result["rows"] if (r["kind"], r["noise_hz"], r["method"]) == (kind, noise, method)]
            rows = [r for r in rows if r["epe_median"] is not None]
            if not rows:
                continue
            shown.add((i, j))
            # 0.3 % is the axis's foot.
            middle, low, high = (
                [100 * max(0.003, value) for value in values]
                for values in (
                    [r["epe_median"] for r in rows],
                    [r["epe_median_95"][0] for r in rows],
                    [r["epe_median_95"][1] for r in rows],
                )
            )
            speeds = [r["speed_px_s"] for r in rows]
            (line,) = axes[i, j].loglog(speeds, middle, marker=".", label=name)
            axes[i, j].fill_between(speeds, low, high, color=line.get_color(), alpha=0.12)
        pixels = "simulated pixels" if " " in kind else "ideal pixels"
        axes[i, j].set_title(f"{kind}, {noise / 1e6:g} Mev/s of noise, {pixels}", fontsize=8)
        axes[i, j].grid(alpha=0.3)
        # Not every noise was asked of the simulator.
        axes[i, j].set_visible((i, j) in shown)
    axes[0, 0].legend(fontsize=6)
    figure.supxlabel("speed, px/s")
    figure.supylabel("median endpoint error, % of the speed")
    figure.tight_layout()
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=90)


def main() -> None:
    """Write the page and the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", type=Path, default=DOCS / "flow.md")
    parser.add_argument("--plot", type=Path, default=DOCS / "plots" / "flow.png")
    args = parser.parse_args()
    flow = json.loads((RESULTS / "flow.json").read_text())
    stored = RESULTS / "flow_learned.json"
    args.page.write_text(page(flow, json.loads(stored.read_text()) if stored.exists() else None))
    plot(flow["accuracy"], args.plot)


if __name__ == "__main__":
    main()
