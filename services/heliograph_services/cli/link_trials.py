"""Trials of receivers on single lights: what was sent, what was read of it, and its score (docs/metrics.md).

A trial is one light of one section (protocol and bit rate) in one condition, made from a seed. Frames count from
max(0.5 s, 5 frames) on. A cyclic code repeats one payload, drawn by the seed, since the paper's receiver finds a word
by its rotations and cannot follow a payload that changes; every receiver's frames are decided on their own bits all
the same. Text is drawn character by character, with idle time here and there. Counts are kept for each second, so
that intervals can be had by bootstrap over runs and seconds.
"""

from __future__ import annotations

import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import astuple, dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from heliograph.link.contract import LinkFrame, Receiver, Text
from heliograph.link.modulations import modulation
from heliograph.link.uart_layout import CHARACTER_BITS, character_bits
from heliograph.site import Beacon
from heliograph.units import US_PER_S, bit_us
from heliograph_services.cli.link_light import CLOCK_PPM, Damage, Seen, watch
from heliograph_services.metrics_sink.slots import Slots

GRACE_US: Final = 500_000
GRACE_FRAMES: Final = 5
# The decoder's window: what a receiver is fed at a time.
FEED_US: Final = 5_000
# Of characters, one in ten is followed by 1 to 5 bits of idle time.
IDLE_SHARE: Final = 0.1
IDLE_BITS: Final = 5
# A receiver that has given up is made anew after it, as the decoder does it.
RETRY_US: Final = 2_000_000

Make = Callable[[], Receiver]


@dataclass(frozen=True, slots=True)
class Section:
    """A protocol at a bit rate, and a blob of so many pixels."""

    protocol: str
    bit_rate: float
    pixels: int

    @property
    def name(self) -> str:
        """As shown."""
        return f"{self.protocol} at {self.bit_rate:g} bit/s"


@dataclass(frozen=True, slots=True)
class Sent:
    """A frame that was sent."""

    t0_us: float
    t1_us: float
    payload: int


@dataclass(frozen=True, slots=True)
class Trial:
    """A light's events, and its frames in order of time."""

    seen: Seen
    frames: list[Sent]


@dataclass(slots=True)
class Counts:
    """What became of the frames that begin in one second; inserted: published ones that match none."""

    sent: int = 0
    right: int = 0
    wrong: int = 0
    inserted: int = 0
    bits: int = 0
    bits_matched: int = 0
    bits_right: int = 0
    chance: float = 0.0
    sent_us: float = 0.0


@dataclass(slots=True)
class Scored:
    """Counts by second of one run, and the processor time that reading took."""

    seconds: dict[int, Counts] = field(default_factory=dict)
    cpu_s: float = 0.0
    camera_s: float = 0.0


def make_trial(section: Section, damage: Damage, seconds: float, seed: int) -> Trial:
    """Return the trial of a seed."""
    rng = np.random.Generator(np.random.Philox(key=[seed, 7]))
    bit = bit_us(section.bit_rate) * (1.0 + rng.uniform(-CLOCK_PPM, CLOCK_PPM) * 1e-6)
    t0_us = float(rng.uniform(0.0, CHARACTER_BITS * bit))
    until_us = seconds * US_PER_S
    bits, frames = (
        _text(t0_us, bit, until_us, rng)
        if section.protocol == "uart"
        else _word(section.protocol, t0_us, bit, until_us, rng)
    )
    return Trial(watch(bits, t0_us, bit, section.pixels, damage, rng), frames)


def _word(
    protocol: str, t0_us: float, bit: float, until_us: float, rng: np.random.Generator
) -> tuple[list[int], list[Sent]]:
    link = modulation(protocol)
    payload = int(rng.choice(sendable(protocol)))
    word = link.encode(payload)
    n = max(1, int((until_us - t0_us) / (len(word) * bit)))
    ends = t0_us + np.arange(n + 1) * len(word) * bit
    return list(word) * n, [Sent(a, b, payload) for a, b in pairwise(ends.tolist())]


def sendable(protocol: str) -> list[int]:
    """Return the payloads of a cyclic code that neither another word nor a lamp can imitate."""
    code = modulation(protocol).code  # type: ignore[attr-defined]  # cyclic ones have it
    return [payload for payload in range(len(code.words)) if payload not in code.twins.keys() | code.periodic]


def _text(t0_us: float, bit: float, until_us: float, rng: np.random.Generator) -> tuple[list[int], list[Sent]]:
    bits = [1] * CHARACTER_BITS
    frames = []
    while (at := t0_us + len(bits) * bit) + CHARACTER_BITS * bit <= until_us:
        code = int(rng.integers(32, 127))
        bits += character_bits(code)
        frames.append(Sent(at, at + CHARACTER_BITS * bit, code))
        if rng.random() < IDLE_SHARE:
            bits += [1] * int(rng.integers(1, IDLE_BITS + 1))
    return [*bits, *[1] * CHARACTER_BITS], frames


def hear(receiver: Receiver, seen: Seen, step_us: int = FEED_US) -> tuple[list[LinkFrame], float]:
    """Return the frames of a receiver that is fed as the decoder feeds it, and the processor seconds it took."""
    bounds = [*range(step_us, seen.until_us, step_us), seen.until_us]
    cuts = np.searchsorted(seen.t_us, bounds).tolist()
    out: list[LinkFrame | Text] = []
    before, start = 0, time.thread_time()
    for until_us, at in zip(bounds, cuts, strict=True):
        out += receiver.feed(seen.t_us[before:at], seen.on[before:at], until_us)
        before = at
    out += receiver.flush()
    return [item for item in out if isinstance(item, LinkFrame)], time.thread_time() - start


def score(trial: Trial, read: list[LinkFrame], slots: Slots) -> dict[int, Counts]:
    """Return the counts of each second.

    Args:
        trial: what was sent.
        read: what was published.
        slots: the words of the protocol.
    """
    grace_us = max(GRACE_US, GRACE_FRAMES * (trial.frames[0].t1_us - trial.frames[0].t0_us)) if trial.frames else 0.0
    partner, left = matched(trial.frames, read)
    seconds: dict[int, Counts] = {}
    for i, frame in enumerate(trial.frames):
        if frame.t0_us < grace_us:
            continue
        counts = seconds.setdefault(int(frame.t0_us // US_PER_S), Counts())
        word = slots.word(frame.payload) or ()
        counts.sent += 1
        counts.sent_us += frame.t1_us - frame.t0_us
        counts.bits += len(word)
        counts.chance += slots.chance(frame.payload)
        got = partner.get(i)
        if got is None:
            continue
        counts.right += got.payload == frame.payload
        counts.wrong += got.payload != frame.payload
        counts.bits_matched += len(word)
        counts.bits_right += slots.right(frame.payload, got.payload)
    for other in left:
        if other.t_us >= grace_us and (second := int(other.t_us // US_PER_S)) in seconds:
            seconds[second].inserted += 1
    return seconds


def matched(sent: list[Sent], read: list[LinkFrame]) -> tuple[dict[int, LinkFrame], list[LinkFrame]]:
    """Return the published frame of each sent one (nearest first, within half a frame), and those left over."""
    read = sorted(read, key=lambda frame: frame.t_us)
    times = [frame.t_us for frame in read]
    pairs: list[tuple[float, int, int]] = []
    for i, frame in enumerate(sent):
        half = (frame.t1_us - frame.t0_us) / 2
        near = range(bisect_left(times, frame.t1_us - half), bisect_right(times, frame.t1_us + half))
        pairs += [(abs(times[j] - frame.t1_us), i, j) for j in near]
    partner: dict[int, LinkFrame] = {}
    taken: set[int] = set()
    for _, i, j in sorted(pairs):
        if i not in partner and j not in taken:
            partner[i] = read[j]
            taken.add(j)
    return partner, [frame for j, frame in enumerate(read) if j not in taken]


def slots_of(section: Section) -> Slots:
    """Return the words of a section's protocol."""
    return Slots(Beacon(name="light", protocol=section.protocol, bit_rate=section.bit_rate))


def run_trial(trial: Trial, make: Make, slots: Slots, step_us: int = FEED_US) -> Scored:
    """Return the score of a fresh receiver on a trial."""
    frames, cpu_s = hear(make(), trial.seen, step_us)
    return Scored(score(trial, frames, slots), cpu_s, trial.seen.until_us / US_PER_S)


def blocks_of(runs: list[Scored]) -> dict[str, np.ndarray]:
    """Return the counts of all runs' seconds, one array of (k,) a name."""
    names = Counts.__slots__
    rows = [astuple(counts) for run in runs for _, counts in sorted(run.seconds.items())]
    columns = np.array(rows, np.float64).reshape(-1, len(names)).T
    return dict(zip(names, columns, strict=True))


@dataclass(frozen=True, slots=True)
class Alarms:
    """What a receiver said of a light that sends nothing of its protocol."""

    seconds: float
    frames: int
    identities: int
    cpu_s: float


# Lights that are no beacons: noise alone; random bits at the right rate; mains lamps.
NO_BEACONS: Final = ("noise", "random bits", "lamp 100 Hz", "lamp 120 Hz")


def no_beacon(kind: str, section: Section, seconds: float, seed: int) -> Seen:
    """Return the events of a light that is no beacon, of `NO_BEACONS`.

    Raises:
        ValueError: it is none of these.
    """
    rng = np.random.Generator(np.random.Philox(key=[seed, 8]))
    if kind == "noise":
        return watch([1], seconds * US_PER_S, 1.0, 1, Damage(noise_hz=10_000.0, dropped=1.0), rng)
    if kind == "random bits":
        bit = bit_us(section.bit_rate)
        bits = rng.integers(0, 2, int(seconds * section.bit_rate)).tolist()
    elif kind in NO_BEACONS:
        bit = US_PER_S / 2.0 / float(kind.split()[1])
        bits = [0, 1] * int(seconds * US_PER_S / bit / 2)
    else:
        raise ValueError(f"a light that is no beacon must be one of {', '.join(NO_BEACONS)}, not {kind!r}")
    return watch(bits, float(rng.uniform(0.0, bit)), bit, section.pixels, Damage(noise_hz=100.0), rng)


def alarms(make: Make, seen: Seen) -> Alarms:
    """Return what a receiver, made anew where it has given up, says of such a light."""
    receiver, invalid_us, told = make(), None, None
    frames = identities = before = 0
    start = time.thread_time()
    for until_us in [*range(FEED_US, seen.until_us, FEED_US), seen.until_us]:
        at = int(np.searchsorted(seen.t_us, until_us))
        found = receiver.feed(seen.t_us[before:at], seen.on[before:at], until_us)
        before = at
        frames += sum(isinstance(item, LinkFrame) for item in found)
        identity = receiver.identity()
        now = None if identity is None else (identity.payload, identity.since_us)
        identities += now is not None and now != told
        told = now
        if receiver.verdict(until_us) != "invalid":
            invalid_us = None
        elif invalid_us is None:
            invalid_us = until_us
        elif until_us - invalid_us >= RETRY_US:
            receiver, invalid_us = make(), None
    return Alarms(seen.until_us / US_PER_S, frames, identities, time.thread_time() - start)
