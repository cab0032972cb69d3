"""Which links a site has, and the receivers of one track: a contest until one of them accepts an identity.

A *link* is what a receiver must know beforehand: protocol, bit rate, options. A track is heard by one receiver a link;
where the bit rate is to be measured, by one for each rate that is likely, and if none of them reads anything in a fair
time, the rate is measured again.
The first to accept wins, the others rest until it is lost; of two in one window the larger margin wins. A frame decided
during a contest cannot be attributed yet, so it is held, for `CONTEST_US` at most; where a site has one link alone
nothing is held.

Fast links (core_bit_rate and more) hear the core of the track's image alone (heliograph_services.decoder.routing): the
halo's edges come late, by a share of the bit that breaks the lock. Slow ones (heart_bit_rate and
less) hear its heart, where a lit target makes few events by moving; at 50 bit/s its motion drowns its edges. Those
between hear the whole: it is the number of events, and their spread over the scans of a slow sensor, that tell there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from heliograph.errors import ConfigError, Refusals
from heliograph.events import Flags, Times
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Modulation, Receiver, Text, Verdict
from heliograph.link.modulations import LISTED_ONLY, modulation, tried
from heliograph.site import Beacon
from heliograph.units import BIT_RATE_MIN
from heliograph_services.decoder.config import AUTO, DecoderConfig
from heliograph_services.decoder.measuring import Measure, Measuring
from heliograph_services.decoder.region_state import Depths
from heliograph_services.decoder.routing import CORE_OF, HEART_OF

# Four frames of 20 bits at 100 bit/s take 0.8 s: who has not accepted by then is not about to.
CONTEST_US: Final = 1_000_000
# 1 s of frames of 11 bits at 5 kbit/s are 455.
HELD_LIMIT: Final = 512
# A receiver that has given up is made anew after it, where the tracker still sees its target (paper: delay_max .5 s;
# longer, so that one that recovers by itself keeps what it has learned).
RETRY_US: Final = 2_000_000
# The longest frame of the stored codes (20 bits) and of text (11) is shorter; only the loss of slow links heeds it.
FRAME_BITS: Final = 20
LOSS_FRAMES: Final = 5
# What nobody has read in so many bits is not at these rates: a text needs 180, and a cold start may fail twice.
TRIAL_US: Final = 2_000_000
TRIAL_BITS: Final = 500
FOREVER_US: Final = 2**60

Options = tuple[tuple[str, str | int], ...]
ModulationOf = Callable[..., Modulation]


@dataclass(frozen=True, slots=True)
class LinkKey:
    """What distinguishes a link; bit_rate None is to be measured."""

    protocol: str
    bit_rate: float | None
    options: Options


@dataclass(frozen=True, slots=True)
class _Row:
    key: LinkKey
    modulation: Modulation
    receiver: str


class LinkPlan:
    """The links of a site, and the names of its beacons.

    Args:
        config: the decoder's settings.
        modulation_of: makes a modulation of its name and options.
        measure: names likely bit rates; None where none is to be measured.

    Raises:
        ConfigError: a modulation, an option, a payload or a receiver is unknown.
    """

    def __init__(
        self, config: DecoderConfig, modulation_of: ModulationOf = modulation, measure: Measure | None = None
    ) -> None:
        self.loss_us = config.loss_us
        self._core_bit_rate = config.core_bit_rate
        self._heart_bit_rate = config.heart_bit_rate
        self.measure = measure
        self.rows = [
            _Row(key, _modulation(modulation_of, key, config.beacons), config.receiver)
            for key in _keys(config.beacons, config)
        ]
        self._check_together(config)
        self._settle_receivers(config.receiver)
        self._names: dict[tuple[LinkKey, int | None], str] = {}
        for beacon in config.beacons:
            known = (_key_of(beacon), beacon.payload)
            # Two listed beacons that send the same cannot be told apart: they are called by what they send.
            self._names[known] = "" if known in self._names else beacon.name

    def _check_together(self, config: DecoderConfig) -> None:
        """Check what the beacons of one protocol must not be to each other, where a modulation has such a rule."""
        for row in self.rows:
            check = getattr(row.modulation, "check_beacons", None)
            alike = [(b.name, b.payload, b.bit_rate) for b in config.beacons if b.protocol == row.key.protocol]
            if check is None:
                continue
            try:
                check(alike, config.scan_rate_hz)
            except ValueError as error:
                raise ConfigError(str(error)) from None

    def _settle_receivers(self, wanted: str) -> None:
        """A modulation that lacks the wanted receiver uses its default, unless all lack it."""
        refused: list[str] = []
        for i, row in enumerate(self.rows):
            try:
                row.modulation.receiver(row.key.bit_rate or 1000.0, wanted)
            except ValueError as error:
                refused.append(str(error))
                self.rows[i] = _Row(row.key, row.modulation, "default")
        if len(refused) == len(self.rows):
            raise ConfigError(refused[0])

    def receiver(self, link: int, bit_rate: float | None) -> Receiver:
        """Return a new receiver of a link; bit_rate is the measured one, where the link has none."""
        row = self.rows[link]
        return row.modulation.receiver(row.key.bit_rate or bit_rate or 1000.0, row.receiver)

    def protocol(self, link: int) -> str:
        """Return the name of the link's modulation."""
        return self.rows[link].key.protocol

    def depth(self, link: int, bit_rate: float) -> int:
        """Return how deep in a track's image an event must lie for a link of that rate to hear it.

        Only our own receivers have been matched to a part of the image: others' rules are for all of a target's events.
        """
        if self.rows[link].receiver != "default":
            return 0
        if bit_rate <= self._heart_bit_rate:
            return HEART_OF
        return CORE_OF if bit_rate >= self._core_bit_rate else 0

    def loss_after_us(self, link: int, bit_rate: float) -> int:
        """Return how long an identity of the link lives without support: max(loss_us, 5 frames)."""
        return max(self.loss_us, self.frames_us(link, LOSS_FRAMES, bit_rate))

    def frames_us(self, link: int, n: int, bit_rate: float | None = None) -> int:
        """Return how long n frames of the link take at that rate; without one, at its nominal one."""
        bits = getattr(self.rows[link].modulation, "frame_bits", FRAME_BITS)
        rate = bit_rate or self.rows[link].key.bit_rate or BIT_RATE_MIN
        return round(n * bits / max(rate, 1.0) * 1e6)

    def listed(self, link: int, payload: int | None) -> str | None:
        """Return the name of the listed beacon that sends this payload on this link."""
        return self._names.get((self.rows[link].key, payload)) or None

    def token(self, link: int, payload: int | None) -> str | None:
        """Return what tells this identity from every other one that the site can read; None for text, which has none.

        PROTOCOL/PAYLOAD; where several links speak one protocol, their number follows the protocol's name.
        """
        if payload is None:
            return None
        protocol = self.rows[link].key.protocol
        alike = [i for i, row in enumerate(self.rows) if row.key.protocol == protocol]
        number = f".{alike.index(link)}" if len(alike) > 1 else ""
        return f"{protocol}{number}/{payload}"

    def name(self, link: int, payload: int | None) -> str:
        """Return what the beacon is called: its name, PROTOCOL:PAYLOAD, or PROTOCOL alone for text."""
        protocol = self.rows[link].key.protocol
        return self.listed(link, payload) or (protocol if payload is None else f"{protocol}:{payload}")


def _key_of(beacon: Beacon) -> LinkKey:
    return LinkKey(beacon.protocol, float(beacon.bit_rate), tuple(sorted(beacon.options.items())))


def _keys(beacons: tuple[Beacon, ...], config: DecoderConfig) -> list[LinkKey]:
    if beacons:
        return list(dict.fromkeys(_key_of(beacon) for beacon in beacons))
    rate = None if isinstance(config.bit_rate, str) else float(config.bit_rate)
    if rate is None and config.protocol in LISTED_ONLY:
        raise ConfigError(f"bit_rate must be a number with protocol {config.protocol}, not {config.bit_rate!r}")
    protocols = tried() if config.protocol == AUTO else [config.protocol]
    options = () if config.protocol == AUTO else tuple(sorted(config.options.items()))
    return [LinkKey(protocol, rate, options) for protocol in protocols]


def _modulation(modulation_of: ModulationOf, key: LinkKey, beacons: tuple[Beacon, ...]) -> Modulation:
    """Return the link's modulation.

    Payloads that a lamp can imitate are read where the site lists one of them, and where nothing is listed but the
    bit rate is given; a measured rate fits any lamp, so there they are refused.
    """
    options = dict(key.options)
    try:
        kind = modulation_of(key.protocol, **options)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    advice = getattr(kind, "advice", None)
    periodic = advice is not None and not beacons and key.bit_rate is not None
    for beacon in beacons:
        if _key_of(beacon) != key or beacon.payload is None:
            continue
        try:
            kind.encode(beacon.payload)
        except (ValueError, TypeError) as error:
            raise ConfigError(f"beacon {beacon.name}: {error}") from None
        periodic = periodic or (advice is not None and advice(beacon.payload) is not None)
    return modulation_of(key.protocol, **({"allow_periodic": 1} | options)) if periodic else kind


@dataclass(frozen=True, slots=True)
class Decided:
    """A frame or a text of a track, and the link it came by."""

    link: int
    item: LinkFrame | Text


@dataclass(frozen=True, slots=True)
class Accepted:
    """The identity that a track holds, and the link it came by."""

    link: int
    identity: Identity


@dataclass(slots=True)
class _Contender:
    link: int
    receiver: Receiver
    bit_rate: float
    counted: Refusals = field(default_factory=Refusals)
    held: list[LinkFrame | Text] = field(default_factory=list)
    invalid_since_us: int | None = None


class TrackLinks:
    """All receivers of one track.

    Args:
        plan: the links of the site.
    """

    def __init__(self, plan: LinkPlan) -> None:
        self._plan = plan
        self._contenders: list[_Contender] = []
        self._winner: _Contender | None = None
        self._refusals = Refusals()
        self._measuring = Measuring(plan.measure)
        self._rates: tuple[float, ...] = ()  # measured ones
        self._entered_us = 0  # since when they have been tried
        self.contested = 0  # windows in which two links accepted at once
        self.outvoted = 0  # frames of links that lost the contest
        if all(row.key.bit_rate is not None for row in plan.rows):
            self._enter(range(len(plan.rows)))

    def _enter(self, links: range | list[int]) -> None:
        for link in links:
            known = self._plan.rows[link].key.bit_rate
            for rate in self._rates if known is None else (known,):
                self._contenders.append(_Contender(link, self._plan.receiver(link, rate), rate))
        self._contenders.sort(key=lambda one: (one.link, one.bit_rate))

    def feed(self, t_us: Times, on: Flags, depth: Depths, until_us: int) -> list[Decided]:
        """Take the track's events before until_us (see Receiver.feed); return what is published of them.

        Args:
            t_us: (n,) int64.
            on: (n,) bool.
            depth: (n,) uint8, how deep in the track's image they lie (heliograph_services.decoder.routing).
            until_us: there are no more events before this time.
        """
        if not self._contenders:
            measured = self._measuring.feed(t_us, on, depth, until_us)
            if measured is None:
                return []
            self._rates, (t_us, on, depth) = measured
            self._entered_us = until_us
            self._enter(range(len(self._plan.rows)))
        for one in self._contenders:
            heard = depth >= self._plan.depth(one.link, one.bit_rate)
            one.held += one.receiver.feed(t_us[heard], on[heard], until_us)
            del one.held[:-HELD_LIMIT]
        return self._settle(until_us)

    def flush(self, now_us: int) -> list[Decided]:
        """Decide and return all that is held: the track's stream has ended."""
        for one in self._contenders:
            one.held += one.receiver.flush()
        return self._settle(now_us, hold_us=-FOREVER_US)

    def _settle(self, now_us: int, hold_us: int = CONTEST_US) -> list[Decided]:
        if self._winner is not None and not self._supported(self._winner, now_us):
            self._winner = None
            absent = [i for i in range(len(self._plan.rows)) if all(one.link != i for one in self._contenders)]
            self._entered_us = now_us
            self._enter(absent)
        elif self._winner is None:
            self._vote(now_us)
        self._renew(now_us)
        newest_us = now_us + 1 if len(self._contenders) == 1 else now_us - hold_us
        if self._hopeless(now_us):
            newest_us = now_us + 1
        out: list[Decided] = []
        for one in self._contenders:
            out += [Decided(one.link, item) for item in one.held if item.t_us <= newest_us]
            one.held = [item for item in one.held if item.t_us > newest_us]
        if self._hopeless(now_us):
            self._measure_anew()
        return out

    def _hopeless(self, now_us: int) -> bool:
        """Return whether nobody has read anything at the measured rates for long enough."""
        if self._winner is not None or not self._rates or not self._contenders:
            return False
        trial_us = max(TRIAL_US, round(TRIAL_BITS * 1e6 / min(self._rates)))
        if now_us - self._entered_us < trial_us:
            return False
        # A beacon that changes its payload with every frame is nobody's, and read.
        return all(one.receiver.verdict(now_us) != "valid" for one in self._contenders)

    def _measure_anew(self) -> None:
        for one in self._contenders:
            self._count(one)
        self._contenders, self._rates = [], ()

    def _vote(self, now_us: int) -> None:
        accepting = [one for one in self._contenders if self._supported(one, now_us)]
        if not accepting:
            return
        self._winner = max(accepting, key=lambda one: (_margin(one), -one.link))
        self.contested += len(accepting) > 1
        if self._rates:
            self._rates = (self._winner.bit_rate,)
        for one in self._contenders:
            if one is not self._winner:
                self._count(one)
                self.outvoted += len(one.held)
        self._contenders = [self._winner]

    def _renew(self, now_us: int) -> None:
        """Replace receivers that gave up long ago."""
        for one in self._contenders:
            if one.receiver.verdict(now_us) != "invalid":
                one.invalid_since_us = None
            elif one.invalid_since_us is None:
                one.invalid_since_us = now_us
            elif now_us - one.invalid_since_us >= RETRY_US:
                self._count(one)
                one.receiver = self._plan.receiver(one.link, one.bit_rate)
                one.counted = Refusals()
                one.invalid_since_us = None

    def _supported(self, one: _Contender, now_us: int) -> bool:
        identity = one.receiver.identity()
        if identity is None or one.receiver.verdict(now_us) == "invalid":
            return False
        return now_us - identity.t_us <= self._plan.loss_after_us(one.link, one.bit_rate)

    def accepted(self, now_us: int) -> Accepted | None:
        """Return the identity that the track holds at now_us."""
        if self._winner is None or not self._supported(self._winner, now_us):
            return None
        identity = self._winner.receiver.identity()
        return None if identity is None else Accepted(self._winner.link, identity)

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is: the best that any of its receivers says."""
        verdicts = {one.receiver.verdict(now_us) for one in self._contenders}
        if "valid" in verdicts:
            return "valid"
        return "invalid" if verdicts == {"invalid"} else "new"

    def quality(self, link: int, now_us: int) -> LinkQuality | None:
        """Return how well a link was read over the last second; None where its receiver rests."""
        for one in self._contenders:
            if one.link == link:
                return one.receiver.quality(now_us)
        return None

    def _count(self, one: _Contender) -> None:
        for reason, n in one.receiver.refusals.items():
            if n > one.counted[reason]:
                self._refusals[reason] += n - one.counted[reason]
                one.counted[reason] = n

    def take_refusals(self) -> Refusals:
        """Return what was refused since the last call."""
        for one in self._contenders:
            self._count(one)
        taken, self._refusals = self._refusals, Refusals()
        taken.update(self._measuring.refusals)
        self._measuring.refusals.clear()
        return taken


def _margin(one: _Contender) -> float:
    identity = one.receiver.identity()
    return 0.0 if identity is None else identity.margin
