"""What was really there, window by window: the only place of the source that knows the truth's record."""

from __future__ import annotations

from typing import Final

import numpy as np

from heliograph.truth import Truth
from heliograph_services.event_source.simulation.paths import Path
from heliograph_services.event_source.simulation.scenario import Scenario
from heliograph_services.event_source.simulation.scene import Scene

# A frame counts as visible when the LED was on the sensor at so many moments of it, evenly spread, ends included.
_MOMENTS: Final = 5


def truth_of(scene: Scene, camera: str, t0_us: int, t1_us: int) -> Truth:
    """Return the truth of a window [t0_us, t1_us); frames that began before time 0 were not sent."""
    scenario = scene.scenario
    now = np.array([t1_us], np.float64)
    places = [tuple(float(c[0]) for c in spec.path.at(now)) for spec in scenario.beacons]
    in_view = [on_sensor(scenario, x, y) for x, y in places]
    frames = [
        (frame, i)
        for i, emitter in enumerate(scene.emitters)
        for frame in emitter.frames_ended(t0_us, t1_us)
        if frame.t0_us >= 0
    ]
    frames.sort(key=lambda entry: (entry[0].t1_us, entry[1]))
    tracks = [_during(scenario, scenario.beacons[i].path, frame.t0_us, frame.t1_us) for frame, i in frames]
    return Truth(
        camera=camera,
        t0_us=t0_us,
        t1_us=t1_us,
        sensor="ideal",
        fidelity="full",
        beacon=[spec.name for spec in scenario.beacons],
        protocol=[spec.protocol for spec in scenario.beacons],
        x_px=[x for x, _ in places],
        y_px=[y for _, y in places],
        radius_px=[spec.radius_px for spec in scenario.beacons],
        x_m=[0.0 for _ in places],
        y_m=[0.0 for _ in places],
        z_m=[0.0 for _ in places],
        in_view=in_view,
        visible=list(in_view),
        frame_beacon=[i for _, i in frames],
        frame_t0_us=[round(frame.t0_us) for frame, _ in frames],
        frame_t1_us=[round(frame.t1_us) for frame, _ in frames],
        frame_payload=[frame.payload for frame, _ in frames],
        frame_x_px=[x for x, _, _ in tracks],
        frame_y_px=[y for _, y, _ in tracks],
        frame_visible=[visible for _, _, visible in tracks],
        edge_beacon=np.empty(0, np.uint16),
        edge_us=np.empty(0),
        edge_on=np.empty(0, np.bool_),
    )


def on_sensor(scenario: Scenario, x_px: float, y_px: float) -> bool:
    """Return whether a point lies on the sensor: on one of its pixels, each half a pixel around its centre."""
    return -0.5 <= x_px < scenario.width - 0.5 and -0.5 <= y_px < scenario.height - 0.5


def _during(scenario: Scenario, path: Path, t0_us: float, t1_us: float) -> tuple[float, float, bool]:
    """Return where a beacon was at the end of a frame, and whether it was on the sensor throughout."""
    x_px, y_px = path.at(np.linspace(t0_us, t1_us, _MOMENTS))
    visible = all(on_sensor(scenario, float(x), float(y)) for x, y in zip(x_px, y_px, strict=True))
    return float(x_px[-1]), float(y_px[-1]), visible
