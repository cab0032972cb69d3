r"""The flow network: 32 delta-SNUs a pixel, their equations and their parameters.

The paper, "Event-Based Optical Flow", with x_t the binary image of tick t, for neuron k at pixel p::

    s_t[k,p] = g( sum_j W[k,j] x_{t - Delta[k,j]}[p + o_j]  +  l(tau) s_{t-1}[k,p] (1 - y_{t-1}[k,p]) )
    y_t[k,p] = h( s_t[k,p] - v_th )

    o_j      j = 0..24: (dx, dy) = (j mod 5 - 2, j div 5 - 2); beyond the image x is 0
    k        direction k div 4 (0, 45 .. 315 degrees, from +x towards +y, y downwards), speed k mod 4
    Delta    round((2 - p_j) / v), cut to 0..D; p_j = o_j . direction; v = 4 / D pixels a tick, D = 10, 6, 4, 2
    W = 1,   v_th = 5

So the synapse that an edge reaches last has no delay, the first has D ticks, and an edge of the right direction and
speed reaches the neuron from all of them at once. The paper leaves g, h, l(tau) and the polarity of x open. Here g is
"relu" (or "identity"), h is "step" (fires at s >= v_th; "step_above": at s > v_th), l(tau) is `l_tau`, a tick's decay,
and x holds both polarities or one (`settings`).

Weights are multiples of 1/256. Every sum of 25 of them is then exact in float32 in any order, so that torch, numpy and
the kernels agree in every spike; only `l_tau * s` is ever rounded, once a tick, and everywhere alike.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from heliograph.errors import ConfigError, FileError

Activation = Literal["relu", "identity"]
Output = Literal["step", "step_above"]

SIDE: Final = 5
REACH: Final = SIDE // 2
SYNAPSES: Final = SIDE * SIDE
DIRECTIONS: Final = 8
# Ticks in which an edge crosses the kernel's four steps: the paper's longest delay is 10 executions, its number of
# speeds four; 6, 4, 2 divide the range from .4 to 2 pixels a tick about evenly in the logarithm.
CROSSINGS: Final = (10, 6, 4, 2)
NEURONS: Final = DIRECTIONS * len(CROSSINGS)
# History is kept in words of 11 bits: this tick and ten before it.
DELAY_LIMIT: Final = 10
WEIGHT_STEP: Final = 1 / 256
# 25 weights of at most 64 in steps of 1/256 need 19 bits of the 24 that float32 has.
WEIGHT_LIMIT: Final = 64.0
V_TH: Final = 5.0
SCHEMA: Final = "heliograph-flow-network"
VERSION: Final = 1


@dataclass(frozen=True, slots=True, eq=False)
class FlowNetwork:
    """The parameters of one network: what torch exports and the kernels run.

    Args:
        delay: (32, 25) int64, ticks, 0 to 10.
        weight: (32, 25) float32, multiples of 1/256 of at most 64.
        velocity: (32, 2) float64, the (vx, vy) that a neuron stands for, pixels of the network a tick.
        v_th: threshold, above 0.
        l_tau: l(tau), the share of the potential that a tick leaves, 0 to below 1.
        g: input activation.
        h: output activation.

    Raises:
        ConfigError: a shape or a value is out of range.
    """

    delay: npt.NDArray[np.int64]
    weight: npt.NDArray[np.float32]
    velocity: npt.NDArray[np.float64]
    v_th: float = V_TH
    l_tau: float = 0.0
    g: Activation = "relu"
    h: Output = "step"

    def __post_init__(self) -> None:
        for name, shape in (
            ("delay", (NEURONS, SYNAPSES)),
            ("weight", (NEURONS, SYNAPSES)),
            ("velocity", (NEURONS, 2)),
        ):
            if np.shape(getattr(self, name)) != shape:
                raise ConfigError(f"{name} must have the shape {shape}, not {np.shape(getattr(self, name))}")
        if self.delay.min() < 0 or self.delay.max() > DELAY_LIMIT:
            raise ConfigError(f"delay must be 0 to {DELAY_LIMIT} ticks, not {self.delay.min()} to {self.delay.max()}")
        scaled = self.weight.astype(np.float64) / WEIGHT_STEP
        if not np.isfinite(scaled).all() or (scaled != np.rint(scaled)).any() or abs(scaled).max() > 256 * WEIGHT_LIMIT:
            raise ConfigError(f"weight must be multiples of 1/256 within +-{WEIGHT_LIMIT:g}: see quantised()")
        if not (np.isfinite(self.velocity).all() and (np.hypot(*self.velocity.T) > 0).all()):
            raise ConfigError("velocity must be finite and not 0")
        if not (np.isfinite(self.v_th) and self.v_th > 0):
            raise ConfigError(f"v_th must be above 0, not {self.v_th}")
        if not 0 <= self.l_tau < 1:
            raise ConfigError(f"l_tau must be in [0, 1), not {self.l_tau}")
        if self.g not in ("relu", "identity") or self.h not in ("step", "step_above"):
            raise ConfigError(f"g must be relu or identity and h step or step_above, not {self.g} and {self.h}")


def quantised(weight: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return weights moved to the nearest multiples of 1/256, cut to the range that `FlowNetwork` takes."""
    steps = np.rint(np.asarray(weight, np.float64) / WEIGHT_STEP)
    return (np.clip(steps, -256 * WEIGHT_LIMIT, 256 * WEIGHT_LIMIT) * WEIGHT_STEP).astype(np.float32)


def offsets() -> npt.NDArray[np.int64]:
    """Return (25, 2) int64: (dx, dy) of each synapse."""
    j = np.arange(SYNAPSES)
    return np.stack([j % SIDE - REACH, j // SIDE - REACH], axis=1)


def paper_network(l_tau: float = 0.0, v_th: float = V_TH) -> FlowNetwork:
    """Return the network of the paper: delays by direction and speed, weights one.

    Args:
        l_tau: the decay, which the paper leaves open; 0 leaves the memory out.
        v_th: threshold; the paper's is 5.
    """
    delay = np.empty((NEURONS, SYNAPSES), np.int64)
    velocity = np.empty((NEURONS, 2))
    for k in range(NEURONS):
        turn = k // len(CROSSINGS) * 2 * np.pi / DIRECTIONS
        direction = np.round([np.cos(turn), np.sin(turn)], 12)
        crossing = CROSSINGS[k % len(CROSSINGS)]
        v = 2 * REACH / crossing
        # Rounded first: cos(90 degrees) is not quite 0, and would decide which way a half goes.
        ticks = np.floor(np.round((REACH - offsets() @ direction) / v, 9) + 0.5)
        delay[k] = np.clip(ticks, 0, crossing)
        velocity[k] = v * direction
    return FlowNetwork(delay, np.ones((NEURONS, SYNAPSES), np.float32), velocity, v_th=v_th, l_tau=l_tau)


class DenseNetwork:
    """The equations, word by word, in numpy: slow, plain, for any parameters; an oracle.

    Args:
        network: parameters.
        width: columns.
        height: rows.
    """

    def __init__(self, network: FlowNetwork, width: int, height: int) -> None:
        self._n = network
        self._x = np.zeros((DELAY_LIMIT + 1, height + 2 * REACH, width + 2 * REACH), np.float32)
        self.s = np.zeros((NEURONS, height, width), np.float32)
        self.y = np.zeros((NEURONS, height, width), np.bool_)

    def step(self, x: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Take the (height, width) image of the next tick; return the (32, height, width) spikes."""
        n, (height, width) = self._n, x.shape
        self._x = np.roll(self._x, 1, axis=0)
        self._x[0, REACH:-REACH, REACH:-REACH] = x
        drive = np.zeros_like(self.s)
        for k in range(NEURONS):
            for j, (dx, dy) in enumerate(offsets() + REACH):
                drive[k] += n.weight[k, j] * self._x[n.delay[k, j], dy : dy + height, dx : dx + width]
        s = drive + np.float32(n.l_tau) * self.s * ~self.y
        self.s = np.maximum(s, np.float32(0)) if n.g == "relu" else s
        v_th = np.float32(n.v_th)
        self.y = self.s >= v_th if n.h == "step" else self.s > v_th
        return self.y


def save(network: FlowNetwork, path: Path) -> None:
    """Write the parameters as NPZ, with the schema's name and version."""
    np.savez(
        path,
        schema=np.array(SCHEMA),
        version=np.array(VERSION),
        delay=network.delay,
        weight=network.weight,
        velocity=network.velocity,
        v_th=np.array(network.v_th),
        l_tau=np.array(network.l_tau),
        g=np.array(network.g),
        h=np.array(network.h),
    )


def load(path: Path) -> FlowNetwork:
    """Return the network of a file that `save` wrote.

    Raises:
        FileError: the file is missing, no NPZ, of another schema or version, or lacks a field.
        ConfigError: a value is out of range.
    """
    try:
        raw = path.read_bytes()
        # A plain .npy opens as well, and is no mapping.
        with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
            fields = {name: archive[name] for name in archive.files}
    except OSError as error:
        raise FileError(f"{path}: {error.strerror}") from error
    except (ValueError, AttributeError, zipfile.BadZipFile, EOFError) as error:
        raise FileError(f"{path}: not an NPZ file") from error
    if str(fields.get("schema")) != SCHEMA or str(fields.get("version")) != str(VERSION):
        raise FileError(
            f"{path}: must be {SCHEMA} version {VERSION}, not {fields.get('schema')} {fields.get('version')}"
        )
    try:
        return FlowNetwork(
            delay=fields["delay"].astype(np.int64, casting="safe"),
            weight=fields["weight"].astype(np.float32, casting="same_kind"),
            velocity=fields["velocity"].astype(np.float64, casting="safe"),
            v_th=float(fields["v_th"]),
            l_tau=float(fields["l_tau"]),
            g=_word(fields["g"]),  # type: ignore[arg-type]  # checked by FlowNetwork
            h=_word(fields["h"]),  # type: ignore[arg-type]  # checked by FlowNetwork
        )
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: {error}") from error


def _word(field: npt.NDArray[np.str_]) -> str:
    return str(field)
