"""The sink as a process: what goes over the bus is in the file, and on the bus again."""

from __future__ import annotations

from pathlib import Path

import pytest

from heliograph.messages import Metrics
from heliograph_services.metrics_sink.summary import summarise
from support.processes import Host, collecting, free_port
from support.truth_scenes import Said, Sent, state, truth

SITE = """
site = "sink"
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "metrics_sink"
file = "kept/metrics.sqlite"
"""
UNTIL_US = 3_000_000


@pytest.mark.processes
def test_a_stream_on_the_bus_is_scored_published_and_kept(tmp_path: Path) -> None:
    port = free_port()
    host = Host(tmp_path, "sink", SITE.format(port=port), ["metrics_sink"])
    beacon = Sent()
    messages = [*truth([beacon], UNTIL_US), *Said().all_of(beacon, UNTIL_US).messages(), state(60_000)]
    messages.sort(key=lambda message: message.time_us)
    try:
        with collecting(port, "sink", ["metrics", "health"]) as heard:
            # The first health report comes after the subscriptions.
            heard.until(lambda h: any(m.service == "metrics_sink" for m in h.messages["health"]), "the sink")  # type: ignore[attr-defined]
            for message in messages:
                heard.bus.publish(message)
            # Nothing follows: it is the health reports by which the sink notices, and finishes what waits.
            heard.until(lambda h: len(h.messages["metrics"]) == 3, "three seconds")
            found = [message for message in heard.messages["metrics"] if isinstance(message, Metrics)]
        assert [message.t1_us for message in found] == [1_000_000, 2_000_000, 3_000_000]
        assert sum(message.counters["cam0/right/seed11"] for message in found) == 272
        assert host.close() == {"metrics_sink": 0, "router": 0}
    finally:
        host.close()
    kept = summarise(tmp_path / "kept" / "metrics.sqlite")
    assert kept.accuracy is not None
    assert (kept.accuracy.mar_visible.right, kept.accuracy.mar_visible.n) == (226, 226)
    assert kept.identified == {"crane": 1}
