"""The bench's corpus is what it says, and its result too; how fast it is depends on the machine and is not tested."""

from __future__ import annotations

import json

import numpy as np
import pytest

from heliograph.events import checked, concatenate
from heliograph_services.cli import bench
from heliograph_services.cli.__main__ import main
from heliograph_services.cli.bench_corpus import BEACONS, HEIGHT, TEXTURE_TOP_PX, WIDTH, Texture, make_corpus, place_px


@pytest.mark.parametrize(("rate_hz", "texture"), [(1e6, "contours"), (5e6, "contours"), (1e6, "fragments")])
def test_the_corpus_has_the_stated_density_on_a_sound_grid(rate_hz: float, texture: Texture) -> None:
    corpus = make_corpus(rate_hz, 0.2, seed=3, texture=texture)
    assert corpus.events == pytest.approx(rate_hz * corpus.seconds, rel=0.03)
    for window in corpus.windows:
        checked(window.batch, WIDTH, HEIGHT)
        assert window.t0_us <= window.batch.t_us[0]
        assert window.batch.t_us[-1] < window.t1_us
    assert [window.end for window in corpus.windows] == [False] * 19 + [True]


def test_the_same_seed_makes_the_same_corpus_and_a_shorter_one_is_its_beginning() -> None:
    long, short, other = (make_corpus(1e6, s, seed) for s, seed in ((0.2, 3), (0.1, 3), (0.1, 4)))
    for a, b in zip(long.windows, short.windows, strict=False):
        assert np.array_equal(a.batch.t_us, b.batch.t_us)
        assert np.array_equal(a.batch.x_px, b.batch.x_px)
    assert not np.array_equal(other.windows[0].batch.t_us, short.windows[0].batch.t_us)


def test_the_beacons_move_apart_from_each_other_and_from_the_texture() -> None:
    t_us = np.arange(0, 20_000_000, 5_000, dtype=np.float64)
    paths = [place_px(i, t_us) for i in range(len(BEACONS))]
    for i, (x, y) in enumerate(paths):
        assert y.max() < TEXTURE_TOP_PX - 12
        assert min(x.min(), y.min(), WIDTH - x.max()) > 12
        speed_px_s = np.hypot(np.diff(x), np.diff(y)) / 5e-3
        assert 75 < speed_px_s.min() < speed_px_s.max() < 250
        for other_x, other_y in paths[:i]:
            assert np.hypot(x - other_x, y - other_y).min() > 24


def test_each_beacon_sends_its_word() -> None:
    """With nothing but beacons and noise, the events around a beacon's path are of its edges alone."""
    corpus = make_corpus(0.5e6, 0.05, seed=3)
    batch = concatenate([window.batch for window in corpus.windows])
    x, y = place_px(0, batch.t_us.astype(np.float64))
    near = np.hypot(batch.x_px - x, batch.y_px - y) < 3
    # 42 is 1110 101010 1, whose neighbours over the seam are equal: edges before bits 0+, 3, 4, 5, 6, 7, 8, 9 and 10.
    phase = (batch.t_us[near] // 1000) % 11
    counts = np.bincount(phase, minlength=11)
    assert set(np.flatnonzero(counts > counts.max() / 5)) == {3, 4, 5, 6, 7, 8, 9, 10}


def test_the_result_names_what_was_identified_and_adds_up(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.run(["decode", "--json", "--seconds", "0.6", "--repeat", "2", "--rate", "1"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    result = json.loads(line)
    assert result["identified"] == sorted(beacon.name for beacon in BEACONS)
    assert (result["seed"], result["repeats"], result["texture"]) == (bench.SEED, 2, "contours")
    stages = {stage["name"]: stage for stage in result["stages"]}
    assert list(stages) == list(bench.STAGES)
    whole = stages["end to end"]
    assert whole["seconds"] >= max(stages[name]["seconds"] for name in bench.STAGES[:-1])
    assert whole["mev_s"] == pytest.approx(result["events"] / whole["seconds"] / 1e6, rel=0.02)
    assert whole["core_share"] == pytest.approx(whole["seconds"] / result["camera_s"], rel=0.02)
    assert result["machine"]["cpu"]


def test_the_table_fits_a_terminal_and_judges_the_goal() -> None:
    stages = [bench.Stage(name, 1.0, 9.9, 0.5) for name in bench.STAGES]
    names = [beacon.name for beacon in BEACONS]
    result = bench.Result(10.0, "contours", 11, 19_997_937, 2.0, 5, stages, 1.1, names, 5)
    text = bench.table(result)
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "goal of 5 Mev/s end to end: reached" in text


@pytest.mark.parametrize(
    "arguments", [["--seconds", "0"], ["--repeat", "0"], ["--rate", "1000"], ["--seed", "-1"], ["--seconds", "nan"]]
)
def test_a_number_out_of_range_is_one_line_and_status_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "decode", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "must be in [" in line
