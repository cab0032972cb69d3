"""The receivers of one track: a contest until one of them accepts an identity.

A track is heard by one receiver a link (heliograph_services.decoder.link_plan);
where the bit rate is to be measured, by one for each rate that is likely, and if none of them reads anything in a fair
time, the rate is measured again.
The first to accept wins, the others rest until it is lost; of two in one window the larger margin wins. A frame decided
during a contest cannot be attributed yet, so it is held, for `CONTEST_US` at most; where a site has one link alone
nothing is held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import msgspec

from heliograph.errors import Refusals
from heliograph.events import Flags, Times
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Receiver, Text, Verdict
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.measuring import Measuring
from heliograph_services.decoder.region_state import Depths

# Four frames of 20 bits at 100 bit/s take 0.8 s: who has not accepted by then is not about to.
CONTEST_US: Final = 1_000_000
# 1 s of frames of 11 bits at 5 kbit/s are 455.
HELD_LIMIT: Final = 512
# A receiver that has given up is made anew after it, where the tracker still sees its target (paper: delay_max .5 s;
# longer, so that one that recovers by itself keeps what it has learned).
RETRY_US: Final = 2_000_000
# What nobody has read in so many bits is not at these rates: a text needs 180, and a cold start may fail twice.
TRIAL_US: Final = 2_000_000
TRIAL_BITS: Final = 500
FOREVER_US: Final = 2**60


class Decided(msgspec.Struct, frozen=True):
    """A frame or a text of a track, and the link it came by."""

    link: int
    item: LinkFrame | Text


class Accepted(msgspec.Struct, frozen=True):
    """The identity that a track holds, and the link it came by."""

    link: int
    identity: Identity


@dataclass(slots=True)
class _Contender:
    link: int
    receiver: Receiver
    bit_rate: float
    depth: int  # what it hears of an image
    loss_us: int  # how long an identity lives without support
    due_us: Callable[[], int] | None  # of a receiver that says when it is due
    counted: Refusals = field(default_factory=Refusals)
    refused: int = 0  # their sum
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
        self.winner: _Contender | None = None  # whose identity the track holds
        self._found: tuple[int, Accepted] | None = None  # what `accepted` returns at one time
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
                self._contenders.append(_contender(self._plan, link, rate))
        self._contenders.sort(key=lambda one: (one.link, one.bit_rate))

    def feed(self, t_us: Times, on: Flags, depth: Depths, until_us: int, least: int = 0) -> list[Decided]:
        """Take the track's events before until_us (see Receiver.feed); return what is published of them.

        Args:
            t_us: (n,) int64.
            on: (n,) bool.
            depth: (n,) uint8, how deep in the track's image they lie (heliograph_services.decoder.routing).
            until_us: there are no more events before this time.
            least: all of them lie so deep, and no others are left out that a receiver would hear (`least`).
        """
        self._found = None
        if not self._contenders:
            measured = self._measuring.feed(t_us, on, depth, until_us)
            if measured is None:
                return []
            self._rates, (t_us, on, depth) = measured
            self._entered_us = until_us
            self._enter(range(len(self._plan.rows)))
        for one in self._contenders:
            if one.depth > least:
                heard = depth >= one.depth
                one.held += one.receiver.feed(t_us[heard], on[heard], until_us)
            else:
                one.held += one.receiver.feed(t_us, on, until_us)
            if len(one.held) > HELD_LIMIT:
                del one.held[:-HELD_LIMIT]
        return self._settle(until_us)

    def least(self) -> int:
        """Return how deep in the track's image an event must lie for any of its receivers to hear it."""
        contenders = self._contenders
        if len(contenders) == 1:
            return contenders[0].depth
        return min((one.depth for one in contenders), default=0)

    def due_us(self) -> int:
        """Return from when on a feed may decide something that should not wait: as far as is known now.

        While links contend for the track, what they decide is held anyway. A receiver that does not say when it is due
        (`heliograph.link.contract.Punctual`) is due at once while it reads.
        """
        if len(self._contenders) != 1:
            return FOREVER_US
        one = self._contenders[0]
        if one.due_us is not None:
            return one.due_us()
        return FOREVER_US if one.receiver.identity() is None else 0

    def flush(self, now_us: int) -> list[Decided]:
        """Decide and return all that is held: the track's stream has ended."""
        self._found = None
        for one in self._contenders:
            one.held += one.receiver.flush()
        return self._settle(now_us, hold_us=-FOREVER_US)

    def _settle(self, now_us: int, hold_us: int = CONTEST_US) -> list[Decided]:
        winner = self.winner
        if winner is not None and (identity := self._supported(winner, now_us)) is not None:
            # The usual case: nobody else contends, nothing is held back, and a receiver that is read is not renewed.
            self._found = now_us, Accepted(winner.link, identity)
            winner.invalid_since_us = None
            return self._told(winner)
        if winner is not None:
            self.winner = None
            absent = [i for i in range(len(self._plan.rows)) if all(one.link != i for one in self._contenders)]
            self._entered_us = now_us
            self._enter(absent)
        else:
            self._vote(now_us)
        self._renew(now_us)
        if len(self._contenders) == 1 and (self.winner is not None or not self._rates):
            return self._told(self._contenders[0])
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

    def _told(self, one: _Contender) -> list[Decided]:
        """Return all that a receiver has decided."""
        if not one.held:
            return []
        told, one.held = one.held, []
        return [Decided(one.link, item) for item in told]

    def _hopeless(self, now_us: int) -> bool:
        """Return whether nobody has read anything at the measured rates for long enough."""
        if self.winner is not None or not self._rates or not self._contenders:
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
        accepting = [one for one in self._contenders if self._supported(one, now_us) is not None]
        if not accepting:
            return
        self.winner = max(accepting, key=lambda one: (_margin(one), -one.link))
        self.contested += len(accepting) > 1
        if self._rates:
            self._rates = (self.winner.bit_rate,)
        for one in self._contenders:
            if one is not self.winner:
                self._count(one)
                self.outvoted += len(one.held)
        self._contenders = [self.winner]

    def _renew(self, now_us: int) -> None:
        """Replace receivers that gave up long ago."""
        for one in self._contenders:
            if one.receiver.verdict(now_us) != "invalid":
                one.invalid_since_us = None
            elif one.invalid_since_us is None:
                one.invalid_since_us = now_us
            elif now_us - one.invalid_since_us >= RETRY_US:
                self._count(one)
                fresh = _contender(self._plan, one.link, one.bit_rate)
                one.receiver, one.due_us = fresh.receiver, fresh.due_us
                one.counted, one.refused = fresh.counted, 0
                one.invalid_since_us = None

    def _supported(self, one: _Contender, now_us: int) -> Identity | None:
        """Return the identity that a receiver holds, if it still counts."""
        identity = one.receiver.identity()
        if identity is None or now_us - identity.t_us > one.loss_us or one.receiver.verdict(now_us) == "invalid":
            return None
        return identity

    def accepted(self, now_us: int) -> Accepted | None:
        """Return the identity that the track holds at now_us."""
        if self.winner is None:
            return None
        if self._found is not None and self._found[0] == now_us:
            return self._found[1]
        identity = self._supported(self.winner, now_us)
        return None if identity is None else Accepted(self.winner.link, identity)

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
        one.refused = sum(one.receiver.refusals.values())
        for reason, n in one.receiver.refusals.items():
            if n > one.counted[reason]:
                self._refusals[reason] += n - one.counted[reason]
                one.counted[reason] = n

    def take_refusals(self) -> Refusals:
        """Return what was refused since the last call."""
        for one in self._contenders:
            if sum(one.receiver.refusals.values()) != one.refused:
                self._count(one)
        measured = self._measuring.refusals
        if not self._refusals and not measured:
            return self._refusals
        taken, self._refusals = self._refusals, Refusals()
        taken.update(measured)
        measured.clear()
        return taken


def _contender(plan: LinkPlan, link: int, bit_rate: float) -> _Contender:
    """Return a new contender, with what does not change as it goes on."""
    receiver = plan.receiver(link, bit_rate)
    # Not isinstance(..., Punctual): that takes half a millisecond of each birth.
    due_us: Callable[[], int] | None = getattr(receiver, "due_us", None)
    loss_us = plan.loss_after_us(link, bit_rate)
    return _Contender(link, receiver, bit_rate, plan.depth(link, bit_rate), loss_us, due_us)


def _margin(one: _Contender) -> float:
    identity = one.receiver.identity()
    return 0.0 if identity is None else identity.margin
