"""Events of an LED that sends text, as a sensor might see them (one track's region; no pixels)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link.contract import LinkFrame, Receiver, Text, edges_of
from heliograph.link.uart_layout import text_bits


@dataclass(frozen=True)
class TextLight:
    """How a change of the LED becomes events.

    Args:
        events: a change's events; the mean of a Poisson law, or exactly so many up to 5.
        tail_bits: mean of the exponential tail.
        jitter_bits: scale of each event's own delay.
        off_bits: additional delay of falls.
        lost: share of events lost.
        noise_hz: events a second at random times.
        clock: the beacon's bits are longer by this share.
        scan_us: all events of a scan share its time; 0: no scans.
        lead_bits: idle time before and after.
    """

    events: float = 20.0
    tail_bits: float = 0.1
    jitter_bits: float = 0.03
    off_bits: float = 0.0
    lost: float = 0.0
    noise_hz: float = 0.0
    clock: float = 0.0
    scan_us: float = 0.0
    lead_bits: int = 30


@dataclass(frozen=True)
class Watched:
    """What was seen of a light, until until_us."""

    t_us: Times
    on: Flags
    until_us: int


def watch(light: TextLight, bits: Sequence[int], bit_rate: float, seed: int, t0_us: int = 1_000_000) -> Watched:
    """Return the events of the bits, sent after idle time from t0_us on."""
    rng = np.random.default_rng(seed)
    bit_us = 1e6 / bit_rate * (1.0 + light.clock)
    idle = [1] * light.lead_bits
    levels = [*idle, *bits, *idle]
    edges, edge_on = edges_of(levels, t0_us, bit_us, level=True)
    count = rng.poisson(light.events, len(edges)) if light.events > 5 else np.full(len(edges), int(light.events))
    t, on = np.repeat(edges, count), np.repeat(edge_on, count)
    t = t + rng.exponential(light.tail_bits * bit_us, len(t)) + np.where(on, 0.0, light.off_bits * bit_us)
    t = t + np.abs(rng.normal(0.0, light.jitter_bits * bit_us, len(t)))
    kept = rng.random(len(t)) >= light.lost
    end_us = t0_us + len(levels) * bit_us
    noise = rng.uniform(t0_us, end_us, rng.poisson(light.noise_hz * (end_us - t0_us) / 1e6))
    t = np.concatenate([t[kept], noise])
    on = np.concatenate([on[kept], rng.random(len(noise)) < 0.5])
    if light.scan_us:
        t = np.ceil(t / light.scan_us) * light.scan_us
    order = np.argsort(t, kind="stable")
    return Watched(np.floor(t[order]).astype(np.int64), on[order], int(max(end_us, t.max(initial=0.0) + 1)))


def watch_text(light: TextLight, text: str, bit_rate: float, seed: int, t0_us: int = 1_000_000) -> Watched:
    """Return the events of a text."""
    return watch(light, text_bits(text), bit_rate, seed, t0_us)


def hear(receiver: Receiver, seen: Watched, cuts: Sequence[int] = (), flush: bool = True) -> list[LinkFrame | Text]:
    """Feed a receiver, the input cut at these times; return all that it decides."""
    out: list[LinkFrame | Text] = []
    bounds = [-(1 << 60), *sorted(cut for cut in cuts if cut < seen.until_us), seen.until_us]
    at = np.searchsorted(seen.t_us, bounds)
    for (i, j), until_us in zip(pairwise(at), bounds[1:], strict=True):
        out += receiver.feed(seen.t_us[i:j], seen.on[i:j], until_us)
    return out + receiver.flush() if flush else out


def joined(out: Sequence[LinkFrame | Text]) -> str:
    """Return the texts, joined."""
    return "".join(item.text or "" for item in out if isinstance(item, Text))


def edits(sent: str, got: str) -> int:
    """Return the least number of characters to replace, insert or delete."""
    row = list(range(len(got) + 1))
    for i, a in enumerate(sent, 1):
        above, row[0] = row[0], i
        for j, b in enumerate(got, 1):
            above, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, above + (a != b))
    return row[-1]
