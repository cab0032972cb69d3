"""Onsets by their definition, event by event: slow, and nothing to get wrong."""

from __future__ import annotations

from collections import Counter

Event = tuple[int, int, int, bool]
Entry = tuple[int, int, int, int, int]


def onsets(events: list[Event], t0_us: int, tick_us: int, pool_px: int, gate: str, min_events: int) -> list[Entry]:
    """Return (tick, y, x, on_count, off_count), sorted."""
    on: Counter[tuple[int, int, int]] = Counter()
    off: Counter[tuple[int, int, int]] = Counter()
    for t_us, x, y, is_on in events:
        cell = ((t_us - t0_us) // tick_us, y // pool_px, x // pool_px)
        (on if is_on else off)[cell] += 1
    entries = []
    for cell in sorted({*on, *off}):
        tick, y, x = cell
        around = [(tick, y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1)]
        if gate == "active" and sum(min(255, on[c]) + min(255, off[c]) for c in around) < min_events:
            continue
        entries.append((tick, y, x, min(255, on[cell]), min(255, off[cell])))
    return entries
