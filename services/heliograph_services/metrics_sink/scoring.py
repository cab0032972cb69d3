"""How right a receiver is, second by second, where the truth is known (the definitions are in docs/metrics.md).

A published frame f and a sent frame s of the same protocol *match*, one to one, where::

    |t_f - t1_s| <= (t1_s - t0_s) / 2      and      |p_f - p_s(t_f)| <= max(5 px, radius of the blob)

with p_s(t_f) the beacon's place at the time that the published frame gives its own place for (at 50 bit/s and 100 px/s
it moves 11 px in half a frame); nearest in time first, then in place. A matched frame is right if its payload is the
one sent, else wrong; a published frame without a match is an insertion. A sent frame counts for MAR if it begins at
least max(0.5 s, 5 frames) after the beacon's visible (or viewed) interval, and for BAR in the same case.

Sent frames of one second of camera time are matched at a time; a published frame may match across the border. So the
counts depend on the messages, not on the order of their arrival.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import hypot
from typing import Final

from heliograph.accuracy import CLOSE_DIAMETERS, GATE_PX, GRACE_FRAMES, GRACE_US, HALF_LIMIT_US
from heliograph.link.modulations import TEXT
from heliograph.messages import Identification
from heliograph.site import Beacon
from heliograph.truth import Truth
from heliograph.units import US_PER_S
from heliograph_services.metrics_sink.presence import Presence, Presences
from heliograph_services.metrics_sink.slots import Slots

# Truth is looked up for identifications and insertions of the two seconds before the one being matched.
LOOKBACK_US: Final = 4 * US_PER_S

Count = Callable[[str, int], None]


@dataclass(slots=True)
class Received:
    """A published frame, and what became of it: matched or not."""

    t_us: int
    track: str
    protocol: str
    payload: int
    x_px: float
    y_px: float
    matched: bool = False

    @property
    def order(self) -> tuple[int, str, str, int, float, float]:
        """The order that does not depend on arrival."""
        return self.t_us, self.track, self.protocol, self.payload, self.x_px, self.y_px


@dataclass(frozen=True, slots=True)
class _Sent:
    """A sent frame with all that scoring needs of its beacon at that time."""

    beacon: str
    protocol: str
    t0_us: int
    t1_us: int
    payload: int
    x_px: float
    y_px: float
    gate_px: float
    visible: bool  # and late enough after it became so: counts for MAR_sent(visible) and BAR
    in_view: bool  # likewise
    close: bool

    @property
    def half_us(self) -> int:
        return min((self.t1_us - self.t0_us) // 2, HALF_LIMIT_US)


class Scorer:
    """The score of one camera's stream; seconds come in order, each once.

    Args:
        beacons: the site's list, for the bits of the frames.
    """

    def __init__(self, beacons: Iterable[Beacon] = ()) -> None:
        self.presences = Presences()
        self._listed = {beacon.name: beacon for beacon in beacons}
        self._slots: dict[tuple[str, str], Slots | None] = {}
        self._windows: list[Truth] = []
        self._ends: list[int] = []

    @property
    def has_truth(self) -> bool:
        """Return whether any truth has come."""
        return bool(self.presences.beacons)

    def match(self, truths: list[Truth], received: list[Received], count: Count) -> None:
        """Score the sent frames of one second.

        Args:
            truths: the second's windows, in order.
            received: published frames of it, the second before and the one after, in order of time; those that match
                are marked.
            count: takes the counts of this second.
        """
        sent: list[_Sent] = []
        for truth in truths:
            if self._ends and truth.t0_us > self._ends[-1]:
                count("truth_gap_us", truth.t0_us - self._ends[-1])
            self.presences.update(truth)
            sent += self._sent_in(truth)
            self._windows.append(truth)
            self._ends.append(truth.t1_us)
        if self._ends:
            old = bisect_left(self._ends, self._ends[-1] - LOOKBACK_US)
            del self._windows[:old], self._ends[:old]
        if sent:
            self._match(sent, received, count)

    def covers(self, t_us: int) -> bool:
        """Return whether the truth of an instant is known."""
        window, _ = self._window(t_us)
        return window is not None

    def judge(self, state: Identification, count: Count) -> None:
        """Score one state of an identification; the frames of its second must have been matched."""
        window, before = self._window(state.t_us)
        is_new = state.change in {"accepted", "changed"}
        if window is None:
            if is_new:
                count("unscored_identifications", 1)
            return
        near = self._near(state, window, before)
        right = [name for name in near if self._names(state, name)]
        if is_new:
            count("judged", 1)
            if not near:
                count("false_alarms", 1)
            elif not right:
                count("confusions", 1)
        for name in right:
            interval = self.presences.beacons[name].interval_at(state.t_us)
            if interval is None or interval.acquired_us is not None or interval.first_right_us is None:
                continue
            if interval.first_right_us <= state.t_us:
                interval.acquired_us, interval.changed = state.t_us - interval.began_us, True

    def _sent_in(self, truth: Truth) -> list[_Sent]:
        sent = []
        for i, at in enumerate(truth.frame_beacon):
            presence = self.presences.beacons.get(truth.beacon[at])
            t0_us, t1_us = truth.frame_t0_us[i], truth.frame_t1_us[i]
            if presence is None or not t0_us < t1_us:
                continue
            presence.payload = truth.frame_payload[i]
            x_px, y_px = truth.frame_x_px[i], truth.frame_y_px[i]
            visible = truth.frame_visible[i]
            sent.append(
                _Sent(
                    beacon=truth.beacon[at],
                    protocol=truth.protocol[at],
                    t0_us=t0_us,
                    t1_us=t1_us,
                    payload=truth.frame_payload[i],
                    x_px=x_px,
                    y_px=y_px,
                    gate_px=max(GATE_PX, truth.radius_px[at]),
                    visible=visible and _is_late_enough(_visible_since(presence, t0_us), t0_us, t1_us),
                    in_view=_is_late_enough(presence.viewed_since(t0_us), t0_us, t1_us),
                    close=_is_close(truth, at, x_px, y_px),
                )
            )
        return sent

    def _match(self, sent: list[_Sent], received: list[Received], count: Count) -> None:
        times = [frame.t_us for frame in received]
        pairs = []
        for i, frame in enumerate(sent):
            first = bisect_left(times, frame.t1_us - frame.half_us)
            last = bisect_right(times, frame.t1_us + frame.half_us)
            for j in range(first, last):
                other = received[j]
                x_px, y_px = self._place(frame.beacon, other.t_us) or (frame.x_px, frame.y_px)
                away_px = hypot(other.x_px - x_px, other.y_px - y_px)
                if other.protocol == frame.protocol and not other.matched and away_px <= frame.gate_px:
                    pairs.append((abs(other.t_us - frame.t1_us), away_px, i, j))
        partner: dict[int, Received] = {}
        for _, _, i, j in sorted(pairs):
            if i not in partner and not received[j].matched:
                received[j].matched = True
                partner[i] = received[j]
        for i, frame in enumerate(sent):
            self._score(frame, partner.get(i), count)

    def _score(self, frame: _Sent, got: Received | None, count: Count) -> None:
        is_right = got is not None and got.payload == frame.payload
        if got is not None:
            count(f"{'right' if is_right else 'wrong'}/{frame.protocol}", 1)
        if frame.visible and frame.protocol in TEXT:
            outcome = () if got is None else ("right_text" if is_right else "wrong_text",)
            for name in ("sent_text", *outcome):
                count(f"{name}/{frame.protocol}", 1)
        if is_right:
            self._note_right(frame)
        classes = [
            name
            for name, counts in (
                ("visible", frame.visible),
                ("in_view", frame.in_view),
                ("close", frame.visible and frame.close),
            )
            if counts
        ]
        for name in classes:
            count(f"sent_{name}/{frame.beacon}", 1)
            if is_right:
                count(f"right_{name}/{frame.beacon}", 1)
            elif got is not None:
                count(f"wrong_{name}/{frame.beacon}", 1)
        if frame.visible:
            self._count_bits(frame, got, count)

    def _count_bits(self, frame: _Sent, got: Received | None, count: Count) -> None:
        count(f"visible_us/{frame.beacon}", frame.t1_us - frame.t0_us)
        slots = self._slots_of(frame.beacon, frame.protocol)
        word = slots.word(frame.payload) if slots is not None else None
        if slots is None or word is None:
            return
        count(f"bits_visible/{frame.beacon}", len(word))
        count(f"bits_chance_milli/{frame.beacon}", round(1000 * slots.chance(frame.payload)))
        if got is not None:
            count(f"bits_matched/{frame.beacon}", len(word))
            count(f"bits_right/{frame.beacon}", slots.right(frame.payload, got.payload))
            if got.payload == frame.payload:
                count(f"payload_bits/{frame.beacon}", slots.payload_bits)

    def _note_right(self, frame: _Sent) -> None:
        interval = self.presences.beacons[frame.beacon].interval_at(frame.t0_us)
        if interval is not None and interval.first_right_us is None:
            interval.first_right_us = frame.t1_us

    def _slots_of(self, beacon: str, protocol: str) -> Slots | None:
        if (beacon, protocol) not in self._slots:
            listed = self._listed.get(beacon)
            if listed is None or listed.protocol != protocol:
                # An unlisted beacon of the truth: all such share the words of the protocol's defaults.
                listed = Beacon(name="unlisted", protocol=protocol, bit_rate=1000.0)
            try:
                self._slots[beacon, protocol] = Slots(listed)
            except (ValueError, ImportError):
                self._slots[beacon, protocol] = None
        return self._slots[beacon, protocol]

    def _window(self, t_us: int) -> tuple[Truth | None, Truth | None]:
        """Return the window that holds an instant, and the one before it where they join."""
        i = bisect_left(self._ends, t_us)
        if i == len(self._ends) or self._windows[i].t0_us > t_us:
            return None, None
        joins = i > 0 and self._windows[i - 1].t1_us == self._windows[i].t0_us
        return self._windows[i], self._windows[i - 1] if joins else None

    def _place(self, beacon: str, t_us: int) -> tuple[float, float] | None:
        """Return where a beacon was at a time, or None where the truth of that time is not known."""
        window, before = self._window(t_us)
        if window is None or beacon not in window.beacon:
            return None
        return _between(window, before, window.beacon.index(beacon), t_us)

    def _near(self, state: Identification, window: Truth, before: Truth | None) -> list[str]:
        """Return the beacons in view at the place of an identification."""
        near = []
        for i, name in enumerate(window.beacon):
            x_px, y_px = _between(window, before, i, state.t_us)
            is_near = hypot(state.x_px - x_px, state.y_px - y_px) <= max(GATE_PX, window.radius_px[i])
            if window.in_view[i] and is_near and name in self.presences.beacons:
                near.append(name)
        return near

    def _names(self, state: Identification, beacon: str) -> bool:
        """Return whether an identification means this beacon: by its name, or by protocol and payload."""
        if state.beacon == beacon:
            return True
        presence = self.presences.beacons[beacon]
        is_listed = state.beacon in self._listed or state.beacon in self.presences.beacons
        return (
            not is_listed
            and state.payload is not None
            and state.protocol == presence.protocol
            and state.payload == presence.payload
        )


def _between(window: Truth, before: Truth | None, i: int, t_us: int) -> tuple[float, float]:
    """Return where beacon i of a window was at a time in it: on a straight line from its place in the window before."""
    x_px, y_px = window.x_px[i], window.y_px[i]
    span = window.t1_us - window.t0_us
    if before is None or span == 0 or window.beacon[i] not in before.beacon:
        return x_px, y_px
    was = i if before.beacon[i : i + 1] == [window.beacon[i]] else before.beacon.index(window.beacon[i])
    share = (t_us - window.t0_us) / span
    return before.x_px[was] + share * (x_px - before.x_px[was]), before.y_px[was] + share * (y_px - before.y_px[was])


def _visible_since(presence: Presence, t_us: int) -> int | None:
    interval = presence.interval_at(t_us)
    return None if interval is None else interval.began_us


def _is_late_enough(since_us: int | None, t0_us: int, t1_us: int) -> bool:
    return since_us is not None and t0_us - since_us >= max(GRACE_US, GRACE_FRAMES * (t1_us - t0_us))


def _is_close(truth: Truth, at: int, x_px: float, y_px: float) -> bool:
    for i in range(len(truth.beacon)):
        if i == at or not truth.in_view[i]:
            continue
        diameter_px = 2.0 * max(truth.radius_px[i], truth.radius_px[at])
        if hypot(truth.x_px[i] - x_px, truth.y_px[i] - y_px) <= CLOSE_DIAMETERS * diameter_px:
            return True
    return False
