"""The scanned read-out, slowly: scan after scan over plain lists, all events known beforehand."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph_services.event_source.simulation.contract import PixelEvents
from heliograph_services.event_source.simulation.readout.numbers import ScanNumbers

Read = tuple[int, int, int, bool, int]
Crossing = tuple[float, int, int]  # ns, +1 or -1, cause


@dataclass(frozen=True, slots=True)
class Scan:
    start_ns: int
    end_ns: int
    events: list[Read]


def plain_scans(numbers: ScanNumbers, width: int, height: int, events: PixelEvents, until_us: float) -> list[Scan]:
    """Return all scans that end by until_us, the first of which begins at 0; events as (t_us, x, y, on, cause)."""
    pending: dict[int, list[Crossing]] = {}
    for t_us, pixel, on, cause in zip(events.t_us, events.pixel, events.on, events.cause, strict=True):
        pending.setdefault(int(pixel), []).append((float(t_us) * 1000.0, 1 if on else -1, int(cause)))
    owed: dict[int, tuple[int, int]] = {}  # "step": what is left over, and its cause
    scans: list[Scan] = []
    start_ns = 0
    while True:
        end_ns, read = _scan(numbers, width, height, start_ns, pending, owed)
        if end_ns > until_us * 1000.0:
            return scans
        scans.append(Scan(start_ns, end_ns, read))
        start_ns = end_ns


def _scan(
    numbers: ScanNumbers,
    width: int,
    height: int,
    start_ns: int,
    pending: dict[int, list[Crossing]],
    owed: dict[int, tuple[int, int]],
) -> tuple[int, list[Read]]:
    hold_ns = start_ns + round(numbers.detect_us * 1000)
    stop_ns = start_ns + round(numbers.fixed_us * 1000)
    now_ns = hold_ns
    out_of_time = False
    read: list[Read] = []
    for x in range(width):
        sampled_ns = hold_ns if numbers.sample == "hold" else (max(now_ns, stop_ns) if out_of_time else now_ns)
        shown = {}
        for y in range(height):
            value, cause = _shown(numbers.latch, y * width + x, sampled_ns, pending, owed)
            if value:
                shown[y] = (value, cause)
        groups = len({y // numbers.group_px for y in shown})
        cycles = max(numbers.next_sel_cycles, numbers.column_cycles + numbers.group_cycles * groups)
        cost_ns = cycles * numbers.clock_ns
        out_of_time = out_of_time or (numbers.fixed_us > 0 and now_ns + cost_ns > stop_ns)
        for y in range(height):
            _settle(numbers.latch, y * width + x, sampled_ns, now_ns, shown.get(y), out_of_time, pending, owed)
        if not out_of_time:
            stamp_ns = now_ns if numbers.stamp == "column" else hold_ns
            read += [(stamp_ns // 1000, x, y, value > 0, cause) for y, (value, cause) in sorted(shown.items())]
            now_ns += cost_ns
    end_ns = (stop_ns if numbers.fixed_us else now_ns) + round(numbers.stretch_us * 1000)
    if numbers.stamp == "end":
        read = [(end_ns // 1000, x, y, on, cause) for _, x, y, on, cause in read]
    return end_ns, read


def _shown(
    latch: str, pixel: int, sampled_ns: float, pending: dict[int, list[Crossing]], owed: dict[int, tuple[int, int]]
) -> tuple[int, int]:
    """Return what a pixel holds (its sign counts), and the cause of the crossing that made it so."""
    value, cause = owed.get(pixel, (0, 0))
    for ns, step, why in pending.get(pixel, []):
        if ns >= sampled_ns or (latch == "first" and value):
            break
        if value == 0:
            cause = why
        value += step
    return value, cause


def _settle(
    latch: str,
    pixel: int,
    sampled_ns: float,
    turn_ns: float,
    shown: tuple[int, int] | None,
    lost: bool,
    pending: dict[int, list[Crossing]],
    owed: dict[int, tuple[int, int]],
) -> None:
    """Keep of a pixel what the next scans may see."""
    owed.pop(pixel, None)
    reset_ns = turn_ns if shown and not lost and latch != "step" else sampled_ns
    if pixel in pending:
        pending[pixel] = [crossing for crossing in pending[pixel] if crossing[0] >= max(reset_ns, sampled_ns)]
    if latch == "step" and shown and not lost:
        value, cause = shown
        rest = value - (1 if value > 0 else -1)
        if rest:
            owed[pixel] = (rest, cause)
