"""The flow network in torch in the place of the numba runtimes, tick by tick.

What goes in, the gate and the read-out are those of the pyramid; the spikes are torch's own, in the order in which
`flow.words` lists them, so that sums over them round alike and lockstep is the same to the byte (with l_tau 0; the
runtime with memory lists them in another order, and the last bits of a velocity may differ).

With memory every pixel is computed, as the definition does it (`flow.torch_net`). Without, a convolution over the
eleven last images does, of the tiles alone in whose reach as many pixels were active as a spike takes::

    s[k] = sum_d  conv5x5( W[k] where delay[k] = d,  x[t - d] )          d = 0 .. 10 as channels
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from torch.nn.functional import conv2d

from heliograph.streams import Onsets
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.flow.network import REACH, SIDE, FlowNetwork
from heliograph_services.tracker.flow.spikes import NO_PIXELS, NO_SPIKES, TICKS, Runtime, Spikes
from heliograph_services.tracker.flow.tables import NEGLIGIBLE
from heliograph_services.tracker.flow.torch_net import TorchNetwork
from heliograph_services.tracker.motion import Motion
from heliograph_services.tracker.network_motion import make_with

_WORD: Final = 64
# Small tiles leave more out, large ones share more of their margins.
_TILE: Final = 32
# The images are small: threads that wait for each other take a hundred times as long on a busy computer.
torch.set_num_threads(1)


class DenseRuntime:
    """Every pixel in every tick (`flow.spikes.Runtime`).

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        self._network = TorchNetwork(network)
        self._shape = (height, width)

    def step(self, x: npt.NDArray[Any], y: npt.NDArray[Any], wanted: npt.NDArray[np.uint8] | None = None) -> Spikes:
        """Take the next tick's active pixels; return its spikes: see `flow.spikes.Runtime`."""
        # The network keeps the images of the last ticks.
        image = torch.zeros(self._shape)
        image[torch.from_numpy(y.astype(np.int64)), torch.from_numpy(x.astype(np.int64))] = 1.0
        with torch.no_grad():
            fired = self._network(image)
        if self._network.s is None:
            raise RuntimeError("a network has potentials after a step")
        k, row, column = (each.numpy() for each in torch.nonzero(fired, as_tuple=True))
        return _listed(column, row, k, self._network.s[0].numpy()[k, row, column]).within(wanted)

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        spikes = [self.step(NO_PIXELS, NO_PIXELS) for _ in range(min(ticks, TICKS))]
        # What decays for longer than the delays stays below the threshold; it goes on decaying until nothing is left.
        for _ in range(ticks - TICKS):
            if self._network.s is None or float(self._network.s.abs().max()) < NEGLIGIBLE:
                break
            self.step(NO_PIXELS, NO_PIXELS)
        return spikes


class TileRuntime:
    """The tiles that may fire; for weights of 0 and 1 and l_tau = 0 (`flow.spikes.Runtime`).

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        weight = TorchNetwork(network).weight.detach().reshape(-1, 1, SIDE, SIDE)
        delay = torch.from_numpy(network.delay.reshape(-1, 1, SIDE, SIDE))
        self._weight = torch.cat([torch.where(delay == d, weight, 0.0) for d in range(TICKS)], dim=1)
        self._network = network
        self._size = (width, height)
        self._rows, self._columns = -(-height // _TILE), -(-width // _TILE)
        self._past = torch.zeros((TICKS, self._rows * _TILE + 2 * REACH, self._columns * _TILE + 2 * REACH))
        self._head = 0
        self._pixels: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]] = [(NO_PIXELS, NO_PIXELS)] * TICKS

    def step(self, x: npt.NDArray[Any], y: npt.NDArray[Any], wanted: npt.NDArray[np.uint8] | None = None) -> Spikes:
        """Take the next tick's active pixels; return its spikes: see `flow.spikes.Runtime`."""
        x, y = x.astype(np.int64), y.astype(np.int64)
        self._head = (self._head - 1) % TICKS
        self._pixels = [(x, y), *self._pixels[:-1]]
        self._past[self._head] = 0.0
        self._past[self._head, torch.from_numpy(y + REACH), torch.from_numpy(x + REACH)] = 1.0
        row, column = np.divmod(self._tiles(), self._columns)
        if len(row) == 0:
            return NO_SPIKES
        order = [(self._head + d) % TICKS for d in range(TICKS)]
        side = _TILE + 2 * REACH
        parts = [
            self._past[order, r * _TILE : r * _TILE + side, c * _TILE : c * _TILE + side]
            for r, c in zip(row.tolist(), column.tolist(), strict=True)
        ]
        s = conv2d(torch.stack(parts), self._weight)
        fired = s >= self._network.v_th if self._network.h == "step" else s > self._network.v_th
        tile, k, dy, dx = (each.numpy() for each in torch.nonzero(fired, as_tuple=True))
        at_y, at_x = row[tile] * _TILE + dy, column[tile] * _TILE + dx
        inside = (at_x < self._size[0]) & (at_y < self._size[1])
        potential = s.numpy()[tile, k, dy, dx].astype(np.int32)
        return _listed(at_x[inside], at_y[inside], k[inside], potential[inside]).within(wanted)

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        return [self.step(NO_PIXELS, NO_PIXELS) for _ in range(min(ticks, TICKS))]

    def _tiles(self) -> npt.NDArray[np.int64]:
        """Return the numbers of the tiles in whose reach so many pixels were active as a spike takes."""
        x, y = (np.concatenate(column) for column in zip(*self._pixels, strict=True))
        low_x, high_x = np.maximum(x - REACH, 0) // _TILE, np.minimum(x + REACH, self._size[0] - 1) // _TILE
        low_y, high_y = np.maximum(y - REACH, 0) // _TILE, np.minimum(y + REACH, self._size[1] - 1) // _TILE
        counts = np.zeros(self._rows * self._columns, np.int64)
        both_x, both_y = low_x != high_x, low_y != high_y
        corners: tuple[tuple[Any, Any, Any], ...] = (
            (low_x, low_y, slice(None)),
            (high_x, low_y, both_x),
            (low_x, high_y, both_y),
            (high_x, high_y, both_x & both_y),
        )
        for tile_x, tile_y, which in corners:
            number = tile_y * self._columns + tile_x
            counts += np.bincount(number[which], minlength=len(counts))
        return np.flatnonzero(counts >= self._network.v_th)


def _listed(x: Any, y: Any, k: Any, s: npt.NDArray[Any]) -> Spikes:
    """Return the spikes in the order of `flow.words`."""
    order = np.lexsort((x, k, x // _WORD, y))
    x, y, k = (each[order].astype(np.int32) for each in (x, y, k))
    return Spikes(x, y, k, s[order])


def runtime(network: FlowNetwork, width: int, height: int) -> Runtime:
    """Return what runs a network in torch, for images of one size."""
    if network.l_tau == 0 and np.isin(network.weight, (0, 1)).all():
        return TileRuntime(network, width, height)
    return DenseRuntime(network, width, height)


def make(config: TrackerConfig, first: Onsets) -> Motion:
    """Return the motion of the stream that these onsets are the first of; one pixel has none."""
    return make_with(runtime, config, first)
