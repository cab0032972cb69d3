"""A first guess of the bit rate: within two per cent, or None."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link.bitrate import estimate_bit_rate
from heliograph.link.modulations import modulation
from support.lights import Light, repeated, seen


@pytest.mark.parametrize(("name", "payload"), [("seed11", 42), ("seed11", 5), ("code", 100), ("code", 13)])
@pytest.mark.parametrize("bit_rate", [100.0, 503.8, 1000.0, 2500.0, 4999.0])
@pytest.mark.parametrize("light", [Light(), Light(lost=0.7), Light(dropped=0.1)], ids=["clean", "lost", "dropped"])
def test_the_rate_of_a_code_is_found(name: str, payload: int, bit_rate: float, light: Light) -> None:
    bits = repeated(modulation(name).encode(payload), 30)
    what = seen(light, bits, bit_rate, 1)
    assert estimate_bit_rate(what.t_us, what.on) == pytest.approx(bit_rate, rel=0.02)


@pytest.mark.parametrize("payload", [0, 1, 7, 31])
def test_a_periodic_word_has_no_rate(payload: int) -> None:
    what = seen(Light(), repeated(modulation("seed11").encode(payload), 60), 1000.0, 1)
    assert estimate_bit_rate(what.t_us, what.on) is None


@pytest.mark.parametrize("lamp_hz", [100, 120, 240])
def test_a_lamp_has_no_rate(lamp_hz: int) -> None:
    what = seen(Light(events=40.0, tail_us=300.0), [1, 0] * lamp_hz, 2.0 * lamp_hz, 1)
    assert estimate_bit_rate(what.t_us, what.on) is None


@pytest.mark.parametrize("rate_hz", [10.0, 1e3, 1e5])
def test_noise_has_no_rate(rate_hz: float) -> None:
    rng = np.random.default_rng(1)
    n = int(rate_hz)
    assert estimate_bit_rate(np.sort(rng.integers(0, 1_000_000, n)), rng.random(n) < 0.5) is None
    assert estimate_bit_rate(np.empty(0, np.int64), np.empty(0, np.bool_)) is None


def test_an_impossible_range_is_refused() -> None:
    with pytest.raises(ValueError, match="0 < f_min < f_max"):
        estimate_bit_rate(np.empty(0, np.int64), np.empty(0, np.bool_), 100.0, 50.0)
