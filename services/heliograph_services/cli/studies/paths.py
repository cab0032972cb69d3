"""Where every beacon of a scene really is, node by node: what a genie knows, and what tracks and frames are scored by.

The scene moves its images on straight lines between nodes of a millisecond (`simulation.contract.NODE_US`), so a place
between two nodes is exact. `reach_px` is how far from its centre a beacon's edges still make events. A disc's image
is a Gaussian (sigma, flux Phi) before a ground B; an edge is ln(1 + Phi / (2 pi sigma^2 B) exp(-r^2 / 2 sigma^2)) at r,
and above the threshold theta up to::

    r = sigma sqrt(2 ln(Phi / (2 pi sigma^2 B (e^theta - 1))))
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt

from heliograph.messages import Name
from heliograph.truth import Truth
from heliograph_services.event_source.simulation.contract import CHUNK_US, NODE_US, NODES
from heliograph_services.event_source.simulation.readout.numbers import ImageNumbers
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.spec import BeaconSpec

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# Nodes asked of the world at a time: 2 s of 100 beacons are 8 columns of 1.6 MB.
_BLOCK: Final = 2000
# Events lag behind the light: a scan of 200 us at 2,000 px/s is 0.4 px; half a pixel is the pixel's own extent.
MARGIN_PX: Final = 1.0
# Of a camera that compares images: the mean grey of its surroundings (its preset's background_grey).
_GREY: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class TruePaths:
    """k beacons at n nodes, NODE_US apart from time 0 on; all arrays (k, n).

    Args:
        beacons: as the scenario has them.
        x_px: float64, centres.
        y_px: float64.
        radius_px: float64, half of the image's full width at half maximum.
        reach_px: float64, see the module.
        in_view: bool.
        visible: bool.
    """

    beacons: tuple[BeaconSpec, ...]
    x_px: Floats
    y_px: Floats
    radius_px: Floats
    reach_px: Floats
    in_view: Flags
    visible: Flags

    @property
    def names(self) -> list[Name]:
        """The beacons' names."""
        return [spec.name for spec in self.beacons]

    @property
    def until_us(self) -> int:
        """The last node."""
        return (len(self.x_px[0]) - 1) * NODE_US

    def nodes(self, t_us: npt.ArrayLike) -> tuple[Longs, Floats]:
        """Return (m,) the node at or before each time and (m,) how far each is towards the next, 0 to 1.

        A time outside the nodes is as the first or the last.
        """
        t = np.clip(np.asarray(t_us, np.float64) / NODE_US, 0.0, self.x_px.shape[1] - 1)
        node: Longs = np.minimum(t.astype(np.int64), self.x_px.shape[1] - 2)
        return node, t - node

    def places(self, t_us: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return (k, m) x and y of all beacons at (m,) times."""
        node, share = self.nodes(t_us)
        x: Floats = self.x_px[:, node] + share * (self.x_px[:, node + 1] - self.x_px[:, node])
        y: Floats = self.y_px[:, node] + share * (self.y_px[:, node + 1] - self.y_px[:, node])
        return x, y

    def velocities(self, t_us: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return (k, m) velocities in px/s at (m,) times, over the node interval of each."""
        node, _ = self.nodes(t_us)
        per_s = 1e6 / NODE_US
        vx: Floats = (self.x_px[:, node + 1] - self.x_px[:, node]) * per_s
        vy: Floats = (self.y_px[:, node + 1] - self.y_px[:, node]) * per_s
        return vx, vy

    def truths(self, like: Truth, step_us: int, until_us: int) -> list[Truth]:
        """Return the truth of [0, until_us) in windows of step_us, without frames and edges: for scoring tracks.

        Args:
            like: names camera, sensor and fidelity.
            step_us: a multiple of NODE_US.
            until_us: at most the last node.
        """
        empty: dict[str, list[float]] = {name: [] for name in Truth.__struct_fields__ if name.startswith("frame_")}
        zeros = [0.0] * len(self.beacons)
        out = []
        for t1_us in range(step_us, until_us + 1, step_us):
            at = t1_us // NODE_US
            out.append(
                msgspec.structs.replace(
                    like,
                    t0_us=t1_us - step_us,
                    t1_us=t1_us,
                    beacon=self.names,
                    protocol=[spec.protocol for spec in self.beacons],
                    x_px=self.x_px[:, at].tolist(),
                    y_px=self.y_px[:, at].tolist(),
                    radius_px=self.radius_px[:, at].tolist(),
                    x_m=zeros,
                    y_m=zeros,
                    z_m=zeros,
                    in_view=self.in_view[:, at].tolist(),
                    visible=self.visible[:, at].tolist(),
                    edge_beacon=np.empty(0, np.uint16),
                    edge_us=np.empty(0),
                    edge_on=np.empty(0, np.bool_),
                    **empty,
                )
            )
        return out


def true_paths(scene: SceneStream, until_us: int) -> TruePaths:
    """Return the paths of a scene's beacons from 0 to until_us or a little later."""
    n = -(-until_us // CHUNK_US) * NODES + 1
    world = scene.world
    blocks = [
        world.seen_all(np.arange(first, min(first + _BLOCK, n), dtype=np.float64) * NODE_US)
        for first in range(0, n, _BLOCK)
    ]

    def whole(name: str) -> npt.NDArray[Any]:
        return np.concatenate([getattr(block, name) for block in blocks], axis=1)

    # Behind the camera a place says nothing: it stays finite and far.
    x_px, y_px = (np.clip(whole(name), -1e6, 1e6) for name in ("x_px", "y_px"))
    return TruePaths(
        beacons=tuple(world.beacons),
        x_px=x_px,
        y_px=y_px,
        radius_px=whole("radius_px"),
        reach_px=_reach(scene, x_px, y_px),
        in_view=whole("in_view"),
        visible=whole("visible"),
    )


def _reach(scene: SceneStream, x_px: Floats, y_px: Floats) -> Floats:
    """Return (k, n) float64: how far each beacon's edges make events at (k, n) places; 0 where nothing shines."""
    world = scene.world
    ground = world.scenario.ground
    dark = (
        world.optics.background_w_m2(ground.reflectance, world.scenario.irradiance_w_m2) + scene.sensor.pixel.dark_w_m2
    )
    step = dark * (np.exp(_threshold(scene)) - 1.0)
    k, n = x_px.shape
    of = np.array([light.emitter for light in world.lights], np.int64)
    mine = np.flatnonzero(of < k)
    of = of[mine]
    reach = np.zeros((k, n))
    for first in range(0, n - 1, NODES):
        where = world.chunk_geometry(first * NODE_US)
        nodes = slice(first, first + NODES + 1)
        sigma, flux = where.sigma_px[mine], where.flux_w_m2[mine]
        ratio = np.maximum(flux / (2.0 * np.pi * sigma**2 * step), 1.0)
        # Of several LEDs the one that is farthest from their common centre.
        away = np.hypot(where.x_px[mine] - x_px[of, nodes], where.y_px[mine] - y_px[of, nodes])
        span = np.where(flux > 0.0, sigma * np.sqrt(2.0 * np.log(ratio)) + away + MARGIN_PX, 0.0)
        np.maximum.at(reach[:, nodes], of, span)
    return reach


def _threshold(scene: SceneStream) -> float:
    numbers = scene.sensor.readout
    if isinstance(numbers, ImageNumbers):
        return float(np.log1p(numbers.threshold_grey / _GREY))
    return min(scene.sensor.pixel.threshold_on, scene.sensor.pixel.threshold_off)
