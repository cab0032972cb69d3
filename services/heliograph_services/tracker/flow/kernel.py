"""The choice of a runtime: both are exact, so it is one of speed alone.

On 640 x 480, words are several times as fast as tables at every density from 1k active pixels a tick to a full frame
(`python bench/bench_flow.py`), and they are the dense form as well; tables run what words cannot.
"""

from __future__ import annotations

import numpy as np

from heliograph_services.tracker.flow.network import FlowNetwork
from heliograph_services.tracker.flow.spikes import Runtime
from heliograph_services.tracker.flow.tables import TableRuntime
from heliograph_services.tracker.flow.words import WordRuntime


def make_runtime(network: FlowNetwork, width: int, height: int) -> Runtime:
    """Return the fastest runtime that is exact for this network."""
    if network.l_tau == 0 and np.isin(network.weight, (0, 1)).all():
        return WordRuntime(network, width, height)
    return TableRuntime(network, width, height)
