"""Camera streams for the decoder's benches, drawn directly: blinking discs at known places, and noise around them.

Not the simulator's light: what counts here is how many events there are, and how many of them tracks hear. Each disc
sends its own word of seed11 again and again; a change of level is a Poisson number of events on its pixels, some tens
of microseconds late. Noise is uniform over a part of the sensor, so that tracks elsewhere hear nothing. Behind scans
all events of a scan have its end's time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heliograph.events import EventBatch
from heliograph.link.contract import edges_of
from heliograph.link.modulations import modulation
from heliograph.messages import Tracks
from heliograph.site import Beacon
from heliograph.streams import Events
from heliograph.wire import header_for, pack

WIDTH, HEIGHT = 640, 480
RADIUS_PX: Final = 4.5
PERIOD_US: Final = 100_000
# Latency of a pixel, and the tail of an edge: a bright LED on a sensor of the last generation.
DELAY_US, TAIL_US = 80.0, 40.0


@dataclass(frozen=True)
class Corpus:
    """A second or more of camera time.

    Args:
        batch: all events.
        duration_us: its length.
        places: (n, 2) of the beacons, then of the tracks that hear nothing.
        beacons: who sends what.
        inside: share of the events that are the beacons'.
    """

    batch: EventBatch
    duration_us: int
    places: np.ndarray
    beacons: tuple[Beacon, ...]
    inside: float

    def events(self, t0_us: int, t1_us: int, shift_us: int = 0) -> Events:
        """Return the record of [t0_us, t1_us), later by shift_us."""
        first, behind = np.searchsorted(self.batch.t_us, (t0_us, t1_us))
        part = self.batch.part(int(first), int(behind))
        part = EventBatch(part.t_us + shift_us, part.x_px, part.y_px, part.on)
        return Events(
            camera="cam0", stream="bench", width=WIDTH, height=HEIGHT,
            t0_us=t0_us + shift_us, t1_us=t1_us + shift_us, batch=part,
        )  # fmt: skip

    def tracks(self, as_of_us: int) -> Tracks:
        """Return what a tracker would say of all places."""
        n = len(self.places)
        zeros, ones = [0.0] * n, [0.25] * n
        return Tracks(
            camera="cam0", as_of_us=as_of_us, period_us=PERIOD_US, track=[f"t{i}" for i in range(n)],
            born_us=[as_of_us] * n, seen_us=[as_of_us] * n,
            x_px=self.places[:, 0].tolist(), y_px=self.places[:, 1].tolist(), vx_px_s=zeros, vy_px_s=zeros,
            x_var_px2=ones, x_vx_cov_px2_s=zeros, vx_var_px2_s2=ones,
            y_var_px2=ones, y_vy_cov_px2_s=zeros, vy_var_px2_s2=ones,
            radius_px=[RADIUS_PX] * n, size_px=[2 * RADIUS_PX] * n, polarity=zeros, status=["new"] * n,
        )  # fmt: skip

    def messages(self, batch_us: int) -> list[bytes]:
        """Return the bytes of all event records, as they come from the bus."""
        made = [self.events(t_us, t_us + batch_us) for t_us in range(0, self.duration_us, batch_us)]
        return [packed(message, seq) for seq, message in enumerate(made)]


def packed(message: Events | Tracks, seq: int) -> bytes:
    """Return a record's bytes."""
    return pack(header_for(message, source="bench/bench", boot="0", seq=seq, mono_ns=0, wall_ns=0), message)


def _can_be_sent(payload: int) -> bool:
    try:
        modulation("seed11").encode(payload)
    except ValueError:
        return False
    return True


def corpus(
    seed: int, seconds: float, events_hz: float, inside: float, *, beacons: int = 20, bit_rate: float = 2_000.0,
    idle: int = 0, scan_us: float = 0.0,
) -> Corpus:  # fmt: skip
    """Draw a stream.

    Args:
        seed: of all that is random.
        seconds: its length.
        events_hz: events a second, all together.
        inside: share of them that the beacons make.
        beacons: how many.
        bit_rate: of each.
        idle: tracks in the part of the sensor where nothing happens.
        scan_us: time between scans; 0 for a sensor without.
    """
    rng = np.random.default_rng(seed)
    kind = modulation("seed11")
    payloads = [p for p in range(64) if _can_be_sent(p)][:beacons]
    # The noise and the beacons have the left part; a track listens some 20 px far.
    left = WIDTH // 2 if idle else WIDTH
    columns = 4 if idle else 5
    rows = -(-beacons // columns)
    grid = [((c + 0.5) * left / columns, (r + 0.5) * HEIGHT / rows) for r in range(rows) for c in range(columns)]
    places = np.array(grid[:beacons]) + rng.uniform(-5.0, 5.0, (beacons, 2))
    disc = np.array([(x, y) for x in range(-5, 6) for y in range(-5, 6) if x * x + y * y <= RADIUS_PX**2])
    parts: list[tuple[np.ndarray, ...]] = []
    for (x, y), payload in zip(places, payloads, strict=True):
        bits = list(kind.encode(payload)) * int(np.ceil(seconds * bit_rate / 11))
        at_us, levels = edges_of(bits, float(rng.uniform(0.0, 5_000.0)), 1e6 / bit_rate)
        each = rng.poisson(events_hz * inside * seconds / beacons / len(at_us), len(at_us))
        t = np.repeat(at_us, each) + DELAY_US + rng.exponential(TAIL_US, int(each.sum()))
        where = disc[rng.integers(0, len(disc), len(t))]
        parts.append((t, np.round(x) + where[:, 0], np.round(y) + where[:, 1], np.repeat(levels, each)))
    n = int(events_hz * (1.0 - inside) * seconds)
    edge = left - 24 if idle else left
    parts.append(
        (
            rng.uniform(0.0, seconds * 1e6, n),
            rng.integers(0, edge, n),
            rng.integers(0, HEIGHT, n),
            rng.random(n) < 0.5,
        )
    )
    t, xs, ys, on = (np.concatenate(column) for column in zip(*parts, strict=True))
    t_us = (np.ceil(t / scan_us) * scan_us if scan_us else t).astype(np.int64)
    order = np.argsort(t_us, kind="stable")
    order = order[t_us[order] < int(seconds * 1e6)]
    batch = EventBatch(t_us[order], xs[order].astype(np.uint16), ys[order].astype(np.uint16), on[order])
    if idle:
        across = int(np.ceil(np.sqrt(idle / 2)))
        spots = [
            (left + 30 + (k % across) * (left - 40) / across, 10 + (k // across) * (HEIGHT - 20) / (2 * across))
            for k in range(idle)
        ]
        places = np.concatenate([places, np.array(spots)])
    named = tuple(
        Beacon(name=f"b{payload}", protocol="seed11", payload=payload, bit_rate=bit_rate) for payload in payloads
    )
    return Corpus(batch, int(seconds * 1e6), places, named, 1.0 - n / max(len(batch), 1))
