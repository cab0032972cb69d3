"""Events of one light, as a sensor might see them, for the tests of receivers (one track's region; no pixels)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link.contract import Bits, LinkFrame, Modulation, Receiver, Text, edges_of


@dataclass(frozen=True)
class Light:
    """How a change of the LED becomes events.

    Args:
        events: mean of a change's events, Poisson.
        delay_on_us, delay_off_us: latency.
        tail_us: mean of the exponential tail.
        edge_jitter: standard deviation of a change, in bits.
        event_jitter: each event is uniformly off by up to this, in bits.
        lost: share of events lost.
        dropped: share of changes lost whole.
        noise_hz: events a second at random times.
        clock_ppm: the beacon's bits are longer by this.
    """

    events: float = 20.0
    delay_on_us: float = 40.0
    delay_off_us: float = 60.0
    tail_us: float = 30.0
    edge_jitter: float = 0.0
    event_jitter: float = 0.0
    lost: float = 0.0
    dropped: float = 0.0
    noise_hz: float = 0.0
    clock_ppm: float = 0.0


@dataclass(frozen=True)
class Seen:
    """What the sensor saw: events, and when it had seen the last bit."""

    t_us: Times
    on: Flags
    until_us: int
    bit_us: float


def seen(light: Light, bits: Sequence[int], bit_rate: float, seed: int, t0_us: float = 0.0) -> Seen:
    """Return the events of the bits, sent from t0_us on."""
    rng = np.random.default_rng(seed)
    bit = 1e6 / bit_rate * (1.0 + light.clock_ppm * 1e-6)
    edges, levels = edges_of(bits, t0_us, bit)
    kept = rng.random(len(edges)) >= light.dropped
    edges, levels = edges[kept], levels[kept]
    edges = edges + rng.normal(0.0, 1.0, len(edges)) * light.edge_jitter * bit
    count = rng.poisson(light.events * (1.0 - light.lost), len(edges))
    t = np.repeat(edges, count)
    on = np.repeat(levels, count)
    t = t + np.where(on, light.delay_on_us, light.delay_off_us) + rng.exponential(light.tail_us, len(t))
    t = t + rng.uniform(-1.0, 1.0, len(t)) * light.event_jitter * bit
    until = t0_us + len(bits) * bit
    stray = rng.poisson(light.noise_hz * (until - t0_us) * 1e-6)
    t = np.concatenate([t, rng.uniform(t0_us, until, stray)])
    on = np.concatenate([on, rng.random(stray) < 0.5])
    whole = np.floor(t).astype(np.int64)
    order = np.argsort(whole, kind="stable")
    return Seen(whole[order], on[order], int(until) + 1, bit)


def repeated(bits: Bits, times: int) -> list[int]:
    """Return the bits, sent again and again."""
    return list(bits) * times


def read(receiver: Receiver, what: Seen, cuts_us: Sequence[int] = ()) -> list[LinkFrame]:
    """Return the frames of a receiver that is fed up to each of the cuts, then to the end, and flushed."""
    out: list[LinkFrame | Text] = []
    before = 0
    for until in [*sorted(c for c in cuts_us if 0 < c < what.until_us), what.until_us]:
        after = int(np.searchsorted(what.t_us, until))
        out += receiver.feed(what.t_us[before:after], what.on[before:after], until)
        before = after
    if before < len(what.t_us):
        last = int(what.t_us[-1]) + 1
        out += receiver.feed(what.t_us[before:], what.on[before:], last)
    out += receiver.flush()
    return [each for each in out if isinstance(each, LinkFrame)]


def payloads(modulation: Modulation, light: Light, payload: int, bit_rate: float, frames: int, seed: int) -> list[int]:
    """Return the payloads that a fresh receiver reads of a beacon that repeats one."""
    bits = repeated(modulation.encode(payload), frames)
    return [f.payload for f in read(modulation.receiver(bit_rate), seen(light, bits, bit_rate, seed))]
