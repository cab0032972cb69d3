"""The reference backends: chosen by name, and the same tracks to the byte."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from importlib import import_module

import msgspec
import numpy as np
import pytest

from heliograph.core import Context
from heliograph.errors import ConfigError
from heliograph.streams import Onsets
from heliograph_services.tracker import kalman
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core, warm
from support.onset_scenes import Disc, Scene, circle, line
from support.tracker_runs import bodies, cut, feed, new_core

PACKAGES = {"clustering": ("scikit-learn", "sklearn", "dbscan"), "kalman": ("filterpy", "filterpy", "kalman")}
REFERENCE = {setting: row[0] for setting, row in PACKAGES.items()}
# Five discs of which two meet and one leaves; noise; some windows without any event.
BUSY = Scene(
    (
        Disc(circle(160, 120, 60, 200)),
        Disc(line(30, 60, 150, 20), radius_px=2.0, bit_rate=500.0),
        Disc(line(200, 90, -100, 10), bit_rate=200.0),
        Disc(line(280, 200, 90, 0)),
        Disc(line(60, 200), bit_rate=50.0, dark_s=((0.4, 0.7),)),
    ),
    noise_hz=3e4,
    seed=7,
)


@pytest.fixture
def installed() -> None:
    for _, package, _ in PACKAGES.values():
        pytest.importorskip(package, reason=f"the reference backends need {package}")


def followed(onsets: Iterable[Onsets], clustering: str = "grid", kalman: str = "batched") -> list[bytes]:
    return bodies(feed(new_core(lockstep=True, clustering=clustering, kalman=kalman), onsets))


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("settings", [REFERENCE, {"clustering": "scikit-learn"}, {"kalman": "filterpy"}], ids="+".join)
def test_a_busy_scene_gives_the_same_tracks_to_the_byte(settings: dict[str, str]) -> None:
    onsets = list(BUSY.onsets(1.0))
    ours = followed(onsets)
    assert max(len(m) for m in ours) > 300
    assert followed(onsets, **settings) == ours


@pytest.mark.usefixtures("installed")
def test_with_the_reference_too_nothing_depends_on_how_the_stream_is_cut() -> None:
    onsets = list(BUSY.onsets(0.5))
    assert followed(cut(onsets, [7, 1, 30]), **REFERENCE) == followed(onsets, **REFERENCE)


@pytest.mark.usefixtures("installed")
def test_filters_of_the_reference_equal_the_batched_ones_row_by_row() -> None:
    reference = import_module("heliograph_services.tracker.reference.kalman")
    rng = np.random.default_rng(4)
    n = 6
    state, cov = rng.normal(0, 100, (n, 4)), np.tile([1.0, 0.0, 1e4, 1.0, 0.0, 1e4], (n, 1))
    theirs, their_cov = state.copy(), cov.copy()
    for _ in range(100):
        rows = np.flatnonzero(rng.random(n) < 0.6)
        z, r = rng.normal(0, 50, (len(rows), 2)), rng.uniform(0.1, 4, (len(rows), 2))
        for module, x, p in ((kalman, state, cov), (reference, theirs, their_cov)):
            module.predict(x, p, 0.005, 9_000.0)
            module.update(x, p, rows, z, r, 400.0)
    np.testing.assert_allclose(theirs, state, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(their_cov, cov, rtol=1e-9, atol=1e-9)
    assert np.hypot(*state[:, 2:].T).max() <= 400.0 * (1 + 1e-12)


@pytest.mark.parametrize("setting", PACKAGES)
def test_a_backend_whose_package_is_missing_is_refused_in_one_line_that_says_what_to_install(
    setting: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, package, module = PACKAGES[setting]
    for loaded in [each for each in sys.modules if each.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.delitem(sys.modules, f"heliograph_services.tracker.reference.{module}", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=r"pip install 'heliograph\[reference\]'") as refused:
        make_core(msgspec.convert({setting: name}, TrackerConfig), Context("0", "b00t", False))
    assert f"{setting} = '{name}'" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.usefixtures("installed")
def test_the_reference_can_be_warmed() -> None:
    warm("scikit-learn", "filterpy")


def test_the_fast_backends_are_the_default() -> None:
    assert (TrackerConfig().clustering, TrackerConfig().kalman) == ("grid", "batched")
