"""What the parts of the simulation say to each other. Pure data; every part can be made and tested alone.

::

    scenario --world--> LightChunk (where every light's image is, what its LED does) --+
             --ground-> views (log irradiance of the surroundings, pixel by pixel) ----+--pixel--> PixelEvents
                                                                                              --readout--> EventBatch

Units. All light is irradiance on the sensor plane, W/m2, within the camera's band: a pixel's threshold, bandwidth and
noise depend on it alone. A light's `flux_w_m2` is its power through the lens over a pixel's area: what a pixel would
see if the whole image of the light fell into it. Its image is a round Gaussian of standard deviation `sigma_px`
(point spread, size of the emitter and defocus together), so pixel (i, j) sees
``level flux wx(i) wy(j), wx(i) = Phi((i + .5 - x) / sigma) - Phi((i - .5 - x) / sigma)``, Phi the normal distribution.

Time. Everything happens on an absolute grid: light chunks of CHUNK_US, within them nodes of NODE_US; intervals between
two views, whose ends depend on the scenario alone and never straddle a chunk. No result depends on how the stream is
cut into batches. Times within the simulation are float64 microseconds since the scene began; only a read-out rounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch, Flags

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
View = npt.NDArray[np.float32]
Labels = npt.NDArray[np.int16]

# Lights are described for so much time at once: long enough to spread the cost of asking every path and every LED,
# short enough that an LED driven live from outside is not delayed by more than people notice.
CHUNK_US: Final = 20_000
# Between two nodes an image moves on a straight line: at 11,000 px/s on a circle of 200 px it errs by 0.08 px.
NODE_US: Final = 1_000
NODES: Final = CHUNK_US // NODE_US

# Causes of events that no light made (a light's events carry its index).
BACKGROUND: Final = -1
SHOT_NOISE: Final = -2
HOT_PIXEL: Final = -3
LEAK: Final = -4


@dataclass(frozen=True, slots=True, eq=False)
class LightChunk:
    """All lights in [t0_us, t0_us + CHUNK_US).

    Args:
        t0_us: a multiple of CHUNK_US.
        x_px: (lights, NODES + 1) float64, centre of the image at t0_us + k NODE_US, straight lines in between.
        y_px: (lights, NODES + 1) float64.
        sigma_px: (lights, NODES + 1) float64.
        flux_w_m2: (lights, NODES + 1) float64; 0 where hidden, behind the camera or far off the sensor.
        level0: (lights,) float64, 0 (dark) to 1, the light's state just before t0_us.
        edge_first: (lights + 1,) int64; the edges of light i are [edge_first[i], edge_first[i + 1]).
        edge_us: (n,) float64, in [t0_us, t0_us + CHUNK_US), not falling within a light.
        edge_level: (n,) float64, the light's state from then on.
    """

    t0_us: int
    x_px: Floats
    y_px: Floats
    sigma_px: Floats
    flux_w_m2: Floats
    level0: Floats
    edge_first: Ints
    edge_us: Floats
    edge_level: Floats


@dataclass(frozen=True, slots=True)
class SentFrame:
    """A frame on the air, its bits from t0_us to t1_us."""

    t0_us: float
    t1_us: float
    payload: int


class Drive(Protocol):
    """What makes a light bright and dark. Asked in order of time; its answers do not depend on how time is cut."""

    def changes(self, t0_us: float, t1_us: float) -> tuple[Floats, Floats]:
        """Return times (float64 us, in [t0_us, t1_us), not falling) and the level (0 to 1) from each on."""
        ...

    def level(self, t_us: float) -> float:
        """Return the level just before t_us."""
        ...

    def frames_ended(self, t0_us: float, t1_us: float) -> list[SentFrame]:
        """Return the frames whose last bit ended in [t0_us, t1_us), in order of time; none for what is no beacon."""
        ...


class Background(Protocol):
    """The surroundings, as views."""

    def next_us(self, t_us: int) -> int:
        """Return the end of the interval that begins at t_us: at most 5 ms later, never across a multiple of CHUNK_US.

        Called with 0 first, then with what it returned.
        """
        ...

    def view(self, t_us: int) -> View:
        """Return (height, width) float32, ln(irradiance + dark) at an end of an interval, in W/m2.

        The same object as before where nothing has changed; between two ends a pixel's value goes on a straight line.
        Never changed after it was returned.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PixelEvents:
    """n events as pixels make them, before the read-out.

    Args:
        t_us: (n,) float64, not falling; of equal times, the smaller pixel first.
        pixel: (n,) int64, y width + x.
        on: (n,) bool.
        cause: (n,) int16, index of a light, or one of the constants above.
    """

    t_us: Floats
    pixel: Ints
    on: Flags
    cause: Labels

    def __len__(self) -> int:
        return len(self.t_us)


class Readout(Protocol):
    """Takes the pixels' events to the outside, as far as its bus or scan can."""

    counters: dict[str, int]  # what it lost, by reason; and what it read

    @property
    def until_us(self) -> int:
        """All events before this time have been returned."""
        ...

    def feed(self, events: PixelEvents, until_us: float) -> tuple[EventBatch, Labels]:
        """Return the events whose read-out is complete, sorted by time, and the cause of each.

        Args:
            events: all in [the previous until_us, until_us).
            until_us: the pixels have no more events before this time.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelNumbers:
    """What a pixel obeys; a preset gives each number with its source.

    Args:
        threshold_on: step of ln(irradiance) that makes an ON event, mean over the pixels.
        threshold_off: the same for OFF, positive.
        threshold_sd: standard deviation of both, pixel by pixel (mismatch), each its own.
        tau_ref_us: time constant of the photoreceptor at irradiance_ref_w_m2; tau = tau_ref I_ref / I.
        irradiance_ref_w_m2: I_ref.
        tau_min_us: the time constant's floor.
        dark_w_m2: dark current as irradiance; added to all light.
        refractory_us: after an event a pixel's reference follows its photoreceptor for so long.
        leak_hz: ON events a second of a pixel in constant light (drift of the reference).
        shot_noise_hz: events a second and pixel, either polarity.
        hot_pixels: share of the pixels that are hot.
        hot_pixel_hz: their events a second.
        latency_us: constant delay of an event behind the crossing.
        latency_off_extra_us: what OFF events have more of it.
        jitter_us: standard deviation of an event's delay; never before the crossing.
    """

    threshold_on: float
    threshold_off: float
    threshold_sd: float
    tau_ref_us: float
    irradiance_ref_w_m2: float
    tau_min_us: float
    dark_w_m2: float
    refractory_us: float
    leak_hz: float
    shot_noise_hz: float
    hot_pixels: float
    hot_pixel_hz: float
    latency_us: float
    latency_off_extra_us: float
    jitter_us: float
