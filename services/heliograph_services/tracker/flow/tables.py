"""The network by tables, for any weights and any l_tau; the same spikes as the equations.

Each pixel keeps its last 11 ticks in a history word; a table [25][2048] of 32 numbers holds what a word gives to each
neuron through a synapse. Only outputs in whose reach a history is not empty are computed; the potentials of all others
decay when they are next needed, by as many single steps as passed, so that they are rounded as the equations round
them. A potential below 2**-33 counts as 0: added to any drive (a multiple of 1/256) it is lost in float32 anyway.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from heliograph_services.tracker.flow.network import NEURONS, REACH, SIDE, SYNAPSES, FlowNetwork
from heliograph_services.tracker.flow.spikes import NO_PIXELS, SPIKES_AT_FIRST, TICKS, Ints, Spikes
from heliograph_services.tracker.jit import kernel

_HISTORY_MASK: Final = (1 << TICKS) - 1
# Half of what the smallest drive, 1/256, resolves in float32.
NEGLIGIBLE: Final = 2.0**-33


@kernel
def _age(history: Any, live: Any, n_live: int) -> int:
    """Make all histories a tick older, drop the empty ones; return how many live."""
    kept = 0
    for i in range(n_live):
        p = live[i]
        word = (np.int64(history[p]) << 1) & _HISTORY_MASK
        history[p] = word
        if word:
            live[kept] = p
            kept += 1
    return kept


@kernel
def _enter(x: Any, y: Any, stride: int, history: Any, live: Any, n_live: int) -> int:
    """Add this tick's pixels; return how many live."""
    for i in range(len(x)):
        p = (y[i] + REACH) * stride + x[i] + REACH
        if history[p] == 0:
            live[n_live] = p
            n_live += 1
        history[p] |= 1
    return n_live


@kernel
def _touch(
    live: Any, n_live: int, width: int, height: int, stride: int, now: int, touched_at: Any, touched: Any
) -> int:
    """List the outputs within reach of a live pixel; return how many."""
    n = 0
    for i in range(n_live):
        py = live[i] // stride - REACH
        px = live[i] % stride - REACH
        for qy in range(max(0, py - REACH), min(height, py + REACH + 1)):
            for qx in range(max(0, px - REACH), min(width, px + REACH + 1)):
                q = qy * width + qx
                if touched_at[q] != now:
                    touched_at[q] = now
                    touched[n] = q
                    n += 1
    return n


@kernel
def _drive(p: int, history: Any, offset: Any, table: Any, drive: Any) -> None:
    """Fill drive with W d_Delta(x) of one output."""
    # Not the constant: a loop of known length is unrolled first, and then not made into vector instructions.
    neurons = len(drive)
    for k in range(neurons):
        drive[k] = np.float32(0)
    for j in range(SYNAPSES):
        word = history[p + offset[j]]
        if word != 0:
            given = table[j, word]
            for k in range(neurons):
                drive[k] += given[k]


@kernel
def _decay(s: Any, ticks: int, l_tau: Any) -> None:
    """Let potentials decay tick by tick, as the equations round them, until none is left."""
    nothing = np.float32(0)
    negligible = np.float32(NEGLIGIBLE)
    for _ in range(ticks):
        left = nothing
        for k in range(len(s)):
            old = l_tau * s[k]
            old = old if abs(old) >= negligible else nothing
            s[k] = old
            left += abs(old)
        if left == nothing:
            return


@kernel
def _table_step(
    touched: Any, n_touched: int, width: int, stride: int, history: Any, table: Any, offset: Any, now: int, l_tau: Any,
    v_th: Any, above: bool, floor: Any, s: Any, s_at: Any, lit: Any, drive: Any, out: Ints, out_s: Any,
) -> int:  # fmt: skip
    """Update the touched outputs' potentials; write rows (x, y, k) of the spikes, and s; return how many."""
    n = 0
    neurons = len(drive)
    nothing = np.float32(0)
    for i in range(n_touched):
        q = touched[i]
        qy = q // width
        qx = q % width
        _drive((qy + REACH) * stride + qx + REACH, history, offset, table, drive)
        if lit[q]:
            _decay(s[q], now - s_at[q], l_tau)
        s_at[q] = now
        most = -np.inf
        left = nothing
        for k in range(neurons):
            new = max(drive[k] + s[q, k], floor)
            s[q, k] = new
            most = max(most, new)
            left += abs(new)
        lit[q] = left > nothing
        if most < v_th:
            continue
        for k in range(neurons):
            new = s[q, k]
            if new > v_th or (new == v_th and not above):
                out[0, n] = qx
                out[1, n] = qy
                out[2, n] = k
                out_s[n] = new
                n += 1
                # (1 - y): what fired starts from 0.
                s[q, k] = nothing
    return n


class TableRuntime:
    """One output at a time; any weights, any l_tau.

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        self._size = (width, height)
        self._stride = width + 2 * REACH
        pixels = self._stride * (height + 2 * REACH)
        self._history = np.zeros(pixels, np.uint16)
        self._live = np.empty(pixels, np.int32)
        self._n_live = 0
        self._touched = np.empty(width * height, np.int32)
        self._touched_at = np.full(width * height, -1, np.int64)
        self._table = _table(network)
        j = np.arange(SYNAPSES)
        self._offset = (j // SIDE - REACH) * self._stride + j % SIDE - REACH
        self._network = network
        # Zeros are mapped by the system only where they are touched.
        self._s = np.zeros((width * height, NEURONS), np.float32)
        self._s_at = np.zeros(width * height, np.int64)
        self._lit = np.zeros(width * height, np.bool_)
        self._floor = np.float32(0 if network.g == "relu" else -np.inf)
        self._now = 0
        self._drive = np.empty(NEURONS, np.float32)
        self._out = np.empty((3, SPIKES_AT_FIRST), np.int32)
        self._out_s = np.empty(SPIKES_AT_FIRST, np.float32)

    def step(self, x: npt.NDArray[Any], y: npt.NDArray[Any], wanted: npt.NDArray[np.uint8] | None = None) -> Spikes:
        """Take the next tick's active pixels; return its spikes: see `Runtime`."""
        n, (width, height) = self._network, self._size
        self._now += 1
        x, y = x.astype(np.int64), y.astype(np.int64)
        self._n_live = _age(self._history, self._live, self._n_live)
        self._n_live = _enter(x, y, self._stride, self._history, self._live, self._n_live)
        touched = _touch(
            self._live, self._n_live, width, height, self._stride, self._now, self._touched_at, self._touched
        )
        # Every touched output fires all its neurons at most; only the pages that are written are ever mapped.
        if touched * NEURONS > len(self._out_s):
            self._out = np.empty((3, 2 * touched * NEURONS), np.int32)
            self._out_s = np.empty(2 * touched * NEURONS, np.float32)
        out, out_s = self._out, self._out_s
        count = _table_step(
            self._touched, touched, width, self._stride, self._history, self._table, self._offset, self._now,
            np.float32(n.l_tau), np.float32(n.v_th), n.h == "step_above", self._floor,
            self._s, self._s_at, self._lit, self._drive, out, out_s,
        )  # fmt: skip
        return Spikes(out[0, :count], out[1, :count], out[2, :count], out_s[:count]).within(wanted)

    def skip(self, ticks: int) -> list[Spikes]:
        """Pass so many ticks without input; return the spikes of the first that can have any."""
        spikes = [self.step(NO_PIXELS, NO_PIXELS).copy() for _ in range(min(ticks, TICKS))]
        self._now += max(0, ticks - TICKS)
        return spikes


def _table(network: FlowNetwork) -> npt.NDArray[np.float32]:
    """Return (25, 2048, 32) float32: what a history gives to each neuron through each synapse."""
    word = np.arange(1 << TICKS)
    table = np.empty((SYNAPSES, 1 << TICKS, NEURONS), np.float32)
    for j in range(SYNAPSES):
        seen = (word[:, None] >> network.delay[:, j]) & 1
        table[j] = seen * network.weight[:, j]
    return table
