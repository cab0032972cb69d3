"""Views of the surroundings against slow plain ones, exact crossings, and what a view promises to the pixels."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph_services.event_source.simulation.contract import CHUNK_US
from heliograph_services.event_source.simulation.ground import views
from heliograph_services.event_source.simulation.ground.texture import BITS, SIZE, Texture, _pyramid
from heliograph_services.event_source.simulation.ground.views import GroundBackground
from heliograph_services.event_source.simulation.world.spec import (
    Asset,
    Attitude,
    CameraSpec,
    Ground,
    Mains,
    Scenario,
    Shake,
    Shuttle,
    Still,
)
from heliograph_services.event_source.simulation.world.world import World
from reference.ground_plain import render

Floats = npt.NDArray[np.float64]
DARK = 1e-5
PITCH_UM = 9.0
F_PX = 400.0


def surroundings(
    scenario: Scenario, fidelity: Literal["full", "live"] = "full", width: int = 96, height: int = 64
) -> GroundBackground:
    return GroundBackground(World(scenario, width, height, PITCH_UM, 1), DARK, fidelity)


def flying(speed_m_s: float, height_m: float = 28.0, **attitude: Any) -> CameraSpec:
    path = Shuttle(from_m=(0.0, 0.0, height_m), to_m=(800.0, 600.0, height_m), speed_m_s=speed_m_s, turn_s=0.0)
    return CameraSpec(path=path, attitude=Attitude(**attitude))


def hovering(height_m: float = 5.0, **attitude: Any) -> CameraSpec:
    return CameraSpec(path=Still(at_m=(0.0, 0.0, height_m)), attitude=Attitude(**attitude))


def ends(background: GroundBackground, until_us: int) -> list[int]:
    found = [0]
    while found[-1] < until_us:
        found.append(background.next_us(found[-1]))
    return found


def crossings(times_us: list[int], values: list[float], threshold: float) -> list[tuple[float, bool]]:
    """Return the events of one pixel that sees straight lines between views, its reference moved by thresholds."""
    events, reference = [], values[0]
    for t0, t1, v0, v1 in zip(times_us[:-1], times_us[1:], values[:-1], values[1:], strict=True):
        while abs(v1 - reference) >= threshold:
            on = v1 > reference
            reference += threshold if on else -threshold
            events.append((t0 + (t1 - t0) * (reference - v0) / (v1 - v0), on))
    return events


def with_texture(monkeypatch: pytest.MonkeyPatch, of_m: Callable[[Floats, Floats], Floats], tile_m: float) -> None:
    """Let the ground have a reflectance that is a function of x and y in metres, from 0 to tile_m."""
    at = (np.arange(SIZE) + 0.5) * tile_m / SIZE
    x, y = np.meshgrid(at, at)
    texture = Texture(_pyramid(of_m(x, y).astype(np.float32)), tile_m)
    monkeypatch.setattr(
        views, "_packed", lambda ground, seed, gain, dark: (*texture.packed(gain, dark), texture.bits, tile_m)
    )


def test_crossings_of_a_gradient_that_moves_evenly_are_at_the_times_of_the_formula(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """u = ln(irradiance + dark) rises by s per metre and the camera goes v: an event every threshold / (s v)."""
    tile_m, per_m, speed, threshold = 163.84, 0.4, 10.0, 0.11
    gain = views.GroundBackground(World(Scenario(), 8, 8, PITCH_UM, 1), DARK)._gain

    def rho(x: Floats, _: Floats) -> Floats:
        return (np.exp(math.log(0.05 * gain) + per_m * np.minimum(x, 8.0)) - DARK) / gain

    with_texture(monkeypatch, rho, tile_m)
    path = Shuttle(from_m=(2.0, 40.0, 5.0), to_m=(1002.0, 40.0, 5.0), speed_m_s=speed, turn_s=0.0)
    camera = CameraSpec(path=path)
    background = surroundings(Scenario(camera=camera, ground=Ground(texture="site")))
    times = ends(background, 200_000)
    pixel = (30, 50)
    values = [float(background.view(t)[pixel]) for t in times]
    events = crossings(times, values, threshold)
    wanted = [threshold * (k + 1) / (per_m * speed) * 1e6 for k in range(len(events))]
    assert len(events) == int(per_m * speed * 0.2 / threshold)
    assert all(on for _, on in events)
    assert [t for t, _ in events] == pytest.approx(wanted, abs=2.0)


@pytest.mark.parametrize(
    "attitude",
    [
        {},
        {"yaw_deg": 37.0},
        {"pitch_deg": -60.0, "roll_deg": 8.0},
        {"pitch_deg": -20.0, "roll_deg": -15.0},
        {"pitch_deg": 5.0, "roll_deg": 80.0},
    ],
)
def test_a_view_is_what_a_plain_renderer_sees(monkeypatch: pytest.MonkeyPatch, attitude: dict[str, float]) -> None:
    tile_m = 40.96

    def rho(x: Floats, y: Floats) -> Floats:
        turn = 2.0 * np.pi / tile_m
        return np.asarray(0.3 + 0.12 * np.sin(7 * turn * x) + 0.1 * np.cos(9 * turn * y + 1.0))

    with_texture(monkeypatch, rho, tile_m)
    assets = (
        Asset(name="low", path=Still(at_m=(0.4, 0.2, 0.5)), size_m=(1.0, 0.5), heading_deg=20.0, reflectance=0.9),
        Asset(name="high", path=Still(at_m=(0.5, 2.5, 2.0)), size_m=(0.6, 6.0), heading_deg=-50.0, reflectance=0.05),
    )
    scenario = Scenario(camera=hovering(5.0, **attitude), ground=Ground(texture="site", reflectance=0.3), assets=assets)
    world = World(scenario, 96, 64, PITCH_UM, 1)
    view = GroundBackground(world, DARK).view(0)
    gain = world.optics.background_w_m2(1.0, scenario.irradiance_w_m2)
    position, rotation = world.camera(np.zeros(1))
    corners, reflectance = world.assets(0.0)
    plain = render(
        (F_PX, 47.5, 31.5), (96, 64), position[0], rotation[0], rho,
        list(zip(corners, reflectance.tolist(), strict=True)), 1.0, 0.76,
    )  # fmt: skip
    seen = (np.exp(view.astype(np.float64)) - DARK) / gain
    error = np.abs(np.log(seen) - np.log(plain))
    # At edges and near the horizon the blurs differ in shape; a threshold is .2.
    print(
        f"{attitude}: median {np.median(error):.4f}, nine tenths {np.quantile(error, 0.9):.3f}, most {error.max():.3f}"
    )
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.9) < 0.1


def test_a_pixel_moves_over_the_ground_as_a_point_of_the_world_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The brightest spot lies where `Projection` says, to a tenth of a pixel: one geometry for lights and ground."""
    tile_m = 163.84

    def rho(x: Floats, y: Floats) -> Floats:
        return np.asarray(0.05 + 0.9 * np.exp(-((x - 40.0) ** 2 + (y - 60.0) ** 2) / (2.0 * 0.3**2)))

    with_texture(monkeypatch, rho, tile_m)
    camera = CameraSpec(
        path=Still(at_m=(38.5, 59.2, 20.0)), attitude=Attitude(yaw_deg=30.0, pitch_deg=-80.0, roll_deg=10.0)
    )
    world = World(Scenario(camera=camera, ground=Ground(texture="site")), 200, 160, PITCH_UM, 1)
    view = np.exp(GroundBackground(world, DARK).view(0).astype(np.float64))
    weight = view - np.quantile(view, 0.5)
    weight[weight < 0.2 * weight.max()] = 0.0
    y, x = np.mgrid[0:160, 0:200]
    position, rotation = world.camera(np.zeros(1))
    x_px, y_px, _ = world.projection.pixels(position, rotation, np.array([[40.0, 60.0, 0.0]]))
    assert float((weight * x).sum() / weight.sum()) == pytest.approx(float(x_px[0]), abs=0.1)
    assert float((weight * y).sum() / weight.sum()) == pytest.approx(float(y_px[0]), abs=0.1)


def test_half_pixel_steps_lose_few_events_against_sixteenths(monkeypatch: pytest.MonkeyPatch) -> None:
    def counts(step_px: float) -> tuple[int, int, float]:
        monkeypatch.setitem(views._STEP_PX, "full", step_px)
        monkeypatch.setattr(views, "SHORTEST_US", 200)
        background = surroundings(
            Scenario(
                irradiance_w_m2=100.0, camera=flying(10.0, yaw_deg=30.0), ground=Ground(texture="site", contrast=2.5)
            )
        )
        times = ends(background, 200_000)
        stack = np.stack([background.view(t).reshape(-1)[::13] for t in times]).astype(np.float64)
        found = [crossings(times, list(stack[:, k]), 0.2) for k in range(stack.shape[1])]
        first = np.array([events[0][0] if events else np.nan for events in found])
        return sum(map(len, found)), len(times), first  # type: ignore[return-value]

    coarse, n_coarse, first_coarse = counts(0.5)
    fine, n_fine, first_fine = counts(0.0625)
    assert n_fine > 6 * n_coarse
    shift = np.abs(np.asarray(first_coarse) - np.asarray(first_fine))
    shift = shift[~np.isnan(shift)]
    print(
        f"events {coarse} at 1/2 px, {fine} at 1/16 px; first events differ by {np.median(shift):.0f} us (median), "
        f"{np.quantile(shift, 0.9):.0f} us (nine tenths); a step of 1/2 px is {1e6 * 0.5 / 142.9:.0f} us"
    )
    assert coarse == pytest.approx(fine, rel=0.05)
    assert np.median(shift) < 0.25 * 0.5 / 142.9 * 1e6


@pytest.mark.parametrize("fidelity", ["full", "live"])
def test_between_two_views_nothing_moves_further_than_the_step(fidelity: Literal["full", "live"]) -> None:
    step_px = {"full": 0.5, "live": 1.0}[fidelity]
    camera = CameraSpec(
        path=Shuttle(from_m=(0.0, 0.0, 12.0), to_m=(100.0, 30.0, 12.0), speed_m_s=6.0, turn_s=2.0),
        attitude=Attitude(yaw_rate_deg_s=20.0, pitch_deg=-70.0),
        shake=Shake(rms_deg=0.05, low_hz=5.0, high_hz=60.0),
    )
    world = World(Scenario(camera=camera, ground=Ground(texture="asphalt")), 640, 480, PITCH_UM, 1)
    background = GroundBackground(world, DARK, fidelity)
    times = ends(background, 100_000)
    assert all(200 <= b - a <= 5_000 for a, b in pairwise(times))
    assert all(t in times for t in range(0, 100_001, CHUNK_US))
    position, rotation = world.camera(np.array(times, np.float64))
    x, y = np.meshgrid(np.linspace(0, 639, 5), np.linspace(0, 479, 5))
    camera_rays = np.stack([(x - 319.5) / F_PX, (y - 239.5) / F_PX, np.ones_like(x)], axis=-1).reshape(-1, 3)
    for k in range(len(times) - 1):
        ray = camera_rays @ rotation[k]
        point = position[k] + ray * (position[k, 2] / -ray[:, 2:])
        n = len(point)
        x_px, y_px, _ = world.projection.pixels(
            np.tile(position[k + 1], (n, 1)), np.tile(rotation[k + 1], (n, 1, 1)), point
        )
        assert np.hypot(x_px - x.ravel(), y_px - y.ravel()).max() <= step_px * 1.02


def test_at_143_px_a_second_there_are_286_views_and_hardly_more() -> None:
    background = surroundings(Scenario(camera=flying(10.0), ground=Ground(texture="site")), width=16, height=12)
    assert 286 <= len(ends(background, 1_000_000)) - 1 <= 300


@pytest.mark.parametrize("fidelity", ["full", "live"])
def test_where_nothing_moves_the_view_is_the_same_object(fidelity: Literal["full", "live"]) -> None:
    background = surroundings(Scenario(camera=hovering(), ground=Ground(texture="boards")), fidelity)
    times = ends(background, 60_000)
    assert times == list(range(0, 60_001, 5_000))
    first = background.view(0)
    assert all(background.view(t) is first for t in times)
    assert first.shape == (64, 96)
    assert first.dtype == np.float32


def test_a_plain_ground_is_never_rendered_twice_however_the_camera_moves() -> None:
    camera = CameraSpec(path=flying(10.0).path, attitude=Attitude(yaw_rate_deg_s=100.0))
    background = surroundings(Scenario(camera=camera))
    first = background.view(0)
    assert all(background.view(t) is first for t in ends(background, 40_000))
    assert float(np.ptp(first)) == 0.0


def test_an_asset_that_moves_over_plain_ground_sets_the_pace() -> None:
    path = Shuttle(from_m=(-0.3, 0.0, 1.0), to_m=(3.0, 0.0, 1.0), speed_m_s=2.0, turn_s=0.0)
    asset = Asset(name="cart", path=path, size_m=(0.2, 0.2))
    background = surroundings(Scenario(camera=hovering(), assets=(asset,)))
    times = ends(background, 20_000)
    assert len(times) - 1 == 8  # 2 m/s at 4 m: 200 px/s, 4 px in 20 ms
    assert not (background.view(0) == background.view(times[1])).all()


def test_asking_again_or_in_another_order_gives_the_same_views() -> None:
    scenario = Scenario(camera=flying(10.0, yaw_rate_deg_s=30.0), ground=Ground(texture="site"))
    background = surroundings(scenario)
    times = ends(background, 40_000)
    first = [background.view(t).tobytes() for t in times]
    other = surroundings(scenario)
    for t in reversed(range(len(times))):
        assert other.view(times[t]).tobytes() == first[t]
    assert [other.next_us(t) for t in times[:-1]] == times[1:]


def test_mains_light_flickers_as_its_formula_says() -> None:
    lamp = Mains(centre_m=(0.0, 0.0), size_m=(0.5, 0.4), irradiance_w_m2=6.0, depth=0.4, phase_deg=30.0)
    background = surroundings(Scenario(irradiance_w_m2=2.0, camera=hovering(), mains=(lamp,)))
    times = ends(background, 20_000)
    assert times == list(range(0, 20_001, 1_000))
    outside = float(background.view(0)[2, 2])
    ground = math.exp(outside) - DARK
    for t in times:
        view = background.view(t)
        lit = ground * (1.0 + 3.0 * (1.0 + 0.4 * math.sin(2e-4 * math.pi * t + math.radians(30.0))))
        assert float(view[32, 48]) == pytest.approx(math.log(lit + DARK), abs=1e-5)
        assert float(view[2, 2]) == outside


def test_mains_light_and_motion_together_are_what_is_rendered_for_each_time() -> None:
    lamps = (
        Mains(centre_m=(0.3, 0.0), size_m=(0.5, 0.4), irradiance_w_m2=3.0),
        Mains(centre_m=(-0.3, 0.1), size_m=(0.5, 0.4), irradiance_w_m2=6.0),
        Mains(centre_m=(0.0, 0.1), size_m=(0.5, 0.4), irradiance_w_m2=6.0, frequency_hz=120.0, depth=1.0),
    )
    camera = CameraSpec(path=Shuttle(from_m=(-0.2, 0.0, 5.0), to_m=(9.0, 0.0, 5.0), speed_m_s=1.0, turn_s=0.0))
    background = surroundings(Scenario(camera=camera, ground=Ground(texture="site", contrast=1.3), mains=lamps))
    for t in ends(background, 40_000):
        assert np.abs(background.view(t) - background.at(float(t))).max() < 0.05


def test_a_fast_lamp_is_looked_at_ten_times_a_period_but_no_oftener_than_an_interval_may_be() -> None:
    def shortest(frequency_hz: float) -> int:
        lamp = Mains(centre_m=(0.0, 0.0), size_m=(1.0, 1.0), irradiance_w_m2=1.0, frequency_hz=frequency_hz)
        return surroundings(Scenario(camera=hovering(), mains=(lamp,))).next_us(0)

    assert (shortest(100.0), shortest(120.0), shortest(1000.0)) == (1000, 714, 200)  # 5 ms in whole parts


def test_live_views_are_the_full_ones_but_for_detail() -> None:
    scenario = Scenario(camera=hovering(yaw_deg=20.0), ground=Ground(texture="boards"))
    full, live = surroundings(scenario).view(0), surroundings(scenario, "live").view(0)
    assert float(np.corrcoef(full.ravel(), live.ravel())[0, 1]) > 0.85
    assert float(live.mean()) == pytest.approx(float(full.mean()), abs=0.01)


@settings(max_examples=30)
@given(
    st.floats(-180.0, 180.0), st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.floats(0.2, 300.0), st.integers(0, 3)
)
def test_any_pose_is_rendered_and_finite(yaw: float, pitch: float, roll: float, height: float, shape: int) -> None:
    width, rows = ((32, 24), (33, 25), (1, 1), (7, 40))[shape]
    asset = Asset(name="a", path=Still(at_m=(0.0, 1.0, 1.0)), size_m=(3.0, 2.0), heading_deg=33.0)
    lamp = Mains(centre_m=(0.0, 0.0), size_m=(5.0, 5.0), irradiance_w_m2=1.0)
    scenario = Scenario(
        camera=hovering(height, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll),
        ground=Ground(texture="plain", reflectance=0.2), assets=(asset,), mains=(lamp,),
    )  # fmt: skip
    for fidelity in ("full", "live"):
        background = surroundings(scenario, fidelity, width, rows)
        view = background.view(0)
        assert np.isfinite(view).all()
        gain = background._gain
        assert view.min() >= math.log(0.2 * gain + DARK) - 1e-3
        assert view.max() <= math.log(gain * 2.0 + DARK) + 1e-3


def test_far_ground_is_its_mean_and_the_sky_is_white() -> None:
    scenario = Scenario(camera=hovering(5.0, pitch_deg=0.0), ground=Ground(texture="site", contrast=3.0))
    background = surroundings(scenario)
    view = background.view(0).astype(np.float64)
    gain = background._gain
    assert view[:29] == pytest.approx(math.log(gain + DARK), abs=1e-5)
    assert view[34, :] == pytest.approx(math.log(0.25 * gain + DARK), abs=0.05)


def test_a_texture_is_read_to_a_thousandth_of_a_texel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fixed point over ten thousand tiles: what a texel holds is found, not its neighbour's."""
    assert BITS == 11
    tile_m = 20.48
    with_texture(monkeypatch, lambda x, y: 0.2 + 0.1 * np.sin(2 * np.pi * x / tile_m) + 0 * y, tile_m)

    def at(x_m: float) -> Floats:
        camera = CameraSpec(path=Still(at_m=(x_m, 0.0, 4.0)))
        return surroundings(Scenario(camera=camera, ground=Ground(texture="site"))).view(0).astype(np.float64)

    assert np.abs(at(3.0) - at(3.0 + 400 * tile_m)).max() < 1e-4
