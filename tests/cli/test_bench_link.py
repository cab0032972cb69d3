"""`heliograph bench link`: its lights are what they say, its scores those of docs/metrics.md, its file is gone on from.

Which receiver reads how much is the bench's business, not the tests'.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from heliograph.link.contract import LinkFrame
from heliograph_services.cli import bench_link
from heliograph_services.cli.__main__ import main
from heliograph_services.cli.bench_link import CONDITIONS, SECTIONS, line, study_seed
from heliograph_services.cli.link_genie import genie, words
from heliograph_services.cli.link_light import DELAY_US, Damage, Seen, watch
from heliograph_services.cli.link_trials import (
    NO_BEACONS,
    Section,
    Sent,
    Trial,
    alarms,
    make_trial,
    no_beacon,
    run_trial,
    score,
    slots_of,
)
from heliograph_services.cli.link_tuning import CONTENDERS, DEVELOPMENT_SEEDS, Contender, grid, maker, tune

SEED11 = Section("seed11", 1000.0, 20)
UART = SECTIONS[2]
SHORT = ["bench", "link", "--development", "--runs", "2", "--seconds", "1", "--section", "uart"]


def light(damage: Damage, seed: int = 1) -> Seen:
    """One edge up at 10 ms, one down at 20 ms."""
    return watch([0] * 10 + [1] * 10 + [0] * 10, 0.0, 1000.0, 40, damage, np.random.default_rng(seed))


def near(seen: Seen, t_us: int) -> np.ndarray:
    return seen.on[(seen.t_us > t_us - 500) & (seen.t_us < t_us + 900)]


def test_an_edge_makes_events_of_its_polarity_after_it() -> None:
    seen = light(Damage())
    for t_us, is_on in ((10_000, True), (20_000, False)):
        polarity = near(seen, t_us)
        assert 70 < len(polarity) < 130
        assert (polarity == is_on).all()
        times = seen.t_us[(seen.on == is_on) & (seen.t_us > 5_000)]
        assert times.min() > t_us + DELAY_US[is_on] - 30


def test_the_first_events_of_an_edge_can_be_lost_and_they_are_the_earliest() -> None:
    whole, less = light(Damage()), light(Damage(first_lost=10))
    assert len(near(whole, 10_000)) - len(near(less, 10_000)) == 10
    assert less.t_us[less.on].min() > whole.t_us[whole.on].min()
    assert len(near(light(Damage(first_lost=10_000)), 10_000)) == 0


@pytest.mark.parametrize(("damage", "share"), [(Damage(lost=0.8), 0.2), (Damage(dropped=1.0), 0.0), (Damage(), 1.0)])
def test_events_are_lost_as_said(damage: Damage, share: float) -> None:
    many = watch([0, 1] * 200, 0.0, 1000.0, 40, damage, np.random.default_rng(1))
    whole = watch([0, 1] * 200, 0.0, 1000.0, 40, Damage(), np.random.default_rng(1))
    assert len(many.t_us) == pytest.approx(share * len(whole.t_us), rel=0.05)
    assert (np.diff(many.t_us) >= 0).all()


def test_the_same_seed_makes_the_same_trial() -> None:
    one, again, other = (make_trial(SEED11, CONDITIONS["noise 1e4/s"], 1.0, seed) for seed in (5, 5, 6))
    assert np.array_equal(one.seen.t_us, again.seen.t_us)
    assert one.frames == again.frames
    assert not np.array_equal(one.seen.t_us, other.seen.t_us)


def test_a_frame_is_scored_as_by_hand() -> None:
    """seed11, frames of 11 ms that end at 11 (n + 1) ms; those that begin at 500 ms and later count: 506, 517, ..."""
    sent = [Sent(11_000.0 * n, 11_000.0 * (n + 1), 42) for n in range(50)]
    right = LinkFrame(517_300, 42, 1.0, 0.0)
    wrong = LinkFrame(528_000, 43, 1.0, 0.0)  # two bits of 1110 101010 1 differ in 1110 101011 0
    twice = LinkFrame(518_000, 42, 1.0, 0.0)
    early = LinkFrame(400_000, 42, 1.0, 0.0)
    trial = Trial(Seen(np.empty(0, np.int64), np.empty(0, np.bool_), 560_000), sent)
    (counts,) = score(trial, [early, right, twice, wrong], slots_of(SEED11)).values()
    assert (counts.sent, counts.right, counts.wrong, counts.inserted) == (4, 1, 1, 1)
    assert (counts.bits, counts.bits_matched, counts.bits_right) == (44, 22, 20)
    assert counts.sent_us == 44_000.0


def test_a_clean_light_is_read_by_every_receiver_at_its_own_rate() -> None:
    slow = Section("seed11", 250.0, 40)  # half of what fixed windows can read
    for section in (slow, UART):
        trial = make_trial(section, Damage(), 1.5, 2)
        for contender in CONTENDERS[section.protocol][:-1]:
            counts = run_trial(trial, maker(section, contender), slots_of(section)).seconds.values()
            assert sum(c.right for c in counts) > 0.5 * sum(c.sent for c in counts), contender


@pytest.mark.parametrize(("section", "contender"), [(SEED11, CONTENDERS["seed11"][2]), (UART, CONTENDERS["uart"][2])])
def test_tuned_is_never_worse_on_its_own_seeds_than_published(section: Section, contender: Contender) -> None:
    damage = CONDITIONS["edge jitter .1"]
    published = next(iter(grid(section, contender)))

    def right(parameters: object) -> int:
        make = maker(section, contender, parameters)  # type: ignore[arg-type]
        runs = [run_trial(make_trial(section, damage, 1.0, s), make, slots_of(section)) for s in DEVELOPMENT_SEEDS]
        return sum(c.right for run in runs for c in run.seconds.values())

    assert right(tune(section, contender, damage, 1.0)) >= right(published)


@pytest.mark.parametrize("kind", NO_BEACONS)
def test_our_receiver_takes_no_light_for_a_beacon_that_is_none(kind: str) -> None:
    found = alarms(maker(SEED11, CONTENDERS["seed11"][0]), no_beacon(kind, SEED11, 3.0, 1))
    assert (found.identities, round(found.seconds)) == (0, 3)


def test_the_genie_reads_clean_lights_without_an_error_and_broken_ones_best() -> None:
    for section in (SEED11, UART):
        for damage, least in ((Damage(), 1.0), (CONDITIONS["edge jitter .2"], 0.9)):
            trial = make_trial(section, damage, 1.5, 3)
            found = genie(section, trial)
            right = sum(f.payload == s.payload for f, s in zip(found, trial.frames, strict=True))
            assert right >= least * len(trial.frames)
            assert [f.t_us for f in found] == [round(s.t1_us) for s in trial.frames]


def test_the_genies_words_change_where_the_code_does() -> None:
    """42 is 1110 101010 1 and follows itself; 'U' is 0 1010101 0 1 1 after a lit LED."""
    payloads, changes = words(SEED11)
    assert changes[payloads.index(42)].tolist() == [0, 0, 0, -1, 1, -1, 1, -1, 1, -1, 1]
    payloads, changes = words(UART)
    assert changes[payloads.index(85)].tolist() == [-1, 1, -1, 1, -1, 1, -1, 1, -1, 1, 0]


def test_a_kind_of_light_that_does_not_exist_is_named() -> None:
    with pytest.raises(ValueError, match="must be one of noise, random bits"):
        no_beacon("moon", SEED11, 1.0, 1)


def test_the_studys_seeds_are_no_development_seeds() -> None:
    assert study_seed(bench_link.NAME) >= 1_000


def test_a_file_is_gone_on_from_and_its_looks_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "link.json"
    assert main([*SHORT, "--condition", "clean", "-o", str(path)]) == 0
    shown = capsys.readouterr().out
    assert all(len(text) <= 80 for text in shown.splitlines())
    kept = json.loads(path.read_text())
    assert (kept["looks"], kept["about"]["seeds"], len(kept["rows"])) == (1, "development", 4)
    ours = kept["rows"][0]
    assert (ours["receiver"], ours["mar_sent"]["value"], ours["fer"], ours["cer"]) == ("ours", 1.0, 0.0, 0.0)
    assert ours["goodput_bit_s"] == pytest.approx(7 / 11 * 3125.0, rel=1e-3)
    assert ours["mar_sent"]["low"] < 1.0

    def again(*_: object) -> None:
        raise AssertionError("made twice")

    monkeypatch.setattr(bench_link, "figures", again)
    assert main([*SHORT, "--condition", "clean", "-o", str(path)]) == 0
    assert capsys.readouterr().out == shown
    monkeypatch.undo()
    assert main([*SHORT, "--condition", "noise", "-o", str(path), "--json"]) == 0
    rows = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert {row["type"] for row in rows} == {"link"}
    assert json.loads(path.read_text())["looks"] == 1
    assert any(row.get("identities") == 0 for row in rows)


def test_rows_fit_a_terminal() -> None:
    share = {"value": 0.8765, "low": 0.8, "high": 0.9, "n": 9}
    row = {"condition": "event jitter .3", "receiver": "wang2022, tuned", "mar_sent": share, "mar_received": {"n": 0}}
    assert len(line(row | {"bar": share, "wrong": 999, "inserted": 9999, "core_share": 0.123})) <= 80


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--runs", "1"], "--runs must be in [2, 96], not 1"),
        (["--seconds", "nan"], "--seconds must be in [1, 60], not nan"),
        (["--section", "x"], "--section must be part of seed11 at 500 bit/s"),
        (["--condition", "x"], "--condition must be part of clean"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "link", *arguments]) == 2
    (found,) = capsys.readouterr().err.splitlines()
    assert text in found


def test_a_file_of_another_kind_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "other.json"
    path.write_text("[1]")
    assert main([*SHORT, "-o", str(path)]) == 2
    assert "no results of `heliograph bench link`" in capsys.readouterr().err
