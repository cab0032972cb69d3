"""Random numbers are functions of their counters, and good ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats

from heliograph_services.event_source.simulation import random

N = 200_000
COUNTERS = np.arange(N)
INT64 = st.integers(-(2**63), 2**63 - 1)


def test_the_hash_is_a_chain_of_splitmix64() -> None:
    def mix(h: int) -> int:
        h = (h ^ (h >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        h = (h ^ (h >> 27)) * 0x94D049BB133111EB % 2**64
        return h ^ (h >> 31)

    # The first output of SplitMix64 seeded with 0, as published with java.util.SplittableRandom.
    assert mix(0x9E3779B97F4A7C15) == 0xE220A8397B1DCDAF
    h = 0
    for word in (2**64 - 5 + random.SHOT * 0x9E3779B97F4A7C15, 7, -1, 12):
        h = mix((h + word * (1 if h == 0 else 0x9E3779B97F4A7C15)) % 2**64)
    expected = ((h >> 12) + 0.5) * 2.0**-52
    assert random.uniforms(-5, random.SHOT, 7, -1, 12) == expected
    assert random.uniforms(2**64 - 5, random.SHOT, 7, -1, 12) == expected


@given(seed=INT64, a=INT64, b=INT64, c=INT64)
def test_any_counter_gives_a_number_strictly_between_0_and_1(seed: int, a: int, b: int, c: int) -> None:
    assert 0.0 < float(random.uniforms(seed, random.PATH, a, b, c)) < 1.0


def test_a_number_does_not_depend_on_what_is_asked_beside_it() -> None:
    whole = random.normals(3, random.JITTER, COUNTERS[:1000], 4, 5)
    assert np.array_equal(whole[100:200], random.normals(3, random.JITTER, COUNTERS[100:200], 4, 5))
    assert whole[7] == random.normals(3, random.JITTER, 7, 4, 5)


@pytest.mark.parametrize("place", range(4))
def test_uniforms_are_even_and_neighbouring_counters_are_uncorrelated(place: int) -> None:
    counters = [1, 2, 3]
    if place < 3:
        u = random.uniforms(9, random.SHOT, *[COUNTERS if k == place else counters[k] for k in range(3)])
    else:
        u = np.array([random.uniforms(seed, random.SHOT, COUNTERS[:20]) for seed in range(1000)]).T.ravel()
    assert stats.kstest(u, "uniform").pvalue > 0.001
    for lag in (1, 2, 3, 640):
        assert abs(np.corrcoef(u[lag:], u[:-lag])[0, 1]) < 5 / np.sqrt(len(u))


def test_purposes_and_exchanged_counters_share_nothing() -> None:
    one = random.uniforms(9, random.SHOT, COUNTERS, 1)
    for other in (
        random.uniforms(9, random.JITTER, COUNTERS, 1),
        random.uniforms(10, random.SHOT, COUNTERS, 1),
        random.uniforms(9, random.SHOT, 1, COUNTERS),
        random.uniforms(9, random.SHOT, COUNTERS, 2),
    ):
        assert abs(np.corrcoef(one, other)[0, 1]) < 5 / np.sqrt(N)
        assert not np.intersect1d(one, other).size > 2


def test_every_bit_of_a_counter_flips_half_of_the_bits_of_the_number() -> None:
    base = random.uniforms(1, random.PATH, COUNTERS[:2000])
    for bit in range(0, 62, 7):
        flipped = random.uniforms(1, random.PATH, COUNTERS[:2000] ^ (1 << bit))
        words = (base * 2**52).astype(np.int64) ^ (flipped * 2**52).astype(np.int64)
        share = np.bitwise_count(words).mean() / 52
        assert share == pytest.approx(0.5, abs=0.01)


def test_normals_are_the_inverse_of_the_normal_distribution() -> None:
    u = random.uniforms(5, random.JITTER, COUNTERS)
    z = random.normals(5, random.JITTER, COUNTERS)
    assert np.allclose(z, special.ndtri(u), rtol=1e-12, atol=1e-13)
    assert stats.kstest(z, "norm").pvalue > 0.001


def test_exponentials_have_their_distribution() -> None:
    assert stats.kstest(random.exponentials(5, random.DRIVE, COUNTERS), "expon").pvalue > 0.001


@pytest.mark.parametrize("mean", [0.02, 0.7, 3.0, 47.5, 3000.0])
def test_poisson_counts_have_their_distribution(mean: float) -> None:
    counts = random.poisson_counts(5, random.SHOT, COUNTERS, mean=mean)
    low, high = stats.poisson.ppf([1e-4, 1 - 1e-4], mean)
    edges = np.unique(np.round(np.linspace(low, high, 20)))
    expected = np.diff(np.concatenate([[0.0], stats.poisson.cdf(edges, mean), [1.0]])) * N
    seen = np.bincount(np.searchsorted(edges, counts), minlength=len(edges) + 1)
    enough = expected > 5
    chi2 = float(((seen - expected)[enough] ** 2 / expected[enough]).sum())
    assert stats.chi2.sf(chi2, max(1, enough.sum() - 1)) > 0.001


def test_poisson_counts_of_no_mean_are_none_and_of_a_huge_one_stay_near_it() -> None:
    assert random.poisson_counts(5, random.SHOT, COUNTERS[:9], mean=np.array([0.0, -1.0, np.nan] * 3)).sum() == 0
    counts = random.poisson_counts(5, random.SHOT, COUNTERS[:1000], mean=1e9)
    assert abs(counts - 1e9).max() < 6 * np.sqrt(1e9)
