"""What is shown is counts added, then divided, with an interval."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from heliograph.core import Context
from heliograph.errors import FileError
from heliograph.messages import Health, Message
from heliograph_services.cli.metrics import table
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.service import MetricsSink, make_core, warm
from heliograph_services.metrics_sink.summary import summarise, summary
from support.truth_scenes import Said, Sent, state, tracks, truth

CONTEXT = Context(instance="metrics_sink", boot="b0", lockstep=False)
UNTIL_US = 3_000_000


def run(path: Path, messages: list[Message]) -> None:
    warm()
    core = make_core(MetricsSinkConfig(file=str(path)), CONTEXT)
    for message in sorted(messages, key=lambda each: each.time_us):
        core.feed(message)
    core.close()


def test_the_summary_of_a_run_adds_counts_and_divides(tmp_path: Path) -> None:
    beacon = Sent()
    said = Said(refused={"parity": 1}).all_of(beacon, UNTIL_US)
    wrong = beacon.ends(UNTIL_US)[200]
    said.rows = [(*row[:3], 41 if row[0] == wrong else 42, *row[4:]) for row in said.rows]
    said.add(1_000_000, x_px=300.0)
    path = tmp_path / "m.sqlite"
    run(path, [*truth([beacon], UNTIL_US), *said.messages(), state(60_000), tracks(100_000)])
    found = summarise(path)
    # 272 frames, of which those that begin before 0.5 s (46) do not count.
    assert found.frames == 273
    assert found.seconds == 3
    assert found.cameras == ["cam0"]
    assert found.identified == {"crane": 1}
    assert found.refused == {"parity": len(said.messages())}
    assert found.accuracy is not None
    assert (found.accuracy.mar_visible.right, found.accuracy.mar_visible.n) == (225, 226)
    assert (found.accuracy.mar_received.right, found.accuracy.mar_received.n) == (271, 273)
    # 41 is 1110 101001 1: two bits of the payload differ from 42's, the parity does not.
    assert (found.accuracy.bar.right, found.accuracy.bar.n) == (226 * 11 - 2, 226 * 11)
    assert (found.accuracy.fer.right, found.accuracy.fer.n) == (1, 226)
    assert found.accuracy.fer.value == pytest.approx(1 / 226)
    assert (found.accuracy.ber.right, found.accuracy.ber.n) == (2, 226 * 11)
    # 225 of 226 frames of 11 ms bring 6 bits each.
    assert found.accuracy.goodput_bit_s == pytest.approx(225 * 6 / (226 * 0.011))
    assert found.accuracy.first.median_ms == 60.0
    assert found.accuracy.first.never_in_1_s == 0.0
    assert found.accuracy.again.intervals == 0
    assert (found.accuracy.judged, found.accuracy.false_alarms, found.accuracy.confusions) == (1, 0, 0)
    assert [(s.beacon, s.first_us, s.ended) for s in found.sightings] == [("crane", 60_000, True)]
    assert summary(path)["accuracy"]["mar_visible"]["right"] == 225


def test_without_truth_accuracy_is_null_and_the_estimate_stands(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    run(path, [*Said().all_of(Sent(), UNTIL_US).messages()])
    found = summarise(path)
    assert found.accuracy is None
    assert found.mar_estimated is None
    assert found.frames == 272


def test_gaps_come_from_the_processes_health(tmp_path: Path) -> None:
    reports: list[Message] = [
        Health(
            service="decoder",
            instance=f"d{i}",
            pid=i,
            state="running",
            uptime_s=1.0,
            input_age_s=None,
            cpu_share=0.1,
            counters={"missing: events": 3, "dropped: events": i, "published: ids": 9},
            gauges={"queue": 1.0},
        )
        for i in range(3)
    ]
    path = tmp_path / "m.sqlite"
    run(path, reports)
    found = summarise(path)
    assert found.missing == {"events": 9}
    assert found.dropped == {"events": 3}


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no such metrics file"):
        summarise(tmp_path / "none.sqlite")


def test_an_empty_run_has_no_ratios(tmp_path: Path) -> None:
    path = tmp_path / "m.sqlite"
    run(path, [])
    assert summarise(path).frames == 0


def test_silence_on_the_bus_finishes_seconds_by_the_health_reports(tmp_path: Path) -> None:
    now = [0.0]
    core = MetricsSink(MetricsSinkConfig(file=str(tmp_path / "m.sqlite")), CONTEXT, clock=lambda: now[0])
    for message in Said().all_of(Sent(), 500_000).messages():
        assert core.feed(message) == []
    report = Health(
        service="tracker",
        instance="tracker",
        pid=1,
        state="running",
        uptime_s=1.0,
        input_age_s=None,
        cpu_share=0.0,
        counters={},
        gauges={},
    )
    assert core.feed(report) == []
    now[0] = 3.0
    assert [message.time_us for message in core.feed(report)] == [1_000_000]
    assert core.feed(report) == []
    core.close()
    assert core.counters["store: rows"] > 0


def test_truth_without_frames_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A site without its decoder: the sink's log says so once, and `show` says so above an accuracy of 0."""
    path = tmp_path / "m.sqlite"
    core = make_core(MetricsSinkConfig(file=str(path)), CONTEXT)
    with caplog.at_level(logging.WARNING):
        for message in truth([Sent()], 12_000_000):
            core.feed(message)
        core.close()
    (record,) = caplog.records
    assert record.getMessage() == "cam0: truth without frames for 5 s: does a decoder run?"
    found = summarise(path)
    assert found.frames == 0
    assert found.accuracy is not None
    assert found.accuracy.mar_visible.value == 0.0
    assert [line for line in table(found).splitlines() if "truth without frames" in line] == [
        "  truth without frames: nobody has read what was sent (does a decoder run?)"
    ]
