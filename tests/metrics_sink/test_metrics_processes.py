"""What becomes of the processes' health reports: rises, levels, hops; strangers are bounded."""

from __future__ import annotations

from heliograph.messages import Health
from heliograph_services.metrics_sink.processes import NAMES_LIMIT, PROCESSES_LIMIT, Processes
from heliograph_services.metrics_sink.rows import HealthRow, HopRow, LevelRow, ProcessCountRow

KEY = ("decoder", "decoder", 7)


def report(uptime_s: float, counters: dict[str, int], gauges: dict[str, float] | None = None, pid: int = 7) -> Health:
    return Health(
        service="decoder",
        instance="decoder",
        pid=pid,
        state="running",
        uptime_s=uptime_s,
        input_age_s=None,
        cpu_share=0.5,
        counters=counters,
        gauges=gauges or {},
    )


def test_a_series_holds_the_rise_of_a_counter_in_the_second_of_the_uptime() -> None:
    processes = Processes()
    processes.take(report(100.2, {"published: frames": 5_000}))
    rows = processes.take(report(101.2, {"published: frames": 6_000, "dropped: events": 2, "frames": 9}))
    rises = [row for row in rows if isinstance(row, ProcessCountRow)]
    assert rises == [
        ProcessCountRow(*KEY, 101, "published: frames", 1_000),
        ProcessCountRow(*KEY, 101, "dropped: events", 2),
    ]


def test_what_a_process_counted_before_the_sink_came_did_not_rise_now() -> None:
    old = Processes().take(report(100.2, {"missing: events": 7}))
    young = Processes().take(report(1.0, {"missing: events": 7}))
    assert [row for row in old if isinstance(row, ProcessCountRow)] == []
    assert [row.n for row in young if isinstance(row, ProcessCountRow)] == [7]
    assert HealthRow(*KEY, "missing: events", 7.0) in old


def test_queue_and_hops_become_rows_and_not_newest_values() -> None:
    gauges = {"queue": 3.0, "latency bus n": 990.0}
    gauges |= {"latency bus p50_us": 120.4, "latency bus p95_us": 300.0, "latency bus p99_us": 900.6}
    rows = Processes().take(report(5.0, {}, gauges))
    assert HopRow(*KEY, 5, "bus", 990, 120, 300, 901) in rows
    assert LevelRow(*KEY, 5, "queue", 3.0) in rows
    assert LevelRow(*KEY, 5, "cpu_share", 0.5) in rows
    assert not [row for row in rows if isinstance(row, HealthRow) and row.name.startswith("latency")]


def test_a_restart_under_the_same_name_begins_anew() -> None:
    processes = Processes()
    processes.take(report(50.0, {"published: ids": 500}))
    rows = processes.take(report(1.0, {"published: ids": 10}, pid=8))
    assert [row.n for row in rows if isinstance(row, ProcessCountRow)] == [10]


def test_invented_names_and_processes_are_bounded() -> None:
    processes = Processes()
    processes.take(report(1.0, {f"refused: {i}": 1 for i in range(NAMES_LIMIT + 100)}))
    assert processes.dropped >= 100
    for pid in range(3 * PROCESSES_LIMIT):
        processes.take(report(1.0, {"published: ids": 1}, pid=pid))
    assert len(processes._counters) == len(processes._newest) == PROCESSES_LIMIT
    assert processes._names <= NAMES_LIMIT
