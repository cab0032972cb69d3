"""Settings of the flow pyramid, each with its range, its default and where the default comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, Self

from heliograph.errors import ConfigError

Readout = Literal["fit", "population"]

# A stream's tick is at most 100 ms (event source), and the paper's own step is that of its loop.
STEP_LIMIT_US: Final = 10_000_000
SCALES_LIMIT: Final = 6


@dataclass(frozen=True, slots=True)
class Scale:
    """One network: its tick, its pixel, and what it takes for an edge.

    It sees speeds from 0.4 to 2 of its pixels a tick.

    Args:
        step_us: length of a tick.
        pool_px: side of the square of sensor pixels that is one of the network's.
        silence_ticks: a pixel is an input when it was silent for so many ticks before; 0 feeds every active tick, as
            the paper does. What is active in every tick while an edge crosses it needs one; more hides the next edge of
            a texture, which follows after 3 ticks at 1000 px/s and 16 px. Slow edges fire in spells, and need more.

    Raises:
        ConfigError: a value is out of range.
    """

    step_us: int
    pool_px: int
    silence_ticks: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.step_us <= STEP_LIMIT_US:
            raise ConfigError(f"step_us of a scale must be 1 to {STEP_LIMIT_US}, not {self.step_us}")
        if not 1 <= self.pool_px <= 64:
            raise ConfigError(f"pool_px of a scale must be 1 to 64, not {self.pool_px}")
        if not 0 <= self.silence_ticks <= 1000:
            raise ConfigError(f"silence_ticks of a scale must be 0 to 1000, not {self.silence_ticks}")


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """Settings of one camera's flow.

    Args:
        scales: the networks. The default three see 240 to 1200, 80 to 400 and 16 to 80 px/s: a network covers 5 to 1,
            and 20 to 1000 are asked for. The fastest step is the tracker's own window; pooling by 4 there would
            reach 1600, but lose texture finer than that. The slowest pools by 2 as well: at 20 px/s a weak texture
            fires a pixel too seldom for 5 x 5 of them to tell a front (108 % of error by pixels, 14 % by squares of 2;
            a sharp disc has 6 % instead of 3).
        l_tau: the network's memory. With .5 the errors are about the same (a little more on discs and edges, a little
            less on slow texture); 0 runs several times as fast.
        v_th: the paper's threshold.
        noise_share: the gate's threshold is the least count of events that noise alone reaches in at most this share
            of pixels and ticks. Neighbours share events, so noise passes in clumps: noise of 10 Mev/s alone reached a
            confidence of .31 at .005 (99 % of the answers at the slowest scale), .18 at .001; motion loses nothing.
        readout: "fit": where a neuron fires, a plane is fitted to the arrival times at its synapses; "population": the
            neurons' velocities, weighted by the cubed potential.
        hold_ticks: samples this old still answer; the slowest edge takes 10 ticks to cross a kernel.
        tile_inputs: where more inputs than this fall on 64 x 16 pixels of a network within 11 ticks, only a sample of
            the spikes is read (`sampling`); in proportion more where a tick is longer than 10 ms: work a second is
            what counts. A disc 9 px across that crosses a tile makes about as many; inf reads all.
        limit_pixels: a tick of more inputs is a flash, and is counted and skipped.

    Raises:
        ConfigError: a value is out of range.
    """

    scales: tuple[Scale, ...] = (Scale(5_000, 3), Scale(10_000, 2, 2), Scale(50_000, 2, 3))
    l_tau: float = 0.0
    v_th: float = 5.0
    noise_share: float = 0.001
    readout: Readout = "fit"
    hold_ticks: int = 6
    tile_inputs: float = 64.0
    limit_pixels: int = 200_000

    def __post_init__(self) -> None:
        if not 1 <= len(self.scales) <= SCALES_LIMIT:
            raise ConfigError(f"scales must be 1 to {SCALES_LIMIT}, not {len(self.scales)}")
        if not 0 <= self.l_tau < 1:
            raise ConfigError(f"l_tau must be in [0, 1), not {self.l_tau}")
        if not 0 < self.v_th <= 1000:
            raise ConfigError(f"v_th must be above 0 and at most 1000, not {self.v_th}")
        if not 0 < self.noise_share <= 1:
            raise ConfigError(f"noise_share must be above 0 and at most 1 (1 opens the gate), not {self.noise_share}")
        if self.readout not in ("fit", "population"):
            raise ConfigError(f"readout must be fit or population, not {self.readout}")
        if not 1 <= self.hold_ticks <= 100:
            raise ConfigError(f"hold_ticks must be 1 to 100, not {self.hold_ticks}")
        if not self.tile_inputs > 0:
            raise ConfigError(f"tile_inputs must be above 0 (inf reads all), not {self.tile_inputs}")
        if self.limit_pixels < 1:
            raise ConfigError(f"limit_pixels must be at least 1, not {self.limit_pixels}")

    @classmethod
    def literal(cls, l_tau: float = 0.5, period_us: int = 100_000) -> Self:
        """Return the paper read literally: one network of full resolution, a tick an execution at 10 Hz, raw input.

        Args:
            l_tau: the memory; the paper has one and does not give its value.
            period_us: of the tracking loop.
        """
        return cls(
            scales=(Scale(period_us, 1, 0),),
            l_tau=l_tau,
            noise_share=1.0,
            readout="population",
            hold_ticks=1,
            tile_inputs=math.inf,
            limit_pixels=4_000_000,
        )
