r"""The newest numbers as text that Prometheus reads (exposition format 0.0.4).

One block a metric, its samples in a fixed order::

    # HELP heliograph_frames_total Accepted frames.
    # TYPE heliograph_frames_total counter
    heliograph_frames_total{camera="cam0"} 1234

In a label's value ``\`` ``"`` and line feeds are escaped. Counters of cameras are sums of finished seconds since the
sink began, so they follow the light by the time that a second takes to settle; those of processes are their own.
docs/metrics.md has the list of the names.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Final

from heliograph.messages import Health, Metrics
from heliograph.units import US_PER_S
from heliograph_services.metrics_sink.processes import HOP, HOP_FIGURES, hop_of

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
# A process reports each second; after so long without, its gauges say nothing of now, and it counts as down.
SILENT_S: Final = 5.0
# Names of processes that are remembered as down; strangers could invent more.
PROCESSES_LIMIT: Final = 128
# Series of cameras; names from the bus are bounded in the books, this bounds their product with cameras.
SERIES_LIMIT: Final = 20_000

Labels = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric's name, kind and meaning; the counter's value is divided by `per`."""

    name: str
    kind: str
    about: str
    per: int = 1


@dataclass(frozen=True, slots=True)
class _Of:
    """Where a counter of a second goes: its metric, the label that holds what follows the stroke, and fixed labels."""

    metric: Metric
    label: str = ""
    fixed: Labels = ()


def _counter(name: str, about: str, per: int = 1) -> Metric:
    return Metric(f"heliograph_{name}_total", "counter", about, per)


def _gauge(name: str, about: str) -> Metric:
    return Metric(f"heliograph_{name}", "gauge", about)


_SENT = _counter("frames_sent", "Frames sent that count for MAR_sent, by class (truth).")
_RIGHT = _counter("frames_right", "Of those, read right.")
_WRONG = _counter("frames_wrong", "Of those, read wrong.")
_RECEIVED = _counter("frames_received", "Published frames of scored time, by outcome (truth).")
_CLASSES: Final = ("visible", "in_view", "close")
COUNTERS: Final[dict[str, _Of]] = {
    "frames": _Of(_counter("frames", "Accepted frames.")),
    "characters": _Of(_counter("characters", "Characters of text released.")),
    "bytes": _Of(_counter("data_bytes", "Bytes of data released.")),
    "refused": _Of(_counter("refused", "Refusals of decoders, by reason."), "reason"),
    "identified": _Of(_counter("identifications", "Identifications accepted or changed."), "beacon"),
    "lost": _Of(_counter("losses", "Identifications lost."), "beacon"),
    "observed_us": _Of(_counter("observed_seconds", "Camera time with a tracker.", US_PER_S)),
    "track_us": _Of(_counter("track_seconds", "Camera time times tracks.", US_PER_S)),
    "late": _Of(_counter("late", "Messages that came after their second was settled.")),
    "late_frames": _Of(_counter("late_frames", "Frames that came after their second was settled.")),
    "judged": _Of(_counter("identifications_judged", "New identifications held against the truth.")),
    "false_alarms": _Of(_counter("false_alarms", "Identifications where no beacon was in view (truth).")),
    "confusions": _Of(_counter("confusions", "Identifications where another beacon was (truth).")),
    "bits_visible": _Of(_counter("bits_sent", "Bits of the frames that count for MAR_sent (visible)."), "beacon"),
    "bits_right": _Of(_counter("bits_right", "Of those, read right by slot."), "beacon"),
    "right": _Of(_RECEIVED, "protocol", (("outcome", "right"),)),
    "wrong": _Of(_RECEIVED, "protocol", (("outcome", "wrong"),)),
    "insertions": _Of(_RECEIVED, "protocol", (("outcome", "insertion"),)),
    **{
        f"{kind}_{group}": _Of(metric, "beacon", (("class", group),))
        for kind, metric in (("sent", _SENT), ("right", _RIGHT), ("wrong", _WRONG))
        for group in _CLASSES
    },
}
_SIGHTINGS = _gauge("sightings", "Beacons that are identified now.")
_ESTIMATE = _gauge("mar_estimate", "The receivers' own estimate of MAR, mean of the newest second that has one.")
_UP = _gauge("process_up", "1 while a process reports.")
_LATENCY = _gauge("latency_seconds", "Time over a hop in the last second, by quantile.")
_GAUGES: Final = {
    "cpu_share": _gauge("process_cpu_share", "Share of a core in the last second."),
    "queue": _gauge("queue_depth", "Messages that wait in a process's queues."),
    "store: rows waiting": _gauge("store_rows_waiting", "Rows of the sink that are not on its disk."),
}
_OWN_COUNTERS: Final = {
    "missing": (_counter("missing", "Messages that never arrived, seen by their numbers."), "topic"),
    "dropped": (_counter("dropped", "Messages dropped in a full queue."), "topic"),
    "published": (_counter("published", "Messages published."), "topic"),
    "received": (_counter("received", "Messages received."), "topic"),
    "refused": (_counter("process_refused", "Input that a process refused, by reason."), "reason"),
    "store": (_counter("store", "Rows of the sink: written, lost; failures of its disk."), "what"),
}
_QUANTILES: Final = {"p50_us": "0.5", "p95_us": "0.95", "p99_us": "0.99"}


class Exposition:
    """Collects what the sink hears, and writes it as a page."""

    def __init__(self) -> None:
        self._totals: dict[Metric, dict[Labels, int]] = defaultdict(dict)
        self._series = 0
        self._sightings: dict[Labels, float] = {}
        self._estimates: dict[Labels, float] = {}
        self._processes: dict[tuple[str, str], tuple[float, Health]] = {}

    def add(self, metrics: Metrics) -> None:
        """Take the counts of a finished second."""
        estimates: dict[str, dict[str, int]] = defaultdict(dict)
        for full, n in metrics.counters.items():
            camera, _, name = full.partition("/")
            kind, _, what = name.partition("/")
            if kind in {"mar_estimates", "mar_estimate_ppm"}:
                estimates[camera][kind] = n
            of = COUNTERS.get(kind)
            if of is not None:
                labels = (("camera", camera), *(((of.label, what),) if of.label else ()), *of.fixed)
                self._count(of.metric, labels, n)
        for camera, found in estimates.items():
            if found.get("mar_estimates"):
                mean = found.get("mar_estimate_ppm", 0) / found["mar_estimates"] / 1e6
                self._estimates[(("camera", camera),)] = mean
        for full, value in metrics.gauges.items():
            camera, _, name = full.partition("/")
            if name == "sightings":
                self._sightings[(("camera", camera),)] = value

    def hear(self, health: Health, now_s: float) -> None:
        """Take a process's report; now_s is any clock that never falls, the same as of `page`."""
        key = (health.service, health.instance)
        self._processes.pop(key, None)
        if len(self._processes) >= PROCESSES_LIMIT:
            del self._processes[next(iter(self._processes))]
        self._processes[key] = (now_s, health)

    def page(self, now_s: float) -> str:
        """Return the text."""
        samples: dict[Metric, dict[Labels, float]] = defaultdict(dict)
        for metric, series in self._totals.items():
            samples[metric] = {labels: n / metric.per for labels, n in series.items()}
        samples[_SIGHTINGS] |= self._sightings
        samples[_ESTIMATE] |= self._estimates
        for (service, instance), (heard_s, health) in self._processes.items():
            base = (("service", service), ("instance", instance))
            is_up = now_s - heard_s <= SILENT_S and health.state != "stopping"
            samples[_UP][base] = float(is_up)
            _add_counters(samples, base, health)
            if is_up:
                _add_gauges(samples, base, health)
        return "".join(_block(metric, samples[metric]) for metric in sorted(samples, key=_name_of) if samples[metric])

    def _count(self, metric: Metric, labels: Labels, n: int) -> None:
        series = self._totals[metric]
        if labels not in series:
            if self._series >= SERIES_LIMIT:
                return
            self._series += 1
        series[labels] = series.get(labels, 0) + n


def _add_counters(samples: dict[Metric, dict[Labels, float]], base: Labels, health: Health) -> None:
    for full, n in health.counters.items():
        prefix, _, what = full.partition(": ")
        found = _OWN_COUNTERS.get(prefix)
        if found is not None and what:
            samples[found[0]][*base, (found[1], what)] = float(n)


def _add_gauges(samples: dict[Metric, dict[Labels, float]], base: Labels, health: Health) -> None:
    for name, value in (health.gauges | {"cpu_share": health.cpu_share}).items():
        if name in _GAUGES:
            samples[_GAUGES[name]][base] = value
        hop = hop_of(name)
        for figure in HOP_FIGURES[1:] if hop else ():
            took_us = health.gauges.get(f"{HOP}{hop} {figure}")
            if took_us is not None:
                labels = (*base, ("hop", str(hop)), ("quantile", _QUANTILES[figure]))
                samples[_LATENCY][labels] = took_us / US_PER_S


def _block(metric: Metric, series: dict[Labels, float]) -> str:
    lines = [f"# HELP {metric.name} {metric.about}", f"# TYPE {metric.name} {metric.kind}"]
    for labels in sorted(series):
        inside = ",".join(f'{name}="{_escaped(value)}"' for name, value in labels)
        value = series[labels]
        lines.append(f"{metric.name}{{{inside}}} {int(value) if value == int(value) else repr(value)}")
    return "\n".join(lines) + "\n"


def _escaped(value: str) -> str:
    return value.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


def _name_of(metric: Metric) -> str:
    return metric.name
