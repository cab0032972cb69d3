"""First guesses of the bit rate: the right one is among them, within two per cent; where there is none, none."""

from __future__ import annotations

import numpy as np
import pytest

from heliograph.link.bitrate import likely_bit_rates
from heliograph.link.modulations import modulation
from support.lights import Light, repeated, seen
from support.text_light import TextLight, watch_text


def found(rates: tuple[float, ...], bit_rate: float) -> bool:
    return any(abs(rate / bit_rate - 1.0) < 0.02 for rate in rates)


@pytest.mark.parametrize(("name", "payload"), [("seed11", 42), ("seed11", 5), ("code", 100), ("code", 13)])
@pytest.mark.parametrize("bit_rate", [100.0, 503.8, 1000.0, 2500.0, 4999.0])
@pytest.mark.parametrize("light", [Light(), Light(lost=0.7), Light(dropped=0.1)], ids=["clean", "lost", "dropped"])
def test_the_rate_of_a_code_is_found(name: str, payload: int, bit_rate: float, light: Light) -> None:
    bits = repeated(modulation(name).encode(payload), 30)
    what = seen(light, bits, bit_rate, 1)
    assert found(likely_bit_rates(what.t_us, what.on), bit_rate)


@pytest.mark.parametrize(("name", "payload"), [("code", 3), ("code", 138), ("code", 315)])
def test_a_word_whose_intervals_are_all_odd_is_not_taken_for_one_of_half_the_rate_alone(
    name: str, payload: int
) -> None:
    what = seen(Light(), repeated(modulation(name).encode(payload), 10), 100.0, 1)
    assert found(likely_bit_rates(what.t_us, what.on), 100.0)


def test_a_word_of_nearly_equal_runs_has_its_own_rate() -> None:
    what = seen(Light(), repeated(modulation("seed11").encode(12), 22), 100.0, 1)
    assert found(likely_bit_rates(what.t_us, what.on), 100.0)


@pytest.mark.parametrize("weaker", [True, False], ids=["rises", "falls"])
def test_the_rate_is_found_where_changes_of_one_kind_make_a_fifth_of_the_others_events(weaker: bool) -> None:
    what = seen(Light(events=60.0), repeated(modulation("seed11").encode(42), 60), 1000.0, 1)
    kept = (what.on != weaker) | (np.random.default_rng(1).random(len(what.on)) < 0.2)
    assert found(likely_bit_rates(what.t_us[kept], what.on[kept]), 1000.0)


@pytest.mark.parametrize("payload", [2, 5, 42])
def test_fifty_bits_a_second_are_named_within_a_second(payload: int) -> None:
    what = seen(Light(), repeated(modulation("seed11").encode(payload), 6), 50.0, 1)
    soon = what.t_us < what.t_us[0] + 1_000_000
    assert found(likely_bit_rates(what.t_us[soon], what.on[soon]), 50.0)


@pytest.mark.parametrize("payload", [0, 1, 7, 31])
def test_a_periodic_word_has_no_rate(payload: int) -> None:
    what = seen(Light(), repeated(modulation("seed11").encode(payload), 60), 1000.0, 1)
    assert likely_bit_rates(what.t_us, what.on) == ()


@pytest.mark.parametrize("lamp_hz", [100, 120, 240])
def test_a_lamp_has_no_rate(lamp_hz: int) -> None:
    what = seen(Light(events=40.0, tail_us=300.0), [1, 0] * lamp_hz, 2.0 * lamp_hz, 1)
    assert likely_bit_rates(what.t_us, what.on) == ()


@pytest.mark.parametrize("rate_hz", [10.0, 1e3, 1e5])
def test_noise_has_no_rate(rate_hz: float) -> None:
    rng = np.random.default_rng(1)
    n = int(rate_hz)
    assert likely_bit_rates(np.sort(rng.integers(0, 1_000_000, n)), rng.random(n) < 0.5) == ()
    assert likely_bit_rates(np.empty(0, np.int64), np.empty(0, np.bool_)) == ()


def test_an_impossible_range_is_refused() -> None:
    with pytest.raises(ValueError, match="0 < f_min < f_max"):
        likely_bit_rates(np.empty(0, np.int64), np.empty(0, np.bool_), 100.0, 50.0)


LIGHTS = {
    "plain": TextLight(),
    "three events a change": TextLight(events=3),
    "a tail of one bit": TextLight(events=100, tail_bits=1.0),
    "jitter": TextLight(jitter_bits=0.15),
    "scans of 199 us": TextLight(scan_us=199.0),
    "a slow clock": TextLight(clock=0.02),
}


@pytest.mark.parametrize("bit_rate", [50.0, 504.0, 2000.0, 20_000.0])
@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())
def test_the_rate_of_a_text_is_the_only_one_that_is_likely(light: TextLight, bit_rate: float) -> None:
    if light.scan_us * bit_rate > 2e5:
        pytest.skip("scans longer than a fifth of a bit: more rates are likely, see the next test")
    what = watch_text(light, "Rough winds do shake the darling buds of May", bit_rate, seed=1)
    rates = likely_bit_rates(what.t_us, what.on)
    assert len(rates) == 1
    assert found(rates, bit_rate / (1.0 + light.clock))


@pytest.mark.parametrize(("name", "payload"), [("seed11", 42), ("code", 100), ("code", 13)])
def test_scans_of_two_fifths_of_a_bit_leave_its_rate_among_the_likely_ones(name: str, payload: int) -> None:
    what = seen(Light(), repeated(modulation(name).encode(payload), 50), 2000.0, 1)
    scans = np.ceil(what.t_us / 199.0) * 199.0
    assert found(likely_bit_rates(scans.astype(np.int64), what.on), 2000.0)


def test_noise_of_half_the_lights_own_events_hides_no_rate() -> None:
    what = watch_text(TextLight(noise_hz=2500.0), "Rough winds do shake the darling buds of May", 504.0, seed=5)
    assert found(likely_bit_rates(what.t_us, what.on), 504.0)


def test_events_that_may_not_be_written_are_taken() -> None:
    what = watch_text(TextLight(), "Rough winds do shake", 504.0, seed=1)
    t_us, on = what.t_us.copy(), what.on.copy()
    t_us.flags.writeable = on.flags.writeable = False
    assert likely_bit_rates(t_us, on) == likely_bit_rates(what.t_us, what.on) != ()
