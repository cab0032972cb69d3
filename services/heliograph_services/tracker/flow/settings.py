"""Settings of the flow pyramid, each with its range, its default and where the default comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, Self

from heliograph.errors import ConfigError

Readout = Literal["fit", "population"]

# A stream's tick is at most 100 ms (event source), and the paper's own step is that of its loop.
STEP_LIMIT_US: Final = 10_000_000
SCALES_LIMIT: Final = 6


@dataclass(frozen=True, slots=True)
class Scale:
    """One network: its tick, and the side of the square of sensor pixels that is one of its pixels.

    It sees speeds from 0.4 to 2 of its pixels a tick.
    """

    step_us: int
    pool_px: int

    def __post_init__(self) -> None:
        if not 1 <= self.step_us <= STEP_LIMIT_US:
            raise ConfigError(f"step_us of a scale must be 1 to {STEP_LIMIT_US}, not {self.step_us}")
        if not 1 <= self.pool_px <= 64:
            raise ConfigError(f"pool_px of a scale must be 1 to 64, not {self.pool_px}")


@dataclass(frozen=True, slots=True)
class FlowSettings:
    """Settings of one camera's flow.

    Args:
        scales: the networks. The default three see 240 to 1200, 80 to 400 and 16 to 80 px/s: a network covers 5 to 1,
            and 20 to 1000 are asked for. The fastest step is the event source's default tick; pooling by 4 there would
            reach 1600, but lose texture finer than that.
        l_tau: the network's memory. With .5 the errors are about the same (a little more on discs and edges, a little
            less on slow texture); 0 runs several times as fast.
        v_th: the paper's threshold.
        silence_ticks: a pixel is an input when it was silent for so many ticks before; 0 feeds every active tick, as
            the paper does. An edge takes 2.5 ticks to cross a pixel at the lowest speed. With 10, the next edge of a
            texture comes too early to be seen: of stripes of 16 px at 500 px/s, 4 % of the places had an answer, and
            all of them with 3.
        noise_share: the gate's threshold is the least count of events that noise alone reaches in at most this share
            of pixels and ticks. At .005 a neuron's 25 synapses see .1 noise inputs a tick; 5 coincide once in 1e7.
        readout: "fit": where a neuron fires, a plane is fitted to the arrival times at its synapses; "population": the
            neurons' velocities, weighted by the cubed potential.
        hold_ticks: samples this old still answer; the slowest edge takes 10 ticks to cross a kernel.
        limit_pixels: a tick of more inputs is a flash, and is counted and skipped.

    Raises:
        ConfigError: a value is out of range.
    """

    scales: tuple[Scale, ...] = (Scale(5_000, 3), Scale(10_000, 2), Scale(25_000, 1))
    l_tau: float = 0.0
    v_th: float = 5.0
    silence_ticks: int = 3
    noise_share: float = 0.005
    readout: Readout = "fit"
    hold_ticks: int = 6
    limit_pixels: int = 200_000

    def __post_init__(self) -> None:
        if not 1 <= len(self.scales) <= SCALES_LIMIT:
            raise ConfigError(f"scales must be 1 to {SCALES_LIMIT}, not {len(self.scales)}")
        if not 0 <= self.l_tau < 1:
            raise ConfigError(f"l_tau must be in [0, 1), not {self.l_tau}")
        if not 0 < self.v_th <= 1000:
            raise ConfigError(f"v_th must be above 0 and at most 1000, not {self.v_th}")
        if not 0 <= self.silence_ticks <= 1000:
            raise ConfigError(f"silence_ticks must be 0 to 1000, not {self.silence_ticks}")
        if not 0 < self.noise_share <= 1:
            raise ConfigError(f"noise_share must be above 0 and at most 1 (1 opens the gate), not {self.noise_share}")
        if self.readout not in ("fit", "population"):
            raise ConfigError(f"readout must be fit or population, not {self.readout}")
        if not 1 <= self.hold_ticks <= 100:
            raise ConfigError(f"hold_ticks must be 1 to 100, not {self.hold_ticks}")
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
            scales=(Scale(period_us, 1),),
            l_tau=l_tau,
            silence_ticks=0,
            noise_share=1.0,
            readout="population",
            hold_ticks=1,
            limit_pixels=4_000_000,
        )
