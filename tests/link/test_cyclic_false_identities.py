"""What is no beacon is not taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link.modulations import modulation
from support.lights import Light, Seen, read, seen

LINKS = [("seed11", {}), ("code", {"codebook": "code18d4"}), ("code", {"codebook": "code20d4"})]


@pytest.mark.parametrize(("name", "options"), LINKS)
@pytest.mark.parametrize("rate_hz", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("bit_rate", [1000.0, 5000.0])
def test_noise_is_nobody(name: str, options: dict[str, str], rate_hz: float, bit_rate: float) -> None:
    rng = np.random.default_rng(11)
    n = int(rate_hz * 3)
    what = Seen(np.sort(rng.integers(0, 3_000_000, n)), rng.random(n) < 0.5, 3_000_000, 1e6 / bit_rate)
    receiver = modulation(name, **options).receiver(bit_rate)
    frames = read(receiver, what)
    assert receiver.identity() is None
    assert receiver.verdict(3_000_000) == "invalid"
    assert len(frames) <= 1


@pytest.mark.parametrize(("name", "options"), LINKS)
@pytest.mark.parametrize("bit_rate", [1000.0, 5000.0])
def test_random_bits_at_the_right_rate_are_nobody(name: str, options: dict[str, str], bit_rate: float) -> None:
    bits = np.random.default_rng(12).integers(0, 2, int(5 * bit_rate)).tolist()
    receiver = modulation(name, **options).receiver(bit_rate)
    frames = read(receiver, seen(Light(), bits, bit_rate, 12))
    assert receiver.identity() is None
    assert receiver.verdict(5_000_000) == "invalid"
    # By chance 48 of 2048 words pass, at a position that holds; few of them do.
    assert len(frames) < 0.01 * len(bits) / 11


@pytest.mark.parametrize(("name", "options"), LINKS)
@pytest.mark.parametrize("lamp_hz", [100, 120, 240])
def test_a_lamp_is_nobody_even_where_it_looks_like_a_payload(name: str, options: dict[str, str], lamp_hz: int) -> None:
    n = 11 if name == "seed11" else int(options["codebook"][4:6])
    for ones in (3, 5, 7, 9):
        period = [1] * ones + [0] * (n - ones)
        for bit_rate in (float(n * lamp_hz), 2.0 * lamp_hz, 1000.0):
            receiver = modulation(name, **options).receiver(bit_rate)
            frames = read(receiver, seen(Light(), period * lamp_hz, float(n * lamp_hz), ones))
            assert frames == []
            assert receiver.identity() is None
