"""Lights joined: each light with its place and the edges of its emitter's drive, chunk by chunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heliograph_services.event_source.simulation.contract import CHUNK_US, NODES
from heliograph_services.event_source.simulation.lights import drive_of
from heliograph_services.event_source.simulation.lights.chunk import Lights
from heliograph_services.event_source.simulation.world.load import parse_scenario
from heliograph_services.event_source.simulation.world.spec import BeaconSpec, ClutterSpec
from heliograph_services.event_source.simulation.world.world import LightInfo, World

SCENE = """
[camera]
sensor = "ideal"
path = { kind = "still", at_m = [0.0, 0.0, 5.0] }
[[beacon]]
name = "one"
protocol = "seed11"
payload = 42
bit_rate = 1000
path = { kind = "still", at_m = [0.0, 0.0, 0.0] }
leds = [[-0.1, 0.0], [0.1, 0.0]]
[[beacon]]
name = "two"
protocol = "seed11"
fresh = true
bit_rate = 2000
path = { kind = "still", at_m = [1.0, 0.0, 0.0] }
[[clutter]]
name = "lamp"
path = { kind = "still", at_m = [0.0, 1.0, 0.0] }
signal = { kind = "steady" }
"""


@dataclass
class Nothing:
    lights: list[LightInfo]


def test_chunks_join_every_light_with_its_emitters_edges() -> None:
    world = World(parse_scenario(SCENE, "test"), 640, 480, 9.0, 0)
    specs: list[BeaconSpec | ClutterSpec] = [*world.beacons, *world.clutter]
    lights = Lights([drive_of(spec, 5, i) for i, spec in enumerate(specs)], world)
    emitters = [light.emitter for light in world.lights]
    assert emitters == [0, 0, 1, 2]
    level = None
    for t0_us in range(0, 10 * CHUNK_US, CHUNK_US):
        geometry = world.chunk_geometry(t0_us)
        where = (geometry.x_px, geometry.y_px, geometry.sigma_px, geometry.flux_w_m2)
        chunk = lights.chunk(t0_us, where)
        assert chunk.t0_us == t0_us
        assert chunk.x_px.shape == (4, NODES + 1)
        assert chunk.flux_w_m2 is geometry.flux_w_m2
        now = []
        for i, emitter in enumerate(emitters):
            mine = slice(chunk.edge_first[i], chunk.edge_first[i + 1])
            t_us, wanted = drive_of(specs[emitter], 5, emitter).changes(t0_us, t0_us + CHUNK_US)
            assert np.array_equal(chunk.edge_us[mine], t_us)
            assert np.array_equal(chunk.edge_level[mine], wanted)
            now.append(wanted[-1] if len(wanted) else chunk.level0[i])
        if level is not None:
            assert chunk.level0.tolist() == level
        level = now
        assert chunk.edge_first[-1] == len(chunk.edge_us)


def test_a_world_without_lights_has_empty_chunks() -> None:
    nothing = np.empty((0, NODES + 1))
    chunk = Lights([], Nothing([])).chunk(0, (nothing, nothing, nothing, nothing))
    assert (len(chunk.level0), chunk.edge_first.tolist(), len(chunk.edge_us)) == (0, [0], 0)
