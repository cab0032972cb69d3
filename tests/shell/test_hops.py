"""Times over a process's hops, on clocks that a test moves."""

from __future__ import annotations

import pytest

from heliograph.shell import hops as module
from heliograph.shell.hops import Hops
from heliograph.wire import Header

MS = 1_000_000


class Clocks:
    """The host's two clocks."""

    def __init__(self) -> None:
        self.now_ns = 50_000 * MS
        self.wall_ahead_ns = 1_700_000_000_000 * MS

    def hops(self) -> Hops:
        return Hops(lambda: self.now_ns, lambda: self.now_ns + self.wall_ahead_ns)


def header(t_us: int, sent_ns: int, wall_ns: int) -> Header:
    return Header(
        schema="events",
        version=(1, 0),
        source="event_source/event_source",
        boot="b0",
        seq=0,
        clock="cam0",
        t_us=t_us,
        mono_ns=sent_ns,
        wall_ns=wall_ns,
    )


def batch(hops: Hops, clocks: Clocks, t_us: int, *, late_ms: int = 0, other_host: bool = False) -> None:
    """A batch that is sent as late as said, takes 1, 2, 3 and 4 ms over its hops, and leads to frames."""
    sent = 40_000 * MS + 1000 * t_us + late_ms * MS
    wall = sent + clocks.wall_ahead_ns
    clocks.now_ns = sent + 10 * MS
    told = header(t_us, sent + (7_777_777 * MS if other_host else 0), wall)
    hops.note(told, sent + 1 * MS, sent + 3 * MS, sent + 6 * MS, t_us)


@pytest.mark.parametrize("other_host", [False, True])
def test_each_hop_is_told_with_its_quantiles(other_host: bool) -> None:
    clocks = Clocks()
    hops = clocks.hops()
    for i in range(100):
        batch(hops, clocks, 1_000 * i, late_ms=5 if i == 50 else 0, other_host=other_host)
    found = hops.take()
    assert [found[f"latency {hop} p50_us"] for hop in ("bus", "wait", "core", "publish")] == [1e3, 2e3, 3e3, 4e3]
    assert (found["latency late p50_us"], found["latency late p99_us"]) == (0.0, 0.0)
    assert found["latency whole p50_us"] == 10_000.0
    assert found["latency bus n"] == 100
    assert hops.take() == {}


def test_a_late_sender_makes_the_whole_late() -> None:
    clocks = Clocks()
    hops = clocks.hops()
    batch(hops, clocks, 0)
    for i in range(1, 20):
        batch(hops, clocks, 1_000 * i, late_ms=5)
    found = hops.take()
    assert (found["latency late p50_us"], found["latency whole p50_us"]) == (5e3, 15e3)


def test_the_least_offset_is_forgotten_since_clocks_drift() -> None:
    clocks = Clocks()
    hops = clocks.hops()
    batch(hops, clocks, 0)
    for second in range(1, 15):
        batch(hops, clocks, 1_000_000 * second, late_ms=5)
    hops.take()
    batch(hops, clocks, 16_000_000, late_ms=5)
    assert hops.take()["latency late p50_us"] == 0.0


def test_a_recording_that_begins_again_is_not_late_by_its_length() -> None:
    clocks = Clocks()
    hops = clocks.hops()
    batch(hops, clocks, 3_000_000)
    hops.take()
    batch(hops, clocks, 0, late_ms=4_000)
    batch(hops, clocks, 1_000, late_ms=4_000)
    assert hops.take()["latency late p99_us"] == 0.0


def test_nobody_taking_fills_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_KEPT", 10)
    clocks = Clocks()
    hops = clocks.hops()
    for i in range(50):
        batch(hops, clocks, 1_000 * i)
    assert hops.take()["latency bus n"] == 10
