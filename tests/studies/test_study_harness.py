"""The tracker's study itself: scores of readers whose worth is known, scenes that are what they say, a genie apart."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy import stats

from heliograph.events import concatenate
from heliograph.messages import Frames, Identification, Message
from heliograph.shares import difference, lower_bound, share
from heliograph.streams import Events
from heliograph_services.cli.studies import crowds, holding, tracker_page, tracker_rows, tracker_tables
from heliograph_services.cli.studies.genie import CORE_PX, hearer
from heliograph_services.cli.studies.paths import TruePaths, true_paths
from heliograph_services.cli.studies.running import Episode, Said, Setting, episode, opened, run
from heliograph_services.cli.studies.verdicts import RIGHT, WRONG, sent_frames, tracked, verdicts
from heliograph_services.event_source.cameras.simulated import SimulatedCamera
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.load import load_scenario

SECONDS = 1.2
THREE = crowds.moving(5, "mini", "slow", 2000.0, SECONDS, n=3, fresh=True, texture=False)
SETTING = Setting(THREE.text, 5, SECONDS, {"protocol": "seed11", "bit_rate": 2000.0})


@pytest.fixture(scope="module")
def seen() -> Episode:
    """Three slow beacons, before all readers."""
    return episode(SETTING, ("genie", "told", "ours"))


def paths_of(script: crowds.Script, folder: Path) -> TruePaths:
    """Return the true paths of a scene; nothing is rendered."""
    path = folder / "scene.toml"
    path.write_text(script.text, encoding="utf-8")
    return true_paths(SceneStream(load_scenario(str(path)), 0, "live"), round(script.seconds * 1e6))


def published(seen: Episode, beacon: list[int] | None = None) -> Frames:
    """Return what a receiver would publish that reads every frame, at the places of these beacons."""
    sent = sent_frames(seen.truths, seen.paths)
    place = np.array(beacon if beacon is not None else range(len(seen.paths.beacons)))[sent.beacon]
    x_px, y_px = seen.paths.places(sent.t1_us)
    at = np.arange(len(sent.t1_us))
    n = len(at)
    return Frames(
        camera="cam0", t0_us=0, t1_us=1, t_us=sent.t1_us.tolist(), track=["1"] * n, protocol=["seed11"] * n,
        beacon=[None] * n, payload=sent.payload.tolist(), x_px=x_px[place, at].tolist(),
        y_px=y_px[place, at].tolist(), score=[1.0] * n,
    )  # fmt: skip


def test_a_perfect_receiver_scores_one(seen: Episode) -> None:
    sent = sent_frames(seen.truths, seen.paths)
    found = verdicts(sent, [published(seen)], seen.paths)
    assert (found.outcome == RIGHT).all()
    assert found.insertions == 0
    assert found.off_px.max() == pytest.approx(0.0, abs=1e-9)
    assert sent.visible.sum() > 100


def test_a_receiver_that_swaps_two_beacons_reads_them_wrong(seen: Episode) -> None:
    sent = sent_frames(seen.truths, seen.paths)
    found = verdicts(sent, [published(seen, [1, 0, 2])], seen.paths)
    swapped = sent.beacon < 2
    assert (found.outcome[~swapped] == RIGHT).all()
    # Every frame draws from 48 payloads: a few of the other's are the same.
    assert np.mean(found.outcome[swapped] == WRONG) > 0.85


def test_frames_count_as_the_metrics_sink_counts_them(seen: Episode) -> None:
    accuracy = run(SETTING).summary.accuracy
    assert accuracy is not None
    sent = sent_frames(seen.truths, seen.paths)
    found = verdicts(sent, seen.said["ours"].frames, seen.paths)
    assert accuracy.mar_visible.n == sent.visible.sum()
    assert accuracy.mar_visible.right == ((found.outcome == RIGHT) & sent.visible).sum()


def test_what_others_are_told_changes_nothing_for_the_reader_under_test(seen: Episode) -> None:
    alone = episode(SETTING).said["ours"]
    beside = seen.said["ours"]

    def bodies(said: Said) -> list[dict[str, object]]:
        messages: list[Message] = [*said.frames, *said.tracks, *(state for _, state in said.states)]
        return [message.to_body() for message in messages]

    assert bodies(alone) == bodies(beside)
    assert len(alone.frames) > 0


def test_the_genie_reads_nearly_every_frame_of_slow_beacons(seen: Episode) -> None:
    sent = sent_frames(seen.truths, seen.paths)
    right = {name: np.mean(verdicts(sent, one.frames, seen.paths).outcome[sent.visible] == RIGHT)
             for name, one in seen.said.items()}  # fmt: skip
    assert right["genie"] > 0.99
    assert right["genie"] >= max(right.values()) - 0.01


def test_a_beacon_s_reach_holds_all_of_its_light_and_the_genie_hears_its_core(tmp_path: Path) -> None:
    quiet = crowds.moving(5, "mini", "slow", 2000.0, 0.2, n=3, fresh=True, texture=False).text
    override = "override = { 'pixel.shot_noise_hz' = 0.0, 'pixel.leak_hz' = 0.0, 'pixel.hot_pixels' = 0.0 }\n"
    text = quiet.replace("[camera]\n", f"[camera]\n{override}")
    with opened(Setting(text, 5, 0.2), tmp_path) as stream:
        camera = stream.camera
        assert isinstance(camera, SimulatedCamera)
        paths = true_paths(camera.scene, 200_000)
        batches = [message.batch for step in stream for message in step.messages if isinstance(message, Events)]
    events = concatenate(batches)
    assert len(events) > 1000
    assert np.mean(hearer(paths, paths.reach_px, events) >= 0) > 0.99
    assert 0.2 < np.mean(hearer(paths, paths.radius_px + CORE_PX, events) >= 0) < 0.8


def test_identities_published_at_each_other_s_places_are_two_swaps(seen: Episode) -> None:
    paths = msgspec_paths(seen.paths, [42, 21, 51])
    said = Said()
    for t_us, order in ((500_000, (0, 1, 2)), (600_000, (1, 0, 2)), (700_000, (1, 0, 2)), (800_000, (0, 1, 2))):
        said.take([state(paths, t_us, place, of) for place, of in enumerate(order)], t_us + 5_000)
    found = holding.held(said, paths)
    assert (found.swaps, found.confused, found.right, found.nowhere) == (2, 4, 8, 0)
    assert found.first_us == {"b00": 505_000, "b01": 505_000, "b02": 505_000}


def msgspec_paths(paths: TruePaths, payloads: list[int]) -> TruePaths:
    """Return paths whose beacons have payloads of their own."""
    beacons = [msgspec.structs.replace(b, fresh=False, payload=p) for b, p in zip(paths.beacons, payloads, strict=True)]
    return TruePaths(
        tuple(beacons), paths.x_px, paths.y_px, paths.radius_px, paths.reach_px, paths.in_view, paths.visible
    )


def state(paths: TruePaths, t_us: int, place: int, of: int) -> Identification:
    """Return the identity of one beacon, published at the place of another."""
    x_px, y_px = paths.places([t_us])
    return Identification(
        camera="cam0", track=str(place), t_us=t_us, since_us=0, protocol="seed11", beacon="x",
        payload=paths.beacons[of].payload, x_px=float(x_px[place, 0]), y_px=float(y_px[place, 0]), vx_px_s=0.0,
        vy_px_s=0.0, bearing=None, confidence=1.0, margin=1.0, frames_used=4, change="refreshed", lost=False,
    )  # fmt: skip


@pytest.mark.parametrize(("sensor", "move"), [("mini", "slow"), ("mini", "fast"), ("imx636", "fast")])
def test_movers_stay_on_the_sensor_at_the_speeds_that_were_drawn(sensor: str, move: str, tmp_path: Path) -> None:
    paths = paths_of(crowds.moving(1, sensor, move, 1000.0, 3.0, fresh=True, texture=False), tmp_path)
    assert paths.in_view.all()
    vx, vy = paths.velocities(np.arange(paths.x_px.shape[1] - 1) * 1000)
    top = np.quantile(np.hypot(vx, vy), 0.9, axis=1)
    low, high = crowds.MOVES[move].speed_px_s
    assert (top >= low * 0.99).all()
    assert (top <= high * 1.01).all()


@pytest.mark.parametrize("kind", list(crowds.KINDS))
def test_crossings_pass_within_two_pixels_half_way(kind: str, tmp_path: Path) -> None:
    script = crowds.crossing(3, kind, 1000.0)
    paths = paths_of(script, tmp_path)
    away = np.hypot(paths.x_px[0] - paths.x_px[1], paths.y_px[0] - paths.y_px[1])
    assert away[round(script.at_s[0] * 1000)] <= 2.1
    assert away[0] >= 20.0
    assert paths.in_view.all()


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("panning", [False, True])
def test_each_beacon_is_hidden_once_for_half_a_second(turning: bool, panning: bool, tmp_path: Path) -> None:
    paths = paths_of(crowds.occlusions(1, turning=turning, panning=panning, bit_rate=1000.0), tmp_path)
    assert paths.in_view.all()
    hidden = ~paths.visible
    assert np.abs(hidden.sum(axis=1) - 500).max() <= 3
    assert (np.diff(hidden.astype(int), axis=1) == 1).sum(axis=1).tolist() == [1] * len(paths.beacons)


def test_bounds_are_those_of_scipy() -> None:
    for k, n in ((196, 200), (200, 200), (3, 10), (0, 5)):
        expected = stats.binomtest(k, n).proportion_ci(0.9, "exact").low
        assert lower_bound(k, n) == pytest.approx(expected, abs=1e-9)
    draw = np.random.default_rng(2)
    sent = draw.integers(1, 60, 300)
    right = draw.binomial(sent, 0.9)
    found = share(right, sent)
    theirs = stats.bootstrap(
        (right, sent), lambda a, b, axis: a.sum(axis=axis) / b.sum(axis=axis), paired=True, method="percentile",
        n_resamples=4000, random_state=3, vectorized=True,
    ).confidence_interval  # fmt: skip
    assert [found.low, found.high] == pytest.approx([theirs.low, theirs.high], abs=1e-3)
    assert difference(right, right, sent).value == 0.0
    assert share(sent, sent).low == pytest.approx(1.0 - (1.0 - 0.05 ** (1.0 / 300)))


def test_every_table_can_be_made_of_its_rows(seen: Episode) -> None:
    row = tracker_rows.frames_row(seen) | {"run": {"seed": 5, "sensor": "mini", "move": "slow", "bit_rate": 2000.0}}
    row["run"]["background"] = "noise"
    table = tracker_tables.lines("moving", [row | {"code": "c"}])
    sent = sent_frames(seen.truths, seen.paths)
    assert sum(block[2] for name in ("out", "in") for block in row[name]) == sent.visible.sum()
    assert f"frames {sent.visible.sum()}" in next(line for line in table if "all visible" in line)
    assert json.loads(json.dumps(row)) == row


def test_a_told_track_is_near_its_beacon_carried_on_or_not(seen: Episode) -> None:
    sent = sent_frames(seen.truths, seen.paths)
    for carried in (True, False):
        assert tracked(sent, seen.said["told"].tracks, seen.paths, carried=carried)[sent.visible].all()
        assert not tracked(sent, [], seen.paths, carried=carried).any()


def test_the_page_answers_by_value_and_by_bound_and_never_mixes_two_codes() -> None:
    def crossing(kept: bool, code: str) -> tracker_page.Row:
        run = {"seed": 1, "kind": "head_on", "bit_rate": 1000.0}
        came = {"numbers": "kept" if kept else "swapped", "read": kept, "swaps": 0}
        return {"run": run, "code": code, "seconds": 1.0, "cpu_s": {"ours": 1.0}, **came}

    few = [crossing(False, "old")] * 50 + [crossing(True, "new")] * 50
    many = [crossing(True, "new")] * 200
    bad = [crossing(True, "new")] * 97 + [crossing(False, "new")] * 3
    for rows, n, met in ((few, 50, "value only"), (many, 200, "yes"), (bad, 100, "no")):
        text = tracker_page.page({"crossings": rows, "crowd": []})
        line = next(line for line in text.splitlines() if line.startswith("| crossings | both"))
        assert line.endswith(f"| {n} | {met} |")
        assert "## crowd\n\nNot run." in text


def test_the_page_of_a_real_run_tells_its_difference_to_the_genie_and_its_commit(seen: Episode) -> None:
    run = {"seed": 5, "sensor": "mini", "move": "slow", "bit_rate": 2000.0, "background": "noise"}
    row = tracker_rows.frames_row(seen) | {"run": run, "code": "c", "commit": "1234abc"}
    text = tracker_page.page({"moving": [row]})
    sent = sum(block[2] for block in row["out"])
    assert "Commit 1234abc." in text
    assert f"| {sent} frames, 1 runs |" in text
    assert "| noise mini slow | 2000 | outside close pairs |" in text


def test_the_page_tells_the_spin_s_curve_beside_the_genie_s() -> None:
    bins = [{"px_s": [0, 1000], "blocks": [[0, 10, 9, 8, 10]]}, {"px_s": [8000, 9000], "blocks": [[5, 20, 0, 5, 20]]}]
    row = {"run": {"seed": 1}, "code": "c", "seconds": 9.0, "cpu_s": {}, "readers": ["ours", "genie"], "bins": bins}
    text = tracker_page.page({"spin": [row]})
    assert "| spin | MAR_sent, 0 to 3000 px/s | the curve below | 0.8000" in text
    assert "| spin | MAR_sent, 6000 to 9000 px/s | the curve below | 0.2500" in text
    assert "3000 to 6000" not in text
