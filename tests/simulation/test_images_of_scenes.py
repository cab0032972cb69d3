"""A scene as images: light summed plainly, exposures across chunks, and the paper's camera that compares images."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt
import pytest

from heliograph_services.event_source.simulation.contract import BACKGROUND, CHUNK_US, NODE_US, NODES, LightChunk
from heliograph_services.event_source.simulation.ground.images import (
    Exposure,
    ImageCamera,
    Picture,
    Pictures,
    pictures,
    view_image,
)
from heliograph_services.event_source.simulation.ground.views import GroundBackground
from heliograph_services.event_source.simulation.readout.numbers import ImageNumbers, Sensor
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.world.spec import CameraSpec, Ground, Scenario, Shuttle, Still
from heliograph_services.event_source.simulation.world.world import World

Floats = npt.NDArray[np.float64]
WIDTH, HEIGHT, DARK = 48, 32, 1e-6
STILL = Scenario(camera=CameraSpec(path=Still(at_m=(0.0, 0.0, 5.0))))


def world(scenario: Scenario = STILL) -> World:
    return World(scenario, WIDTH, HEIGHT, 9.0, 1)


def square(t_us: float, period_us: float = 7_300.0, phase_us: float = 1_100.0) -> float:
    return float(((t_us + phase_us) // (period_us / 2)) % 2)


def edges(t0_us: int, period_us: float = 7_300.0, phase_us: float = 1_100.0) -> tuple[list[float], list[float]]:
    half = period_us / 2
    k = math.ceil((t0_us + phase_us) / half)
    times = []
    while k * half - phase_us < t0_us + CHUNK_US:
        times.append(k * half - phase_us)
        k += 1
    return times, [square(t + 0.5) for t in times]


def place(light: int, t_us: Floats) -> tuple[Floats, Floats]:
    """Return where light 0 (moving, 400 px/s) or light 1 (still) is."""
    if light == 0:
        return 8.0 + 4e-4 * t_us, 10.0 + 1e-4 * t_us
    return np.full_like(t_us, 30.4), np.full_like(t_us, 20.7)


FLUX, SIGMA = (0.9, 0.2), (1.1, 0.8)


def chunk(t0_us: int) -> LightChunk:
    """Return two lights: 0 moves and blinks, 1 stands and is lit at a half."""
    nodes = t0_us + np.arange(NODES + 1, dtype=np.float64) * NODE_US
    x, y = (np.stack(axis) for axis in zip(place(0, nodes), place(1, nodes), strict=True))
    times, levels = edges(t0_us)
    return LightChunk(
        t0_us, x, y,
        np.repeat(np.array(SIGMA)[:, None], NODES + 1, axis=1), np.repeat(np.array(FLUX)[:, None], NODES + 1, axis=1),
        np.array([square(t0_us - 0.5), 0.5]), np.array([0, len(times), len(times)]),
        np.array(times), np.array(levels),
    )  # fmt: skip


def chunks() -> Iterator[LightChunk]:
    t0_us = 0
    while True:
        yield chunk(t0_us)
        t0_us += CHUNK_US


def weights(n: int, centre: float, sigma: float) -> Floats:
    edge = np.array([math.erf((i - 0.5 - centre) / (sigma * math.sqrt(2))) for i in range(n + 1)])
    return np.diff(edge) / 2.0


def plain(a_us: float, b_us: float, samples: int = 4000) -> Floats:
    """Return the mean light over an exposure, sample by sample."""
    total = np.zeros((HEIGHT, WIDTH))
    times = a_us + (np.arange(samples) + 0.5) / samples * (b_us - a_us) if b_us > a_us else np.array([a_us])
    for light in (0, 1):
        x, y = place(light, times)
        level = np.array([square(t) if light == 0 else 0.5 for t in times])
        for k in np.flatnonzero(level):
            total += np.outer(weights(HEIGHT, y[k], SIGMA[light]), weights(WIDTH, x[k], SIGMA[light])) * (
                FLUX[light] * level[k] / len(times)
            )
    return total


def taken(exposure: Exposure, until_us: int = 60_000, scenario: Scenario = STILL) -> list[Picture]:
    taker = Pictures(GroundBackground(world(scenario), DARK), DARK, exposure)
    return [picture for t0_us in range(0, until_us, CHUNK_US) for picture in taker.feed(chunk(t0_us))]


@pytest.mark.parametrize("exposure_us", [0.0, 3_000.0, 12_345.0])
def test_an_image_is_the_surroundings_and_the_mean_light_of_its_exposure(exposure_us: float) -> None:
    found = taken(Exposure(83.0, exposure_us, grey_per_w_m2=600.0))
    assert [p.t_us for p in found] == pytest.approx([k * 1e6 / 83.0 for k in range(5)])
    surroundings = world().optics.background_w_m2(0.25, STILL.irradiance_w_m2)
    for picture in found[1:]:
        light = surroundings + plain(picture.t_us - exposure_us, picture.t_us)
        grey = np.minimum(np.floor(600.0 * light + 0.5), 255)
        # Within a millisecond the image of a light stays where it is in the middle: at 400 px/s, 0.2 px about it.
        assert np.abs(picture.grey.astype(int) - grey).max() <= 4
        assert np.abs(picture.grey.astype(int) - grey).mean() < 0.1


def test_an_exposure_begins_no_earlier_than_the_scene() -> None:
    first = taken(Exposure(83.0, 12_345.0, grey_per_w_m2=600.0))[0]
    light = world().optics.background_w_m2(0.25, STILL.irradiance_w_m2) + plain(0.0, 0.0)
    assert np.abs(first.grey.astype(int) - np.floor(600.0 * light + 0.5)).max() <= 1


def test_what_is_brighter_than_white_is_white() -> None:
    assert taken(Exposure(50.0, grey_per_w_m2=1e6))[0].grey.min() == 255


def test_without_a_gain_the_surroundings_have_their_stated_grey_whatever_the_sun() -> None:
    for irradiance in (0.1, 2.0, 500.0):
        scenario = Scenario(camera=STILL.camera, irradiance_w_m2=irradiance, ground=Ground(texture="asphalt"))
        taker = Pictures(GroundBackground(world(scenario), DARK), DARK, Exposure(50.0, background_grey=90.0))
        dark = next(iter(taker.feed(_without_lights(0))))
        assert float(dark.grey.mean()) == pytest.approx(90.0, abs=0.1)


def _without_lights(t0_us: int) -> LightChunk:
    none = np.zeros((0, NODES + 1))
    empty = np.zeros(0)
    return LightChunk(t0_us, none, none, none, none, empty, np.zeros(1, np.int64), empty, empty)


def test_pictures_for_a_file_end_with_the_duration() -> None:
    background = GroundBackground(world(), DARK)
    found = list(pictures(background, DARK, Exposure(200.0), chunks(), 50_000.0))
    assert [t for t, _ in found] == list(range(0, 50_000, 5_000))
    assert all(grey.dtype == np.uint8 and grey.shape == (HEIGHT, WIDTH) for _, grey in found)


def test_a_picture_goes_out_as_the_record_of_the_bus() -> None:
    picture = taken(Exposure(50.0))[1]
    image = view_image(picture, "cam0", "5eed")
    assert (image.camera, image.stream, image.t_us, image.width, image.height) == (
        "cam0",
        "5eed",
        20_000,
        WIDTH,
        HEIGHT,
    )


def sensor(
    image_hz: float = 90.0,
    jitter_us: float = 0.0,
    reference: Literal["changed", "last"] = "changed",
    delay_us: float = 0.0,
) -> Sensor:
    nrp = load_preset("nrp")
    assert isinstance(nrp.readout, ImageNumbers)
    numbers = ImageNumbers(
        image_hz=image_hz, threshold_grey=10.0, exposure_us=0.0, grey_per_w_m2=600.0, background_grey=100.0,
        reference=reference, delay_us=delay_us, jitter_us=jitter_us,
    )  # fmt: skip
    return Sensor(
        name="nrp", width=WIDTH, height=HEIGHT, pitch_um=9.0, kind="images", pixel=nrp.pixel, readout=numbers
    )  # fmt: skip


def compared(images: list[npt.NDArray[np.uint8]], reference: str) -> list[list[tuple[int, int, bool]]]:
    """Return the events of each image but the first as the plugin makes them: its processDelta, in plain integers."""
    kept = images[0].astype(int)
    found = []
    for image in images[1:]:
        grey = image.astype(int)
        on, off = grey - kept > 10, kept - grey > 10
        found.append([(int(x), int(y), bool(on[y, x])) for y, x in np.argwhere(on | off)])
        kept = np.where(on | off, grey, kept) if reference == "changed" else grey
    return found


@pytest.mark.parametrize("reference", ["changed", "last"])
def test_the_camera_makes_the_events_of_the_plugin_and_says_whose_they_are(
    reference: Literal["changed", "last"],
) -> None:
    camera = ImageCamera(sensor(reference=reference), GroundBackground(world(), DARK), world(), 1)
    parts = [part for t0_us in range(0, 200_000, CHUNK_US) for part in camera.pieces(chunk(t0_us))]
    greys = [p.grey for p in taken(Exposure(90.0, grey_per_w_m2=600.0), 200_000)]
    wanted = compared(greys, reference)
    found = {part.until_us: part for part in parts if len(part.batch)}
    for k, events in enumerate(wanted, start=1):
        stamp = round(k * 1e6 / 90.0)
        part = found.get(stamp)
        batch = part.batch if part else None
        assert ([] if batch is None else list(zip(batch.x_px, batch.y_px, batch.on, strict=True))) == events
        assert batch is None or (batch.t_us == stamp).all()
    causes = np.concatenate([part.labels for part in parts])
    assert camera.counters["images"] == len(greys)
    assert set(causes.tolist()) == {0}  # light 1 never changes, and the ground is plain
    assert [part.until_us for part in parts] == sorted(part.until_us for part in parts)


def test_ground_that_moves_makes_events_of_no_light() -> None:
    path = Shuttle(from_m=(0.0, 0.0, 5.0), to_m=(100.0, 0.0, 5.0), speed_m_s=5.0, turn_s=0.0)
    scenario = Scenario(camera=CameraSpec(path=path), ground=Ground(texture="site", contrast=3.0))
    camera = ImageCamera(sensor(), GroundBackground(world(scenario), DARK), world(scenario), 1)
    parts = [part for t0_us in range(0, 100_000, CHUNK_US) for part in camera.pieces(_without_lights(t0_us))]
    causes = np.concatenate([part.labels for part in parts])
    assert len(causes) > 1000
    assert set(causes.tolist()) == {BACKGROUND}


def test_time_stamps_are_those_of_publication_and_never_fall() -> None:
    camera = ImageCamera(sensor(500.0, 3_000.0, delay_us=1_000.0), GroundBackground(world(), DARK), world(), 1)
    last_us, stamps = 0, []
    for t0_us in range(0, 400_000, CHUNK_US):
        for part in camera.pieces(chunk(t0_us)):
            assert part.until_us >= last_us
            if len(part.batch):
                assert part.batch.t_us[0] == part.batch.t_us[-1]
                assert part.batch.t_us[0] >= last_us
                stamps.append(int(part.batch.t_us[0]))
            last_us = part.until_us
    assert len(set(stamps)) > 20


def test_one_seed_gives_one_stream() -> None:
    def stream(seed: int) -> bytes:
        camera = ImageCamera(sensor(jitter_us=300.0), GroundBackground(world(), DARK), world(), seed)
        parts = [part for t0_us in range(0, 100_000, CHUNK_US) for part in camera.pieces(chunk(t0_us))]
        return b"".join(part.batch.t_us.tobytes() + part.batch.x_px.tobytes() for part in parts)

    assert stream(1) == stream(1)
    assert stream(1) != stream(2)


def test_a_sensor_with_event_pixels_is_none_of_these() -> None:
    with pytest.raises(ValueError, match="must be of the kind images, not aer"):
        ImageCamera(load_preset("ideal"), GroundBackground(world(), DARK), world(), 1)
