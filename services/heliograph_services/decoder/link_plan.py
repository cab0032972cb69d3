"""Which links a site has, how each is heard, and what the beacons are called that they read.

A *link* is what a receiver must know beforehand: protocol, bit rate, options. Listed beacons name the links of a site;
without one, the settings do: one protocol or all, at one bit rate or at one that is measured.

Fast links (core_bit_rate and more) hear the core of the track's image alone (heliograph_services.decoder.routing): the
halo's edges come late, by a share of the bit that breaks the lock. Slow ones (heart_bit_rate and less) hear its heart,
where a lit target makes few events by moving; at 50 bit/s its motion drowns its edges. Those between hear the whole: it
is the number of events, and their spread over the scans of a slow sensor, that tell there. Protocols that live on few
and sharp edges (pulses, gaps, packets of words all over the band) hear the whole sooner, from `SHARP_BIT_RATE` on.
Text hears the whole however fast it is: its receiver learns what the halo adds to the bits after a change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from heliograph.errors import ConfigError
from heliograph.link.contract import Modulation, Receiver
from heliograph.link.modulations import LISTED_ONLY, modulation, tried
from heliograph.site import Beacon
from heliograph.units import BIT_RATE_MIN
from heliograph_services.decoder.config import AUTO, DecoderConfig
from heliograph_services.decoder.measuring import Measure
from heliograph_services.decoder.routing import CORE_OF, HEART_OF

# The longest frame of the stored codes (20 bits) and of text (11) is shorter; only the loss of slow links heeds it.
FRAME_BITS: Final = 20
LOSS_FRAMES: Final = 5
# Words of lit and dark bits, which a moving light's own events can be taken for; of codes, which are read scan by scan
# where bits are short, up to twice the rate: at 2 kbit/s and 2 m/s the heart reads .998, the whole .98 (5 m) and .92
# (16 m). Standing still at 2.5 kbit/s it is .97 and 1.00: beyond 2 kbit/s the number of events tells.
OF_LEVELS: Final = {"seed11": 2.0, "code": 2.0, "uart": 1.0}
# At 1 kbit/s and 160 px/s pulse_interval reads 1.00 with the whole image and .44 with its heart, packet 1.00 and .21.
SHARP_BIT_RATE: Final = 100.0
# At 3125 bit/s and 2 m/s the core errs in .020 (5 m) and .006 (16 m) of the characters, the whole in .0015 and .002.
NEVER_CORE: Final = ("uart",)

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
        # By link as well: asked at every frame.
        self._listed: list[dict[int | None, str]] = [
            {payload: name for (key, payload), name in self._names.items() if key == row.key and name}
            for row in self.rows
        ]

    def _check_together(self, config: DecoderConfig) -> None:
        """Check what the beacons of one protocol must not be to each other, where a modulation has such a rule."""
        for row in self.rows:
            check = getattr(row.modulation, "check_beacons", None)
            alike = [(b.name, b.payload, b.bit_rate) for b in config.beacons if b.protocol == row.key.protocol]
            if check is None:
                continue
            if not alike and row.key.bit_rate is not None:
                # Of blinking lights the bit rate is the payload: twice the frequency.
                hz = round(row.key.bit_rate / 2.0)
                alike = [(f"{row.key.protocol}:{hz}", hz, 2.0 * hz)]
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
        share = OF_LEVELS.get(self.protocol(link))
        heart = min(self._heart_bit_rate, SHARP_BIT_RATE) if share is None else share * self._heart_bit_rate
        if bit_rate <= heart:
            return HEART_OF
        return CORE_OF if bit_rate >= self._core_bit_rate and self.protocol(link) not in NEVER_CORE else 0

    def loss_after_us(self, link: int, bit_rate: float) -> int:
        """Return how long an identity of the link lives without support: max(loss_us, 5 frames)."""
        return max(self.loss_us, self.frames_us(link, LOSS_FRAMES, bit_rate))

    def frames_us(self, link: int, n: int, bit_rate: float | None = None) -> int:
        """Return how long n frames of the link take at that rate; without one, at its nominal one."""
        bits = getattr(self.rows[link].modulation, "frame_bits", FRAME_BITS)
        rate = bit_rate or self.rows[link].key.bit_rate or BIT_RATE_MIN
        return round(n * bits / max(rate, 1.0) * 1e6)

    def word_us(self, link: int) -> tuple[float, float]:
        """Return how long a word of the link and a bit of it last, where words follow each other without a pause.

        That is so with cyclic codes; (0, 0) for other links, and where the bit rate is not known beforehand.
        """
        code = getattr(self.rows[link].modulation, "code", None)
        rate = self.rows[link].key.bit_rate
        return (code.bits * 1e6 / rate, 1e6 / rate) if code is not None and rate is not None else (0.0, 0.0)

    def listed(self, link: int, payload: int | None) -> str | None:
        """Return the name of the listed beacon that sends this payload on this link."""
        return self._listed[link].get(payload)

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

    Payloads that a lamp can imitate are believed where the site lists one of them, and read, but no identity, where
    nothing is listed but the bit rate is given; a measured rate fits any lamp, so there they are refused.
    """
    options = dict(key.options)
    try:
        kind = modulation_of(key.protocol, **options)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    advice = getattr(kind, "advice", None)
    is_read = advice is not None and not beacons and key.bit_rate is not None
    is_listed = False
    for beacon in beacons:
        if _key_of(beacon) != key or beacon.payload is None:
            continue
        try:
            kind.encode(beacon.payload)
        except (ValueError, TypeError) as error:
            raise ConfigError(f"beacon {beacon.name}: {error}") from None
        is_listed = is_listed or (advice is not None and advice(beacon.payload) is not None)
    if not (is_listed or is_read):
        return kind
    return modulation_of(key.protocol, **({"periodic": "believed" if is_listed else "read"} | options))
