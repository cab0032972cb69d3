"""Images go the way of events: seed11 at half as many bits a second as images, from the file to the identity."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.link.modulations.seed11 import Seed11
from heliograph_services.cli.decode import run

IMAGES_HZ = 200
FRAMES = 36
WIDTH, HEIGHT = 64, 48
X_PX, Y_PX, RADIUS_PX = 30.3, 20.6, 3.5


def images_of(path: Path, bit_rate: float, phase_us: float, seed: int, led: float = 1_500.0) -> Path:
    """Write what a camera of whole exposures sees of one LED, 60 ppm fast, on ground of 40 counts with 1 of noise."""
    word = Seed11().encode(42)
    n = round(FRAMES * len(word) / bit_rate * IMAGES_HZ)
    bit_us = 1e6 / (bit_rate * (1 + 60e-6))
    fine = (np.arange(n * 50) + 0.5) * 1e6 / IMAGES_HZ / 50 + phase_us
    level = np.array(word)[(fine // bit_us).astype(int) % len(word)].reshape(n, 50).mean(axis=1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    disc = np.hypot(x - X_PX, y - Y_PX) <= RADIUS_PX
    ground = 40.0 + np.random.default_rng(seed).normal(0.0, 1.0, (n, HEIGHT, WIDTH))
    images = np.clip(ground + led * level[:, None, None] * disc, 0, 255).astype(np.uint8)
    np.savez(path, images=images, t_us=np.arange(1, n + 1) * 1_000_000 // IMAGES_HZ)
    return path


# At just two images a bit an LED that turns in mid-exposure shows two steps half a bit apart, and an overexposed one
# goes out half a bit late. Left out is an overexposed LED at phase 0: within these four seconds its drift takes it from
# going out in time to going out late, and the clock is lost on the way.
@pytest.mark.parametrize(
    ("bit_rate", "led", "phase_us"),
    [
        *((100.0, 1_500.0, 250.0 + 500.0 * i) for i in range(10)),
        *((100.0, 150.0, 500.0 * i) for i in range(10)),
        *((80.0, led, phase_us) for led in (150.0, 1_500.0) for phase_us in (250.0, 1_700.0, 3_900.0)),
        (50.0, 150.0, 1_700.0),
    ],
)
def test_of_36_frames_at_no_more_than_half_the_images_35_are_read_once_and_none_wrongly(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bit_rate: float, led: float, phase_us: float
) -> None:
    file = images_of(tmp_path / "images.npz", bit_rate, phase_us, seed=round(phase_us), led=led)
    assert run([str(file), "--protocol", "seed11", "--bit-rate", f"{bit_rate:g}", "--frames", "--json"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    lines = [json.loads(line) for line in said.out.splitlines()]
    frames = [line for line in lines if line["type"] == "frame"]
    assert Counter(line["payload"] for line in frames) == {42: len(frames)}
    assert FRAMES - 2 <= len(frames) <= FRAMES
    ends_us = np.diff([line["t_us"] for line in frames])
    assert np.all(np.abs(ends_us - 11e6 / bit_rate) < 0.5e6 / bit_rate)  # each once, none left out between
    found = [line for line in lines if line["type"] == "identification"]
    assert {line["beacon"] for line in found} == {"seed11:42"}
    assert all(np.hypot(line["x_px"] - X_PX, line["y_px"] - Y_PX) < 1.0 for line in found)


def test_more_bits_than_half_the_images_are_a_line_that_names_value_and_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = images_of(tmp_path / "images.npz", 100.0, 0.0, seed=0)
    assert run([str(file), "--bit-rate", "250"]) == 0
    told = "heliograph decode: bit_rate should be at most 100 with 200 images a second, not 250\n"
    assert capsys.readouterr().err == told


def test_a_frequency_above_half_the_images_is_an_error(tmp_path: Path) -> None:
    file = images_of(tmp_path / "images.npz", 100.0, 0.0, seed=0)
    with pytest.raises(ConfigError, match=r"frequency must be at most 100 Hz \(half the scan rate .*\), not 150$"):
        run([str(file), "--protocol", "frequency", "--bit-rate", "300"])
