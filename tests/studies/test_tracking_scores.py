"""MOTA, IDF1 and GOSPA are those of motmetrics and stonesoup, and those worked by hand."""

from __future__ import annotations

import datetime as dt
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from heliograph_services.cli.studies.tracking import Clear, Identity, Instant, clear, gospa, identity

Floats = npt.NDArray[np.float64]


def instant(t: int, beacons: dict[str, tuple[float, float]], tracks: dict[str, tuple[float, float]]) -> Instant:
    """Return an instant with gates of 5 px."""
    return Instant(
        t,
        tuple(beacons),
        np.array(list(beacons.values())).reshape(-1, 2),
        np.full(len(beacons), 5.0),
        tuple(tracks),
        np.array(list(tracks.values())).reshape(-1, 2),
    )


def crossing() -> list[Instant]:
    """Two beacons approach, their tracks swap names, and one is lost at last."""
    places = [(0.0, 20.0), (4.0, 16.0), (8.0, 12.0), (12.0, 8.0), (16.0, 4.0)]
    run = [
        instant(t, {"a": (x, 0), "b": (y, 1)}, {"1": (x, 0.5), "2": (y, 0.5)}) for t, (x, y) in enumerate(places[:3])
    ]
    run.append(instant(3, {"a": (12, 0), "b": (4, 1)}, {"2": (12, 0), "1": (4, 1)}))
    run.append(instant(4, {"a": (16, 0), "b": (0, 1)}, {"2": (16, 0), "3": (90, 90)}))
    return run


def random_run(seed: int) -> list[Instant]:
    """Return a run of beacons that walk, come and go; tracks that stray, are named anew and swap; and false ones."""
    rng = np.random.default_rng(seed)
    beacons = [f"b{k}" for k in range(rng.integers(1, 7))]
    at = rng.uniform(0, 40, (len(beacons), 2))
    gates = rng.uniform(3, 8, len(beacons))
    owned = {name: f"t{k}" for k, name in enumerate(beacons)}
    fresh = len(beacons)
    run = []
    for t in range(40):
        at = at + rng.normal(0, 1.5, at.shape)
        here = np.flatnonzero(rng.random(len(beacons)) < 0.85)
        tracks: dict[str, Floats] = {}
        for k, name in enumerate(beacons):
            if rng.random() < 0.05:
                owned[name], fresh = f"t{fresh}", fresh + 1
            if rng.random() < 0.05:
                other = beacons[rng.integers(len(beacons))]
                owned[name], owned[other] = owned[other], owned[name]
            if rng.random() < 0.85:
                tracks[owned[name]] = at[k] + rng.normal(0, 2, 2)
        for k in range(rng.poisson(0.5)):
            tracks[f"f{k}"] = rng.uniform(0, 40, 2)
        names = [str(name) for name in rng.permutation(list(tracks))]
        run.append(
            Instant(
                t,
                tuple(beacons[k] for k in here),
                at[here],
                gates[here],
                tuple(names),
                np.array([tracks[name] for name in names]).reshape(-1, 2),
            )
        )
    return run


RUNS = [crossing(), *(random_run(seed) for seed in range(30))]


def by_motmetrics(run: list[Instant]) -> tuple[Any, Any]:
    """Return its figures, and its matches as rows of frame, beacon, track."""
    motmetrics = pytest.importorskip("motmetrics", reason="the oracle of MOTA and IDF1 is motmetrics")
    beacons = sorted({name for each in run for name in each.beacon})
    tracks = sorted({name for each in run for name in each.track})
    accumulator = motmetrics.MOTAccumulator()
    for each in run:
        away = each.away_px()
        accumulator.update(
            [beacons.index(name) for name in each.beacon],
            [tracks.index(name) for name in each.track],
            np.where(away <= each.gate_px[:, None], away, np.nan),
            frameid=each.t_us,
        )
    wanted = [
        "mota",
        "idf1",
        "num_switches",
        "num_misses",
        "num_false_positives",
        "num_objects",
        "idtp",
        "idfp",
        "idfn",
    ]
    figures = motmetrics.metrics.create().compute(accumulator, metrics=wanted).iloc[0]
    events = accumulator.mot_events.reset_index()
    matched = events[events.Type.isin(["MATCH", "SWITCH"])]
    rows = zip(matched.FrameId, matched.OId, matched.HId, matched.D, strict=True)
    return figures, sorted((int(t), beacons[int(o)], tracks[int(h)], float(d)) for t, o, h, d in rows)


@pytest.mark.parametrize("k", range(len(RUNS)))
def test_mota_switches_and_every_match_are_those_of_motmetrics(k: int) -> None:
    figures, matched = by_motmetrics(RUNS[k])
    counts, matches = clear(RUNS[k])
    assert (counts.objects, counts.misses) == (figures.num_objects, figures.num_misses)
    assert (counts.false, counts.switches) == (figures.num_false_positives, figures.num_switches)
    assert counts.mota == pytest.approx(figures.mota, abs=1e-9)
    assert sorted((m.t_us, m.beacon, m.track) for m in matches) == [row[:3] for row in matched]
    assert counts.rmse_px == pytest.approx(math.sqrt(np.mean([row[3] ** 2 for row in matched])), abs=1e-9)


@pytest.mark.parametrize("k", range(len(RUNS)))
def test_idf1_is_that_of_motmetrics(k: int) -> None:
    figures, _ = by_motmetrics(RUNS[k])
    counts = identity(RUNS[k])
    assert counts.idf1 == pytest.approx(figures.idf1, abs=1e-9)
    wrong = (counts.true, counts.tracks - counts.true, counts.objects - counts.true)
    assert wrong == (figures.idtp, figures.idfp, figures.idfn)


@pytest.mark.parametrize(("p", "c_px"), [(1.0, 5.0), (2.0, 5.0), (2.0, 12.5)])
def test_gospa_and_its_parts_are_those_of_stonesoup(p: float, c_px: float) -> None:
    reason = "the oracle of GOSPA is stonesoup"
    metric = pytest.importorskip("stonesoup.metricgenerator.ospametric", reason=reason).GOSPAMetric(p=p, c=c_px)
    state = pytest.importorskip("stonesoup.types.state", reason=reason).State
    now = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
    compared = 0
    for each in [instant for run in RUNS for instant in run]:
        if not len(each.beacon) + len(each.track):
            continue
        beacons, tracks = ([state(xy.reshape(2, 1), now) for xy in at] for at in (each.beacon_px, each.track_px))
        theirs = metric.compute_gospa_metric(tracks, beacons)[0].value
        ours = gospa(each, p, c_px)
        assert ours.distance_px == pytest.approx(theirs["distance"], abs=1e-9)
        parts = (ours.localisation, ours.missed, ours.false)
        assert parts == pytest.approx((theirs["localisation"], theirs["missed"], theirs["false"]), abs=1e-9)
        compared += 1
    assert compared > 1000


def test_a_swap_is_two_switches_and_two_transfers() -> None:
    counts, _ = clear(crossing())
    # The last instant adds a miss of b and the false track 3.
    assert counts == Clear(10, 1, 1, 2, 2, 6 * 0.25)
    assert counts.mota == pytest.approx(1 - 4 / 10)


def test_a_new_name_is_a_switch_and_no_transfer() -> None:
    run = [instant(t, {"a": (0, 0)}, {name: (1, 0)}) for t, name in enumerate("1122")]
    counts, _ = clear(run)
    assert (counts.switches, counts.transfers) == (1, 0)
    assert identity(run) == Identity(2, 4, 4)


def test_the_track_of_the_last_match_is_kept_though_another_is_nearer() -> None:
    run = [instant(0, {"a": (0, 0)}, {"1": (0, 0)}), instant(1, {"a": (0, 0)}, {"2": (0, 0), "1": (4, 0)})]
    assert [m.track for m in clear(run)[1]] == ["1", "1"]


def test_as_many_pairs_as_possible_match_before_the_nearest_do() -> None:
    (one, two) = clear([instant(0, {"a": (0, 0), "b": (6, 0)}, {"1": (2, 0), "2": (-4, 0)})])[1]
    assert (one.track, two.track) == ("2", "1")


def test_gospa_by_hand() -> None:
    # One pair 3 px apart, one beacon missed, one track false: 9 + 25 / 2 + 25 / 2.
    found = gospa(instant(0, {"a": (0, 0), "b": (50, 0)}, {"1": (3, 0), "2": (0, 50)}))
    assert (found.localisation, found.missed, found.false) == (9, 12.5, 12.5)
    assert found.distance_px == pytest.approx(math.sqrt(34))


@pytest.mark.parametrize(("p", "c_px"), [(0.5, 5.0), (math.inf, 5.0), (2.0, 0.0), (math.nan, 5.0)])
def test_gospa_refuses_an_order_or_cut_off_out_of_range(p: float, c_px: float) -> None:
    with pytest.raises(ValueError, match="p must be at least 1"):
        gospa(instant(0, {}, {}), p, c_px)


def test_without_anything_nothing_is_known() -> None:
    counts, matches = clear([instant(0, {}, {})])
    assert math.isnan(counts.mota)
    assert math.isnan(counts.rmse_px)
    assert math.isnan(identity([instant(0, {}, {})]).idf1)
    assert matches == []
    assert gospa(instant(0, {}, {})).distance_px == 0


def test_runs_are_added_then_divided() -> None:
    short = [instant(0, {"a": (0, 0)}, {})]
    long = [instant(t, {"a": (0, 0)}, {"1": (0, 3)}) for t in range(3)]
    both = clear(short)[0] + clear(long)[0]
    assert both.mota == pytest.approx(3 / 4)
    assert both.rmse_px == pytest.approx(3)
    assert (identity(short) + identity(long)).idf1 == pytest.approx(2 * 3 / (4 + 3))
