"""The network's weights learned in torch, and whether they win over the hand-made ones (all 1).

Delays stay, and so do v_th = 5 and l_tau = 0. Training data: the inputs of the fastest scale on scenes of ideal pixels
(`tests/support/flow_scenes.py`; discs, texture, stripes; random directions and speeds in the scale's range, a third
each with 0, 1 and 3 Mev/s of noise; seeds 60 to 77): the last 11 ticks of 5 x 5 pixels at outputs where the hand-made
network fires, with the true velocity V in pixels a tick; and the same of noise alone. With s = W d_Delta(x)::

    p = sigmoid((s - v_th) / BETA) s^3            a soft spike, weighted as the population's read-out does
    minimise  mean |sum_k p_k v_k / sum_k p_k - V|^2 / |V|^2  +  QUIET mean over noise of sum_k sigmoid(..)

by Adam from the hand-made weights; then moved to the grid that all runtimes sum exactly. Tested on seed 90 and
on the simulator's scenes (`flow_simulated.py`), in the whole pyramid, read by the fit (default) and by the population.

Run: OMP_NUM_THREADS=1 python bench/train_flow.py [-o bench/results/flow_learned.json] [--network FILE.npz]
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests")]

from bench_flow import ask, geometry  # noqa: E402
from flow_simulated import PRESETS, SimulatedScene  # noqa: E402

from heliograph_services.tracker.flow.network import FlowNetwork, paper_network, quantised, save  # noqa: E402
from heliograph_services.tracker.flow.pyramid import FlowPyramid  # noqa: E402
from heliograph_services.tracker.flow.settings import FlowSettings, Scale  # noqa: E402
from heliograph_services.tracker.flow.spikes import TICKS, Spikes  # noqa: E402
from heliograph_services.tracker.flow.words import WordRuntime  # noqa: E402
from support.flow_scenes import FlowScene  # noqa: E402

RESULT = Path(__file__).parent / "results" / "flow_learned.json"
SCALE = Scale(5_000, 3, 1)
TRAINING_SEEDS, TEST_SEEDS = range(60, 78), (90,)
PATCHES_A_SCENE = 600
STEPS, BATCH = 250, 2048
BETA = 0.5
QUIET = 0.02


class Recorder:
    """A runtime that keeps the patches of some of the outputs that fire."""

    def __init__(self, network: FlowNetwork, width: int, height: int, rng: np.random.Generator) -> None:
        self._runtime = WordRuntime(network, width, height)
        self._past = np.zeros((TICKS, height + 4, width + 4), np.bool_)
        self._rng = rng
        self.patches: list[Any] = []

    def step(self, x: Any, y: Any, wanted: Any = None) -> Spikes:
        """Take a tick; keep at most 20 patches, (11, 25) each."""
        del wanted
        self._past = np.roll(self._past, 1, axis=0)
        self._past[0] = False
        self._past[0, y + 2, x + 2] = True
        spikes = self._runtime.step(x, y)
        fired = np.unique(spikes.y.astype(np.int64) << 20 | spikes.x)
        for code in self._rng.permutation(fired)[:20].tolist():
            py, px = code >> 20, code & 0xFFFFF
            self.patches.append(self._past[:, py : py + 5, px : px + 5].reshape(TICKS, 25).copy())
        return spikes

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass ticks without input."""
        self._past[:] = False
        return self._runtime.skip(ticks)


def patches(scene: FlowScene, rng: np.random.Generator) -> Any:
    """Return (n, 11, 25) bool: histories where the hand-made network fires in a scene."""
    recorders: list[Recorder] = []

    def make(network: FlowNetwork, width: int, height: int) -> Recorder:
        recorders.append(Recorder(network, width, height, rng))
        return recorders[-1]

    flow = FlowPyramid(FlowSettings(scales=(SCALE,)), **geometry(scene), runtime=make)
    for onsets in scene.onsets(0.25):
        flow.feed(onsets)
    found = np.array(recorders[0].patches, np.bool_).reshape(-1, TICKS, 25)
    return found[rng.permutation(len(found))[:PATCHES_A_SCENE]]


def data() -> tuple[Any, Any, Any]:
    """Return the patches, their velocities (n, 2) in pixels a tick, and the patches of noise."""
    rng = np.random.default_rng(60)
    x, v, noise = [], [], []
    unit = SCALE.pool_px / (SCALE.step_us * 1e-6)
    for seed in TRAINING_SEEDS:
        kind = ("discs", "texture", "edges")[seed % 3]
        speed, angle = float(unit * np.exp(rng.uniform(np.log(0.4), np.log(2.0)))), float(rng.uniform(0, 360))
        scene = FlowScene(kind, speed, angle, noise_hz=(0.0, 1e6, 3e6)[seed // 3 % 3], seed=seed)
        found = patches(scene, rng)
        x.append(found)
        v.append(np.tile(np.array(scene.velocity) / unit, (len(found), 1)))
        if seed % 6 == 0:
            noise.append(patches(FlowScene("discs", 1.0, discs=0, noise_hz=1e7, seed=seed), rng))
    return np.concatenate(x), np.concatenate(v), np.concatenate(noise)


def learned(x: Any, v: Any, noise: Any) -> tuple[FlowNetwork, list[float]]:
    """Return the trained network, and the loss of every 50th step."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    hand = paper_network()
    delay, synapse = torch.from_numpy(hand.delay), torch.arange(25)
    velocity = torch.from_numpy(hand.velocity).float()
    weight = torch.ones((32, 25), requires_grad=True)
    optimiser = torch.optim.Adam([weight], lr=0.02)
    x, v, noise = torch.from_numpy(x), torch.from_numpy(v).float(), torch.from_numpy(noise)

    def soft(batch: Any) -> tuple[Any, Any]:
        s = torch.relu((batch[:, delay, synapse].float() * weight).sum(-1))
        return torch.sigmoid((s - hand.v_th) / BETA), s

    losses = []
    for step in range(STEPS):
        rows = torch.randint(len(x), (BATCH,))
        fired, s = soft(x[rows])
        p = fired * s**3
        told = p @ velocity / (p.sum(1, keepdim=True) + 1e-3)
        loss = (((told - v[rows]) ** 2).sum(1) / (v[rows] ** 2).sum(1)).mean()
        if len(noise):
            loss = loss + QUIET * soft(noise[torch.randint(len(noise), (256,))])[0].sum(1).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 50 == 0 or step == STEPS - 1:
            losses.append(round(float(loss.detach()), 4))
    return FlowNetwork(hand.delay, quantised(weight.detach().numpy()), hand.velocity), losses


def compared(network: FlowNetwork) -> list[dict[str, Any]]:
    """Return a row for each test scene."""
    tests: list[tuple[Any, Any]] = []
    for kind in ("discs", "texture", "edges"):
        for speed, noise in ((80.0, 2e6), (640.0, 0.0)):
            for seed in TEST_SEEDS:
                scene = FlowScene(kind, speed, 37.0 * seed % 360, noise_hz=noise, seed=seed)
                tests.append((scene, list(scene.onsets(0.3 if speed > 100 else 0.5))))
    for preset in PRESETS:
        for what in ("discs", "texture"):
            simulated = SimulatedScene(preset, what, 320.0, 200.0, 0.0, TEST_SEEDS[0], 0.4)
            tests.append((simulated, list(simulated.onsets())))
    rows = []
    for scene, onsets in tests:
        row = {"kind": scene.kind, "speed_px_s": scene.speed_px_s, "noise_hz": scene.noise_hz, "seed": scene.seed}
        for readout in ("fit", "population"):
            for name, which in (("hand", None), ("learned", network)):
                flow = FlowPyramid(FlowSettings(readout=readout), **geometry(scene), network=which)
                errors = ask(scene, onsets, flow)[1]
                row["n"] = len(errors)
                row[f"{readout}_{name}"] = round(statistics.median(errors), 4) if errors else None
        rows.append(row)
        print(row, flush=True)
    return rows


def main() -> None:
    """Train, test, store."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, default=RESULT)
    parser.add_argument("--network", type=Path, help="write the learned network to this file")
    args = parser.parse_args()
    start = time.process_time()
    x, v, noise = data()
    network, losses = learned(x, v, noise)
    took = time.process_time() - start
    print(len(x), len(noise), losses, round(took), "s", flush=True)
    if args.network:
        save(network, args.network)
    rows = [row for row in compared(network) if row["n"]]
    result = {
        "evidence": "simulated: ideal pixels; kinds with a preset's name: the simulator's pixels",
        "training_seeds": [TRAINING_SEEDS[0], TRAINING_SEEDS[-1]],
        "test_seeds": TEST_SEEDS,
        "patches": len(x),
        "patches_of_noise": len(noise),
        "cpu_s": round(took),
        "losses": losses,
        "weights": {"least": float(network.weight.min()), "most": float(network.weight.max())},
        "better": {
            readout: sum(row[f"{readout}_learned"] < row[f"{readout}_hand"] for row in rows)
            for readout in ("fit", "population")
        },
        "mean_of_medians": {
            f"{readout}_{name}": round(statistics.mean(min(2.0, row[f"{readout}_{name}"]) for row in rows), 4)
            for readout in ("fit", "population")
            for name in ("hand", "learned")
        },
        "rows": rows,
    }
    args.o.write_text(json.dumps(result, indent=1) + "\n")
    print({key: result[key] for key in ("better", "mean_of_medians")})


if __name__ == "__main__":
    main()
