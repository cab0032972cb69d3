"""The world before a sensor: what is shown where, what hides it, what the truth says, crowds."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph_services.event_source.simulation.contract import CHUNK_US, NODE_US, NODES
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.world.load import built_in, load_scenario
from heliograph_services.event_source.simulation.world.optics import FWHM_PER_SIGMA, contrast
from heliograph_services.event_source.simulation.world.spec import (
    Asset,
    Attitude,
    BeaconSpec,
    CameraSpec,
    Circle,
    ClutterSpec,
    Crowd,
    Mains,
    Path,
    Scenario,
    Shake,
    Shuttle,
    Sine,
    Steady,
    Still,
)
from heliograph_services.event_source.simulation.world.world import World

NODES_US = np.arange(NODES + 1, dtype=np.float64) * NODE_US
MIDDLE = Still(at_m=(0.0, 0.0, 0.0))


def beacon(name: str = "a", path: Path | None = MIDDLE, **more: object) -> BeaconSpec:
    fields: dict[str, object] = {"protocol": "seed11", "bit_rate": 1000.0, "payload": 42} | more
    return BeaconSpec(name=name, path=path, **fields)  # type: ignore[arg-type]  # a test's short hand


def world(*beacons: BeaconSpec, seed: int = 0, **more: object) -> World:
    return World(Scenario(beacons=beacons, **more), 640, 480, 9.0, seed)  # type: ignore[arg-type]  # likewise


def test_a_still_light_is_where_the_projection_has_it_and_as_strong_as_the_budget_says() -> None:
    w = world(beacon(path=Still(at_m=(1.0, 0.5, 0.0))))
    g = w.chunk_geometry(0)
    assert g.x_px.shape == g.y_px.shape == g.sigma_px.shape == g.flux_w_m2.shape == (1, NODES + 1)
    np.testing.assert_allclose(g.x_px, 319.5 + 80)
    np.testing.assert_allclose(g.y_px, 239.5 - 40)
    distance = np.sqrt(1 + 0.25 + 25)
    np.testing.assert_allclose(g.flux_w_m2, w.optics.flux_w_m2(np.array(0.4), np.array(distance), np.array(5.0)))
    np.testing.assert_allclose(g.sigma_px * FWHM_PER_SIGMA, 1.9, atol=0.05)


def test_chunks_meet_at_their_ends() -> None:
    w = world(
        beacon(path=Circle(centre_m=(0.0, 0.0, 0.0), radius_m=2.0, turn_s=1.0)),
        camera=CameraSpec(
            path=Sine(at_m=(0, 0, 5), amplitude_m=(1, 1, 0.5), period_s=(3, 2, 5)), shake=Shake(rms_deg=0.2)
        ),
    )
    a, b = w.chunk_geometry(0), w.chunk_geometry(CHUNK_US)
    for name in ("x_px", "y_px", "sigma_px", "flux_w_m2"):
        np.testing.assert_array_equal(getattr(a, name)[:, -1], getattr(b, name)[:, 0])


def test_between_two_nodes_an_image_at_11_000_px_s_keeps_to_its_straight_line() -> None:
    w = World(load_scenario("spin"), 640, 480, 9.0, 0)
    t0_us = 19_980_000
    g = w.chunk_geometry(t0_us)
    between = w.seen(0, t0_us + NODES_US[:-1] + NODE_US / 2)
    error = np.hypot(
        between.x_px - (g.x_px[0, 1:] + g.x_px[0, :-1]) / 2, between.y_px - (g.y_px[0, 1:] + g.y_px[0, :-1]) / 2
    )
    speed = np.hypot(np.diff(g.x_px[0]), np.diff(g.y_px[0])) * 1000
    assert speed.max() == pytest.approx(11_000, rel=0.01)
    assert error.max() < 0.08


def test_the_truth_of_a_beacon_is_the_light_that_is_shown() -> None:
    w = World(load_scenario("construction_site"), 640, 480, 9.0, 0)
    t0_us = 7_000_000
    g = w.chunk_geometry(t0_us)
    seen = w.seen_all(t0_us + NODES_US)
    for i in range(len(w.beacons)):
        shown = seen.visible[i]
        np.testing.assert_allclose(g.x_px[i][shown], seen.x_px[i][shown], atol=1e-9)
        assert (g.flux_w_m2[i][shown] > 0).all()
        one = w.seen(i, t0_us + NODES_US)
        np.testing.assert_array_equal(one.x_px, seen.x_px[i])
        np.testing.assert_array_equal(one.visible, seen.visible[i])


def test_a_light_that_leaves_the_sensor_goes_dark_beyond_its_image_and_stays_near() -> None:
    w = world(beacon(path=Shuttle(from_m=(0, 0, 0), to_m=(400.0, 0, 0), speed_m_s=100.0, turn_s=0.0)))
    for k in range(10):
        g = w.chunk_geometry(k * CHUNK_US)
        seen = w.seen(0, k * CHUNK_US + NODES_US)
        margin = 6 * g.sigma_px + 2
        assert (g.x_px <= 639 + margin).all()
        beyond = seen.x_px > 639 + margin[0]
        np.testing.assert_array_equal(g.flux_w_m2[0] == 0.0, beyond)
        np.testing.assert_array_equal(seen.in_view, seen.x_px < 639.5)


def test_a_light_behind_the_camera_or_nearer_than_five_focal_lengths_is_dark_and_finite() -> None:
    w = world(
        beacon("behind", Still(at_m=(0, 0, 6.0))),
        beacon("level", Still(at_m=(1.0, 0, 5.0))),
        beacon("near", Still(at_m=(0, 0, 4.99))),
    )
    g = w.chunk_geometry(0)
    assert not g.flux_w_m2.any()
    assert np.isfinite(g.x_px).all()
    assert np.isfinite(g.sigma_px).all()
    assert not w.seen_all(np.array([0.0])).in_view.any()


def test_leds_are_lights_of_one_emitter_and_share_its_strength() -> None:
    leds = ((0.2, 0.0), (-0.2, 0.0), (0.0, 0.1))
    w = world(beacon("a", leds=leds), beacon("b", Still(at_m=(1, 1, 0))))
    assert [(light.name, light.emitter, light.led) for light in w.lights] == [
        ("a", 0, 0),
        ("a", 0, 1),
        ("a", 0, 2),
        ("b", 1, 0),
    ]
    g = w.chunk_geometry(0)
    np.testing.assert_allclose(g.x_px[:3, 0] - 319.5, [16, -16, 0], atol=1e-9)
    np.testing.assert_allclose(g.y_px[:3, 0] - 239.5, [0, 0, -8], atol=1e-9)
    assert g.flux_w_m2[2, 0] == pytest.approx(w.optics.flux_w_m2(np.array(0.4 / 3), np.array(5), np.array(5)), rel=1e-3)
    # The truth's radius reaches around the outermost.
    assert w.seen(0, np.array([0.0])).radius_px[0] == pytest.approx(16 + 1.9 / 2, abs=0.05)


def test_clutter_comes_behind_the_beacons() -> None:
    lamp = ClutterSpec(name="lamp", signal=Steady(), path=MIDDLE)
    w = world(
        beacon("a"), clutter=(lamp,), crowds=(Crowd(count=3, protocol="seed11", bit_rate=500, area_m=(-2, -2, 2, 2)),)
    )
    assert [light.name for light in w.lights] == ["a", "b000", "b001", "b002", "lamp"]
    assert [spec.name for spec in w.beacons] == ["a", "b000", "b001", "b002"]
    assert [spec.name for spec in w.clutter] == ["lamp"]


def test_an_emitter_with_a_lobe_is_fainter_from_the_side() -> None:
    w = world(
        beacon("up", Still(at_m=(2.0, 0, 0)), half_angle_deg=30.0),
        beacon("at_me", Still(at_m=(2.0, 0, 0)), half_angle_deg=30.0, axis=(-2.0, 0, 5.0)),
        beacon("away", Still(at_m=(2.0, 0, 0)), half_angle_deg=30.0, axis=(0, 0, -1.0)),
    )
    up, at_me, away = w.chunk_geometry(0).flux_w_m2[:, 0]
    m = np.log(0.5) / np.log(np.cos(np.pi / 6))
    assert up / at_me == pytest.approx((5 / np.hypot(2, 5)) ** m)
    assert away == 0.0


def test_a_carried_light_goes_with_its_asset_in_the_assets_own_directions() -> None:
    cart = Asset(
        name="cart", path=Shuttle(from_m=(-1, 0, 1), to_m=(1, 0, 1), speed_m_s=1), size_m=(1, 2), heading_deg=90
    )
    w = world(beacon(path=None, carried_by="cart", offset_m=(0.0, 0.5, 0.1), leds=((0.0, 0.2),)), assets=(cart,))
    seen = w.seen(0, np.array([0.0]))
    # Heading east: the asset's ahead is the world's east.
    assert (seen.x_m[0], seen.y_m[0], seen.z_m[0]) == pytest.approx((-0.5, 0.0, 1.1))
    assert w.chunk_geometry(0).x_px[0, 0] == pytest.approx(319.5 + 400 * (-0.3) / 3.9)
    assert seen.visible[0]


def test_an_asset_hides_what_is_below_it_and_only_that() -> None:
    roof = Asset(name="roof", path=Still(at_m=(1.0, 0, 2.5)), size_m=(1.0, 1.0))
    # From 5 m, the roof at half the height covers twice its size on the ground: x from 1 to 3 m, y from -1 to 1 m.
    places = {"under": (2.0, 0.0, 0.0), "edge_in": (2.98, 0.98, 0.0), "edge_out": (3.02, 0.0, 0.0),
              "side": (0.98, 0.0, 0.0), "on_top": (1.0, 0.0, 2.6)}  # fmt: skip
    w = world(*(beacon(name, Still(at_m=at)) for name, at in places.items()), assets=(roof,))
    seen = w.seen_all(np.array([0.0]))
    assert seen.in_view.all()
    assert dict(zip(places, seen.visible[:, 0].tolist(), strict=True)) == {
        "under": False, "edge_in": False, "edge_out": True, "side": True, "on_top": True,
    }  # fmt: skip
    np.testing.assert_array_equal(w.chunk_geometry(0).flux_w_m2[:, 0] > 0, seen.visible[:, 0])


def test_a_turned_asset_hides_a_turned_area() -> None:
    bar = Asset(name="bar", path=Still(at_m=(0, 0, 2.5)), size_m=(0.2, 2.0), heading_deg=45)
    w = world(
        beacon("ahead", Still(at_m=(1.2, 1.2, 0))), beacon("across", Still(at_m=(-1.2, 1.2, 0))), assets=(bar,)
    )  # ahead of a heading of 45 degrees lies the north-east
    assert w.seen_all(np.array([0.0])).visible[:, 0].tolist() == [False, True]


def test_hiding_agrees_with_a_ray_walked_in_small_steps() -> None:
    rng = np.random.default_rng(4)
    assets = tuple(
        Asset(
            name=f"a{i}",
            path=Still(at_m=(rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(0.5, 4))),
            size_m=(1.3, 0.7),
            heading_deg=rng.uniform(0, 360),
        )
        for i in range(4)
    )
    lights = [(float(x), float(y), 0.2) for x, y in rng.uniform(-2.5, 2.5, (60, 2))]
    w = world(*(beacon(f"b{i}", Still(at_m=at)) for i, at in enumerate(lights)), assets=assets)
    visible = w.seen_all(np.array([0.0])).visible[:, 0]
    for at, seen in zip(lights, visible, strict=True):
        assert seen == (not any(_crosses(at, asset) for asset in assets))
    assert 5 < visible.sum() < 55


def _crosses(light: tuple[float, float, float], asset: Asset) -> bool:
    way = np.array([0, 0, 5.0]) + np.linspace(0, 1, 400_001)[:, None] * (np.array(light) - [0, 0, 5.0])
    at = asset.path
    assert isinstance(at, Still)
    q = way[np.argmin(np.abs(way[:, 2] - at.at_m[2]))][:2] - at.at_m[:2]
    g = np.radians(asset.heading_deg)
    # Turn the world back by the heading.
    own = np.array([[np.cos(g), -np.sin(g)], [np.sin(g), np.cos(g)]]) @ q
    return bool(np.abs(own[0]) <= asset.size_m[0] / 2 and np.abs(own[1]) <= asset.size_m[1] / 2)


def test_assets_are_drawn_from_the_lowest_up_with_the_corners_of_their_tops() -> None:
    high = Asset(name="high", path=Still(at_m=(1, 0, 3)), size_m=(2, 1), heading_deg=90, reflectance=0.7)
    low = Asset(name="low", path=Still(at_m=(0, 0, 1)), size_m=(2, 1), reflectance=0.1)
    w = world(assets=(high, low), mains=(Mains(centre_m=(1, 2), size_m=(4, 2), irradiance_w_m2=1.0),))
    corners, reflectance = w.assets(0.0)
    np.testing.assert_allclose(reflectance, [0.1, 0.7])
    np.testing.assert_allclose(corners[0], [[-1, -0.5, 1], [1, -0.5, 1], [1, 0.5, 1], [-1, 0.5, 1]])
    np.testing.assert_allclose(corners[1].min(axis=0), [0.5, -1, 3], atol=1e-12)
    np.testing.assert_allclose(corners[1].max(axis=0), [1.5, 1, 3], atol=1e-12)
    ground, lamps = w.mains()
    np.testing.assert_allclose(ground[0], [[-1, 1, 0], [3, 1, 0], [3, 3, 0], [-1, 3, 0]])
    assert lamps[0].irradiance_w_m2 == 1.0


def test_the_camera_moves_turns_and_shakes() -> None:
    camera = CameraSpec(
        path=Sine(at_m=(0, 0, 5), amplitude_m=(1, 0, 0), period_s=(4, 1, 1)),
        attitude=Attitude(yaw_rate_deg_s=90.0),
    )
    position, rotation = world(camera=camera).camera(np.array([0.0, 1e6]))
    np.testing.assert_allclose(position, [[0, 0, 5], [1, 0, 5]], atol=1e-12)
    np.testing.assert_allclose(rotation[1][0], [0, -1, 0], atol=1e-12)  # right is south, at yaw 90
    assert world().still_camera
    assert not world(camera=camera).still_camera
    assert not world(camera=CameraSpec(shake=Shake(rms_deg=0.1))).still_camera


CROWD = Crowd(count=100, protocol="code", bit_rate=1000, area_m=(-3.7, -2.7, 3.7, 2.7), speed_m_s=0.5)


def test_a_crowd_keeps_apart_keeps_its_speed_and_has_ids_of_its_own() -> None:
    w = world(crowds=(CROWD,), seed=3)
    assert len({spec.payload for spec in w.beacons}) == 100
    assert w.beacons[7].name == "b007"
    t_us = np.arange(0, 10e6, 50e3)
    seen, soon = w.seen_all(t_us), w.seen_all(t_us + 1000)
    speed = np.hypot(soon.x_m - seen.x_m, soon.y_m - seen.y_m) * 1000
    assert speed.max() == pytest.approx(0.5, rel=0.01)
    assert (speed.max(axis=1) > 0.45).all()
    places = np.stack([seen.x_m, seen.y_m], axis=-1)
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + 99.0 * np.eye(100)[:, :, None]
    assert apart.min() > 0.1
    assert seen.in_view.all()


def test_a_crowd_is_the_same_for_one_seed_and_another_for_another() -> None:
    a, b, c = (world(crowds=(CROWD,), seed=seed).beacons for seed in (3, 3, 4))
    assert a == b
    assert a != c
    assert [spec.payload for spec in a] == [spec.payload for spec in c]


def test_a_crowd_larger_than_its_modulation_has_ids_is_refused() -> None:
    crowd = msgspec.structs.replace(CROWD, protocol="seed11", count=45)
    with pytest.raises(ConfigError, match=r"^scenario: crowd\[0\]: count must be at most 44, .* not 45$"):
        world(crowds=(crowd,))
    assert len(world(crowds=(msgspec.structs.replace(crowd, count=44),)).beacons) == 44


def test_an_unshipped_time_between_two_chunks_is_a_programmers_error() -> None:
    with pytest.raises(ValueError, match="multiple of 20000"):
        world(beacon()).chunk_geometry(10_000)


@pytest.mark.parametrize("name", built_in())
def test_every_built_in_scenario_shows_its_beacons_with_a_contrast_that_a_pixel_notices(name: str) -> None:
    scenario = load_scenario(name)
    sensor = load_preset(scenario.camera.sensor, scenario.camera.mode, scenario.camera.override)
    w = World(scenario, sensor.width, sensor.height, sensor.pitch_um, 0)
    assert scenario.about
    background = w.optics.background_w_m2(scenario.ground.reflectance, scenario.irradiance_w_m2)
    best = np.zeros(len(w.lights))
    for k in range(0, int(scenario.duration_s * 1e6), 1_000_000):
        g = w.chunk_geometry(k // CHUNK_US * CHUNK_US)
        for i in range(len(w.lights)):
            best[i] = max(best[i], contrast(g.flux_w_m2[i, 0], g.sigma_px[i, 0], background, sensor.pixel.dark_w_m2))
    assert (best > 0.25).all(), dict(zip([light.name for light in w.lights], best.tolist(), strict=True))
