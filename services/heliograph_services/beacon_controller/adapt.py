"""The closed loop: a beacon's bit rate goes up while it is read well, and comes down when the link fades.

The decoder tells of each track, once a second, the share of frames that it reads (`mar_estimate`), and whose track it
is (`ids`). On the ladder of rates between the limits, each twice the one below::

    up      after UP_S of links that all read at least GOOD of the frames, one rung
    down    at the first link that reads less than BAD, and after LOST_S without any, one rung
    barred  a rung that was left because it was read badly, or within TRIAL_S of its ascent, is not tried again for
            BAR_S, then for twice as long, ...

The decoder must be told to try the rates: the site lists the beacon once for each rung, the others without a uid and
called NAME.RATE (`crane`, `crane.500`, `crane.250`).

After a step nothing is judged for SETTLE_S: the decoder has to find the new rate. A rate that an operator sets is held
for HOLD_S. Who is not seen at all comes down to the lowest rate: that is the one which reaches farthest.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from heliograph.messages import Identification, Link, Message
from heliograph_services.beacon_controller.config import BeaconControllerConfig

# Of ten frames a second at the slowest, all were read three seconds on end.
GOOD: Final = 0.97
UP_S: Final = 3.0
# A message of several frames hardly gets through any more.
BAD: Final = 0.8
LOST_S: Final = 3.0
# An identification on a new rate takes some frames, and `link` tells of the second before.
SETTLE_S: Final = 2.5
TRIAL_S: Final = 10.0
BAR_S: Final = 20.0
BAR_MOST_S: Final = 600.0
HOLD_S: Final = 30.0


@dataclass(slots=True)
class _Loop:
    """What is known of one beacon's link."""

    good_since_s: float | None = None
    heard_s: float | None = None  # since when nothing was heard, once a rate has been chosen
    is_bad: bool = False
    settled_s: float = 0.0
    risen_s: float = -1e18
    barred: dict[float, tuple[float, float]] = field(default_factory=dict)  # rate -> until, for how long


class Adapter:
    """Chooses bit rates.

    Args:
        config: the limits.
    """

    def __init__(self, config: BeaconControllerConfig) -> None:
        rates = [config.adapt_min]
        while rates[-1] * 2 <= config.adapt_max:
            rates.append(rates[-1] * 2)
        self.ladder = tuple(rates)
        self._beacons: dict[tuple[str, str], str] = {}  # (camera, track) -> beacon
        self._loops: dict[str, _Loop] = {}

    def hold(self, name: str, now_s: float) -> None:
        """Leave a rate that an operator has set alone for a while."""
        self._loop(name, now_s).settled_s = now_s + HOLD_S

    def feed(self, message: Message, now_s: float) -> None:
        """Take note of who is on a track, and of how well it is read."""
        if isinstance(message, Identification):
            if message.lost:
                self._beacons.pop((message.camera, message.track), None)
            else:
                self._beacons[message.camera, message.track] = message.beacon.partition(".")[0]
        elif isinstance(message, Link):
            name = self._beacons.get((message.camera, message.track))
            if name is not None and message.mar_estimate is not None:
                self._judge(self._loop(name, now_s), message.mar_estimate, now_s)

    def rate(self, name: str, bit_rate: float, now_s: float) -> float:
        """Return the bit rate that a beacon is to have now; it may be the one that it has."""
        loop = self._loop(name, now_s)
        if now_s < loop.settled_s:
            loop.is_bad, loop.good_since_s, loop.heard_s = False, None, now_s
            return bit_rate
        rung = max((i for i, rate in enumerate(self.ladder) if rate <= bit_rate), default=0)
        if loop.is_bad or now_s - (loop.heard_s or now_s) > LOST_S:
            lower = self.ladder[rung - 1] if rung and bit_rate <= self.ladder[rung] else self.ladder[rung]
            return self._fall(loop, bit_rate, lower, now_s)
        if loop.good_since_s is None or now_s - loop.good_since_s < UP_S or rung + 1 >= len(self.ladder):
            return bit_rate
        higher = self.ladder[rung + 1]
        if loop.barred.get(higher, (0.0, 0.0))[0] > now_s:
            return bit_rate
        loop.risen_s = now_s
        loop.settled_s = now_s + SETTLE_S
        return higher

    def _fall(self, loop: _Loop, bit_rate: float, lower: float, now_s: float) -> float:
        if loop.is_bad or now_s - loop.risen_s < TRIAL_S + SETTLE_S:
            for_s = min(BAR_MOST_S, 2 * loop.barred.get(bit_rate, (0.0, BAR_S / 2))[1])
            loop.barred[bit_rate] = (now_s + for_s, for_s)
        loop.settled_s = now_s + SETTLE_S
        return min(bit_rate, lower)

    def _judge(self, loop: _Loop, share: float, now_s: float) -> None:
        loop.heard_s = now_s
        loop.is_bad = share < BAD
        if share < GOOD:
            loop.good_since_s = None
        elif loop.good_since_s is None:
            loop.good_since_s = now_s

    def _loop(self, name: str, now_s: float) -> _Loop:
        if name not in self._loops:
            self._loops[name] = _Loop(heard_s=now_s)
        return self._loops[name]
