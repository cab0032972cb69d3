"""Onsets by their definition, event by event: slow, and nothing to get wrong."""

from __future__ import annotations

from collections import Counter

Event = tuple[int, int, int, bool]
Entry = tuple[int, int, int, int, int]
Cell = tuple[int, int, int]


def _around(cell: Cell, ticks: int) -> list[Cell]:
    tick, y, x = cell
    return [(tick - k, y + j, x + i) for k in range(ticks) for j in (-1, 0, 1) for i in (-1, 0, 1)]


def onsets(events: list[Event], t0_us: int, tick_us: int, pool_px: int, gate: str, min_events: int) -> list[Entry]:
    """Return (tick, y, x, on_count, off_count), sorted."""
    on: Counter[Cell] = Counter()
    off: Counter[Cell] = Counter()
    for t_us, x, y, is_on in events:
        cell = ((t_us - t0_us) // tick_us, y // pool_px, x // pool_px)
        (on if is_on else off)[cell] += 1
    entries = []
    for cell in sorted({*on, *off}):
        near = sum(min(255, on[c]) + min(255, off[c]) for c in _around(cell, 2))
        if gate == "active" and near < min_events:
            continue
        entries.append((*cell, min(15, on[cell]), min(15, off[cell])))
    return entries


def lights(entries: list[Entry], memory: int) -> list[bool]:
    """Return which of some entries, sorted, lie at two pixels that blink."""
    flips: dict[tuple[int, int], list[int]] = {}
    sign: dict[tuple[int, int], int] = {}
    blinking: set[Cell] = set()
    for tick in sorted({entry[0] for entry in entries}):
        for _, y, x, on, off in (entry for entry in entries if entry[0] == tick):
            seen = flips.setdefault((y, x), [])
            if on and off:
                seen += [tick] * (2 if min(on, off) > 1 else 1)
                sign[y, x] = 0
            else:
                now = 1 if on else -1
                seen += [tick] if sign.get((y, x)) == -now else []
                sign[y, x] = now
        blinking |= {(tick, y, x) for (y, x), seen in flips.items() if len(seen) > 1 and tick - seen[-2] <= memory}
    return [sum(c in blinking for c in _around((tick, y, x), 1)) >= 2 for tick, y, x, _, _ in entries]
