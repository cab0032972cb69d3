"""The flow network in torch in the place of the numba runtimes: the dense definition itself, tick by tick.

What goes in, the gate and the read-out are those of the pyramid; the spikes are torch's own, in the order in which
`flow.words` lists them, so that sums over them round alike and lockstep is the same to the byte (with l_tau 0; the
runtime with memory lists them in another order, and the last bits of a velocity may differ).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from heliograph.streams import Onsets
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.flow.network import FlowNetwork
from heliograph_services.tracker.flow.spikes import NO_PIXELS, TICKS, Spikes
from heliograph_services.tracker.flow.tables import NEGLIGIBLE
from heliograph_services.tracker.flow.torch_net import TorchNetwork
from heliograph_services.tracker.motion import Motion
from heliograph_services.tracker.network_motion import make_with

_WORD = 64
# Its images are small: threads that wait for each other take a hundred times as long on a busy computer.
torch.set_num_threads(1)


class TorchRuntime:
    """A network that runs in torch (`flow.spikes.Runtime`).

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        self._network = TorchNetwork(network)
        self._shape = (height, width)
        self._whole = network.l_tau == 0 and bool(np.isin(network.weight, (0, 1)).all())
        self._silent = TICKS

    def step(self, x: npt.NDArray[Any], y: npt.NDArray[Any], wanted: npt.NDArray[np.uint8] | None = None) -> Spikes:
        """Take the next tick's active pixels; return its spikes: see `flow.spikes.Runtime`."""
        # The network keeps the images of the last ticks.
        image = torch.zeros(self._shape)
        image[torch.from_numpy(y.astype(np.int64)), torch.from_numpy(x.astype(np.int64))] = 1.0
        with torch.no_grad():
            fired = self._network(image)
        k, row, column = (each.numpy().astype(np.int32) for each in torch.nonzero(fired, as_tuple=True))
        order = np.lexsort((column, k, column // _WORD, row))
        k, row, column = k[order], row[order], column[order]
        if self._network.s is None:
            raise RuntimeError("a network has potentials after a step")
        s = self._network.s[0].numpy()[k, row, column]
        spikes = Spikes(column, row, k, s.astype(np.int32) if self._whole else s)
        return spikes.within(wanted)

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        spikes = [self.step(NO_PIXELS, NO_PIXELS) for _ in range(min(ticks, TICKS))]
        # What decays for longer than the delays stays below the threshold; it goes on decaying until nothing is left.
        for _ in range(ticks - TICKS):
            if self._network.s is None or float(self._network.s.abs().max()) < NEGLIGIBLE:
                break
            self.step(NO_PIXELS, NO_PIXELS)
        return spikes


def make(config: TrackerConfig, first: Onsets) -> Motion:
    """Return the motion of the stream that these onsets are the first of; one pixel has none."""
    return make_with(TorchRuntime, config, first)
