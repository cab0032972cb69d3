"""The page for Prometheus, read by Prometheus's own parser."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.core import Context
from heliograph.messages import Health, Message, Metrics
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.core import MetricsCore
from heliograph_services.metrics_sink.exposition import SILENT_S, Exposition
from support.truth_scenes import Said, Sent, link, state, tracks, truth

parser = pytest.importorskip("prometheus_client.parser", reason="prometheus-client is not installed (extra `dev`)")


def report(gauges: dict[str, float] | None = None, state: str = "running") -> Health:
    return Health(
        service="decoder",
        instance="decoder",
        pid=7,
        state=state,  # type: ignore[arg-type]
        uptime_s=9.0,
        input_age_s=None,
        cpu_share=0.25,
        counters={"missing: events": 3, "dropped: events": 2, "refused: parity": 4, "store: rows": 5, "frames": 6},
        gauges={"queue": 4.0, **(gauges or {})},
    )


def samples(page: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    found: dict[Any, float] = {}
    for family in parser.text_string_to_metric_families(page):
        assert family.documentation
        assert family.type in {"counter", "gauge"}
        for sample in family.samples:
            key = (sample.name, frozenset(sample.labels.items()))
            assert key not in found, "each series once"
            found[key] = sample.value
    return found


def value(page: str, name: str, **labels: str) -> float | None:
    return samples(page).get((name, frozenset(labels.items())))


def test_the_counts_of_a_scene_are_on_the_page() -> None:
    core = MetricsCore(MetricsSinkConfig(file=""), Context(instance="metrics_sink", boot="b0", lockstep=True))
    messages: list[Message] = [
        *truth([Sent()], 2_000_000),
        *Said(refused={"parity": 1}).all_of(Sent(), 2_000_000).messages(),
    ]
    messages += [state(60_000), tracks(100_000), link(1_500_000, 0.75)]
    exposition = Exposition()
    for message in sorted(messages, key=lambda each: each.time_us):
        for metrics in core.feed(message):
            assert isinstance(metrics, Metrics)
            exposition.add(metrics)
    for metrics in core.close():
        assert isinstance(metrics, Metrics)
        exposition.add(metrics)
    page = exposition.page(0.0)
    assert value(page, "heliograph_frames_total", camera="cam0") == 181
    assert value(page, "heliograph_refused_total", camera="cam0", reason="parity") == 181
    sent = {"camera": "cam0", "beacon": "crane", "class": "visible"}
    assert value(page, "heliograph_frames_sent_total", **sent) == 135
    assert value(page, "heliograph_frames_right_total", **sent) == 135
    outcome = {"camera": "cam0", "protocol": "seed11", "outcome": "right"}
    assert value(page, "heliograph_frames_received_total", **outcome) == 181
    assert value(page, "heliograph_identifications_total", camera="cam0", beacon="crane") == 1
    assert value(page, "heliograph_observed_seconds_total", camera="cam0") == 0.1
    assert value(page, "heliograph_mar_estimate", camera="cam0") == 0.75
    assert value(page, "heliograph_sightings", camera="cam0") is not None


def test_processes_tell_their_queues_gaps_and_hops_while_they_report() -> None:
    exposition = Exposition()
    hop = {
        "latency whole n": 900.0,
        "latency whole p50_us": 2000.0,
        "latency whole p95_us": 4e3,
        "latency whole p99_us": 5e3,
    }
    exposition.hear(report(hop), 10.0)
    page = exposition.page(10.0 + SILENT_S)
    base = {"service": "decoder", "instance": "decoder"}
    assert value(page, "heliograph_process_up", **base) == 1
    assert value(page, "heliograph_queue_depth", **base) == 4
    assert value(page, "heliograph_missing_total", **base, topic="events") == 3
    assert value(page, "heliograph_dropped_total", **base, topic="events") == 2
    assert value(page, "heliograph_process_refused_total", **base, reason="parity") == 4
    assert value(page, "heliograph_latency_seconds", **base, hop="whole", quantile="0.99") == 0.005
    silent = exposition.page(10.1 + SILENT_S)
    assert value(silent, "heliograph_process_up", **base) == 0
    assert value(silent, "heliograph_queue_depth", **base) is None
    exposition.hear(report(state="stopping"), 20.0)
    assert value(exposition.page(20.0), "heliograph_process_up", **base) == 0


@given(st.text(max_size=30), st.integers(0, 2**53))
@settings(max_examples=30, deadline=None)
def test_any_text_survives_as_a_label(text: str, n: int) -> None:
    exposition = Exposition()
    second = {"service": "metrics_sink", "instance": "i", "t0_us": 0, "t1_us": 1_000_000, "gauges": {}}
    exposition.add(Metrics(**second, counters={f"cam0/refused/{text}": n}))  # type: ignore[arg-type]
    assert value(exposition.page(0.0), "heliograph_refused_total", camera="cam0", reason=text) == n


def test_invented_names_do_not_fill_the_page() -> None:
    exposition = Exposition()
    for i in range(30_000):
        exposition.add(
            Metrics(service="s", instance="i", t0_us=0, t1_us=1, counters={f"c/identified/{i}": 1}, gauges={})
        )
    assert exposition.page(0.0).count("\n") <= 20_002
