"""What the processes of a site say of themselves, second by second of their own uptime.

A health report holds counters since the process began, gauges of now, and the percentiles of its hops over the second
before (`heliograph.shell.hops`). Kept are the newest value of everything, and as series: by how much the counters of
`RATES` rose since the report before, the gauges of `LEVELS`, and the hops. The first report of a process says what its
counters were, not when; only of one that has just started do they count as risen.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from heliograph.messages import Health
from heliograph_services.metrics_sink.rows import HealthRow, HopRow, LevelRow, ProcessCountRow, ProcessRow

# Numbers of all processes; strangers could invent names for ever.
NAMES_LIMIT: Final = 8192
# Processes that are followed at a time; restarts make new ones, and the one that was silent longest gives way.
PROCESSES_LIMIT: Final = 128
RATES: Final = ("published: ", "missing: ", "dropped: ", "refused: ", "bytes out")
LEVELS: Final = ("queue", "cpu_share")
HOP: Final = "latency "
HOP_FIGURES: Final = ("n", "p50_us", "p95_us", "p99_us")
# A report comes each second; one of a younger process is its first.
_YOUNG_S: Final = 2.5

ProcessKey = tuple[str, str, int]


class Processes:
    """The reports of all processes of a site."""

    def __init__(self) -> None:
        self.dropped = 0
        self._newest: dict[ProcessKey, dict[str, float]] = {}
        self._counters: OrderedDict[ProcessKey, dict[str, int]] = OrderedDict()
        self._names = 0

    def take(self, health: Health) -> list[ProcessRow]:
        """Take a report; return the rows that follow from it."""
        key = (health.service, health.instance, health.pid)
        second = int(health.uptime_s)
        before = self._counters.pop(key, None)
        if before is None and health.uptime_s < _YOUNG_S:
            before = {}
        self._counters[key] = dict(health.counters)
        while len(self._counters) > PROCESSES_LIMIT:
            gone, _ = self._counters.popitem(last=False)
            self._names -= len(self._newest.pop(gone, {}))
        gauges = health.gauges | {"cpu_share": health.cpu_share}
        numbers = {name: float(n) for name, n in health.counters.items()} | gauges | {"uptime_s": health.uptime_s}
        changed = self._kept(key, numbers)
        known = self._newest[key]  # what is beyond the limit of names has no series either
        rows: list[ProcessRow] = []
        for name, n in health.counters.items():
            rise = 0 if before is None else n - before.get(name, 0)
            if rise > 0 and name in known and name.startswith(RATES):
                rows.append(ProcessCountRow(*key, second, name, rise))
        rows += [LevelRow(*key, second, name, gauges[name]) for name in LEVELS if name in gauges]
        return rows + _hops(key, second, {name: gauges[name] for name in gauges if name in known}) + changed

    def _kept(self, key: ProcessKey, numbers: dict[str, float]) -> list[ProcessRow]:
        """Return rows of the numbers that have changed; names beyond the limit are dropped, and counted."""
        newest = self._newest.setdefault(key, {})
        rows: list[ProcessRow] = []
        for name, value in numbers.items():
            if name not in newest:
                if self._names >= NAMES_LIMIT:
                    self.dropped += 1
                    continue
                self._names += 1
            elif newest[name] == value:
                continue
            newest[name] = value
            if not name.startswith(HOP):
                rows.append(HealthRow(*key, name, value))
        return rows


def _hops(key: ProcessKey, second: int, gauges: dict[str, float]) -> list[ProcessRow]:
    """Return the rows of the hops that a report names."""
    rows: list[ProcessRow] = []
    for name, n in gauges.items():
        hop = hop_of(name)
        if hop is None or n < 1:
            continue
        p50, p95, p99 = (round(gauges.get(f"{HOP}{hop} {figure}", 0.0)) for figure in HOP_FIGURES[1:])
        rows.append(HopRow(*key, second, hop, round(n), p50, p95, p99))
    return rows


def hop_of(name: str) -> str | None:
    """Return the hop whose number of messages a gauge of this name tells, or None."""
    if not name.startswith(HOP) or not name.endswith(" n"):
        return None
    return name[len(HOP) : -len(" n")] or None
