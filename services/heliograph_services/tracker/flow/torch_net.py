"""The flow network in torch (extra `[reference]`), what it exports, and its form in NIR.

The definition that the kernels must agree with: dense, the equations of `network` as eleven convolutions, one a delay.
Its weights may be trained (a surrogate gradient would stand for h); `export` then moves them to the grid that all
runtimes sum exactly.

NIR (Neuromorphic Intermediate Representation, package `nir`) has no delays in its convolutions, so the graph is eleven
branches Delay(d) -> Conv2d(the synapses of delay d) that meet in one LIF. With a time step of one tick, Euler's step of
NIR's LIF is our equation without its reset, and its reset to 0 is our (1 - y)::

    v += (dt / tau) (v_leak - v + r I),  v_leak = 0        tau = dt / (1 - l_tau),  r = tau / dt
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import nir  # type: ignore[import-untyped]  # nir ships no types
import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import conv2d

from heliograph.errors import ConfigError
from heliograph_services.tracker.flow.network import (
    DELAY_LIMIT,
    NEURONS,
    REACH,
    SIDE,
    FlowNetwork,
    quantised,
)

_KERNEL: Final = (NEURONS, 1, SIDE, SIDE)


class TorchNetwork(torch.nn.Module):
    """Delta-SNUs for images of any size; the state lives in the module.

    Args:
        network: parameters; weights become a torch parameter.
    """

    def __init__(self, network: FlowNetwork) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.from_numpy(network.weight.reshape(_KERNEL).copy()))
        delay = torch.from_numpy(network.delay.reshape(_KERNEL))
        self._masks = [(delay == d).to(torch.float32) for d in range(DELAY_LIMIT + 1)]
        self._network = network
        self._past: list[Tensor] = []
        self.s: Tensor | None = None
        self.y: Tensor | None = None

    def forward(self, x: Tensor) -> Tensor:
        """Take the (height, width) float image of the next tick; return (32, height, width) spikes of 0 and 1."""
        n = self._network
        self._past = [x[None, None], *self._past[:DELAY_LIMIT]]
        drive = torch.zeros((1, NEURONS, *x.shape))
        for image, mask in zip(self._past, self._masks, strict=False):
            drive = drive + conv2d(image, self.weight * mask, padding=REACH)
        if self.s is not None and self.y is not None:
            drive = drive + torch.tensor(n.l_tau, dtype=torch.float32) * self.s * (1 - self.y)
        self.s = torch.relu(drive) if n.g == "relu" else drive
        v_th = torch.tensor(n.v_th, dtype=torch.float32)
        self.y = (self.s >= v_th if n.h == "step" else self.s > v_th).to(torch.float32)
        return self.y[0]

    def export(self) -> FlowNetwork:
        """Return the parameters as the kernels take them, weights on their grid."""
        n = self._network
        weight = quantised(self.weight.detach().numpy().reshape(n.weight.shape))
        return FlowNetwork(n.delay, weight, n.velocity, n.v_th, n.l_tau, n.g, n.h)


def to_nir(network: FlowNetwork, width: int, height: int, tick_s: float = 1.0) -> nir.NIRGraph:
    """Return the network as a graph for images of one size.

    Raises:
        ConfigError: g, h or a weight have no counterpart in NIR's LIF, which has no rectifier.
    """
    if network.g != "relu" or network.h != "step" or network.weight.min() < 0:
        raise ConfigError("NIR takes networks of relu, step and no negative weight")
    shape = (NEURONS, height, width)
    tau = tick_s / (1 - network.l_tau)
    nodes: dict[str, Any] = {
        "input": nir.Input({"input": np.array([1, height, width])}),
        "lif": nir.LIF(
            tau=np.full(shape, tau),
            r=np.full(shape, tau / tick_s),
            v_leak=np.zeros(shape),
            v_threshold=np.full(shape, network.v_th),
            v_reset=np.zeros(shape),
        ),
        "output": nir.Output({"output": np.array(shape)}),
    }
    edges = [("lif", "output")]
    for d in range(DELAY_LIMIT + 1):
        weight = np.where(network.delay == d, network.weight, np.float32(0)).reshape(_KERNEL)
        nodes[f"delay{d}"] = nir.Delay(delay=np.full((1, height, width), d * tick_s))
        nodes[f"conv{d}"] = nir.Conv2d(
            input_shape=(height, width), weight=weight, stride=1, padding=REACH, dilation=1, groups=1,
            bias=np.zeros(NEURONS, np.float32),
        )  # fmt: skip
        edges += [("input", f"delay{d}"), (f"delay{d}", f"conv{d}"), (f"conv{d}", "lif")]
    return nir.NIRGraph(nodes, edges)


def from_nir(graph: nir.NIRGraph, velocity: np.ndarray[Any, np.dtype[np.float64]], tick_s: float = 1.0) -> FlowNetwork:
    """Return the network of a graph that `to_nir` made; what the neurons stand for is not in it.

    Raises:
        ConfigError: the graph is none of ours.
    """
    nodes = graph.nodes
    try:
        lif = nodes["lif"]
        delay = np.zeros(_KERNEL, np.int64)
        weight = np.zeros(_KERNEL, np.float32)
        for d in range(DELAY_LIMIT + 1):
            part = nodes[f"conv{d}"].weight
            ticks = round(float(np.ravel(nodes[f"delay{d}"].delay)[0]) / tick_s)
            delay[part != 0] = ticks
            weight += part
        tau, threshold = (float(np.ravel(a)[0]) for a in (lif.tau, lif.v_threshold))
    except (KeyError, AttributeError, ValueError) as error:
        raise ConfigError(f"not a graph of a flow network: {error}") from error
    # 1 - 1 / tau is l_tau but for the last bits; l_tau is what somebody typed.
    l_tau = round(1 - tick_s / tau, 12)
    pixels = velocity.shape[0], SIDE * SIDE
    return FlowNetwork(delay.reshape(pixels), weight.reshape(pixels), velocity, threshold, l_tau)


def save_nir(network: FlowNetwork, path: Path, width: int, height: int) -> None:
    """Write the network as a NIR file (HDF5)."""
    nir.write(str(path), to_nir(network, width, height))


def load_nir(path: Path, velocity: np.ndarray[Any, np.dtype[np.float64]]) -> FlowNetwork:
    """Return the network of a NIR file that `save_nir` wrote."""
    return from_nir(nir.read(str(path)), velocity)
