"""Which tracks are published as identified, and as what: accepted, changed, refreshed, lost; and their texts.

A track's receivers say what they have read, and for how long it counts (`TrackLinks.accepted`). What is published says
besides where the beacon is, and that there is one. So an identity is *withheld* from a track

- whose place is not known any more: the region has not been centred on its own events for `BLIND_US`, and lies off the
  sensor with all it hears; or nothing has been read for `STALE_FRAMES` frames either, and its centre is off the
  sensor, or its doubt is beyond what it can hear, 3 sqrt(P_xx) > r + GROW_LIMIT_PX (region_state);
- which another one has left behind: that has read the same payload on the same link for `STALE_FRAMES` frames since;
- on the spot of another one that reads the same: one light is one beacon. What is held already, then the larger margin,
  keeps it.

Two that both read one payload at two places are two beacons of one payload: both keep it, and each is told with the
name of the other (heliograph_services.decoder.duplicates). Texts have no payload:
only the first rule is theirs. An identity that is withheld is published as lost, once; with the next frame that
supports it, it is accepted again, unless a reason still stands.

A payload that is held is told again and again with the place of its region, but not where that may be another's: while
a frame of another payload has been read since, or none of its own for `UNSURE_FRAMES` frames though the region hears
light, or its place is not known for sure. Where two lights cross, a region may follow the wrong one until its code is
read: some frames. What was told last stands meanwhile, with its time.
"""

from __future__ import annotations

from typing import Final

from heliograph.link.contract import Text
from heliograph.messages import Change, Identification, Message
from heliograph_services.decoder.duplicates import Duplicates
from heliograph_services.decoder.following import BLIND_US, Applied, Following
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import Accepted
from heliograph_services.decoder.publish import Publisher
from heliograph_services.decoder.region_state import GROW_LIMIT_PX
from heliograph_services.decoder.regions import Place
from heliograph_services.decoder.tracks import Track

# Receivers drop single frames, and look ahead by one or two; a LED dark for five is rare, and costs nothing: see above.
STALE_FRAMES: Final = 5
# Receivers refuse single frames, and two in a row of a weak light; what is not told now is told 100 ms later.
UNSURE_FRAMES: Final = 3
SIGMAS: Final = 3.0


class Identities:
    """Makes the records of what tracks hold.

    Args:
        plan: the links of the site.
        publisher: makes them.
    """

    def __init__(self, plan: LinkPlan, publisher: Publisher) -> None:
        self._plan = plan
        self._publisher = publisher
        self.accepted = 0  # identities accepted or changed, counted
        self.withheld = 0  # identities lost by the rules above, counted
        self.unsure = 0  # refreshments left out
        self.duplicates = Duplicates(plan)

    def decide(self, following: Following, now_us: int) -> list[Message]:
        """Return what tracks have accepted, changed or lost up to now_us."""
        out: list[Message] = []
        found = {i: following.tracks[i].links.accepted(now_us) for i in following.feeding.spoken()}
        withheld = self._withheld(following, found, now_us)
        for i, one in found.items():
            track = following.tracks[i]
            if one is not None and i in withheld:
                track.withheld_us = max(track.withheld_us, one.identity.t_us)
                self.withheld += track.held is not None
            current = one if one is not None and one.identity.t_us > track.withheld_us else None
            before = track.held
            if current is None:
                if before is not None:
                    out += self.lose(track, following.at(i, now_us), now_us)
            elif before is None or not _same(before, current):
                track.held = current
                t_us = min(current.identity.t_us, now_us)
                out += self.state(track, following.at(i, t_us), t_us, "accepted" if before is None else "changed")
                self.accepted += 1
            else:
                track.held = current
        return out

    def stirs(self, track: Track, now_us: int) -> bool:
        """Return whether what a track has read is news for `decide`; note what only supports its identity."""
        one = track.links.accepted(now_us)
        if one is None or track.held is None:
            return one is not track.held
        if one.identity.t_us > track.withheld_us and _same(track.held, one):
            track.held = one
            return False
        return True

    def _withheld(self, following: Following, found: dict[int, Accepted | None], now_us: int) -> set[int]:
        """Return the tracks that may not be published as what they have read."""
        centred_us = following.regions.centred_us()
        out: set[int] = set()
        alike: dict[tuple[int, int], list[int]] = {}
        for i, one in found.items():
            if one is not None and now_us - int(centred_us[i]) > BLIND_US:
                unread = now_us - one.identity.t_us > max(BLIND_US, self._plan.frames_us(one.link, STALE_FRAMES))
                if _adrift(following, i, unread=unread):
                    out.add(i)
            if one is not None and one.identity.payload is not None:
                alike.setdefault((one.link, one.identity.payload), []).append(i)
        for (link, _), group in alike.items():
            if len(group) > 1:
                out |= self._doubles(following, found, group, link)
        return out

    def _doubles(
        self, following: Following, found: dict[int, Accepted | None], group: list[int], link: int
    ) -> set[int]:
        """Return those of a group, all of one payload, that another one has left behind, or on whose spot it is."""
        held = {i: one.identity for i in group if (one := found[i]) is not None}
        stale_us = max(one.t_us for one in held.values()) - self._plan.frames_us(link, STALE_FRAMES)
        out = {i for i, one in held.items() if one.t_us < stale_us}
        kept: list[Place] = []
        # What is published stays before what would be: two of equal margins do not take turns.
        for i in sorted(held.keys() - out, key=lambda i: (not following.tracks[i].read, -held[i].margin, i)):
            at = following.regions.place(i)
            if any(at.away_px(other) <= min(at.reach_px, other.reach_px) for other in kept):
                out.add(i)
            else:
                kept.append(at)
        return out

    def renamed(
        self, before: dict[str, Identification], following: Following, applied: Applied, now_us: int
    ) -> list[Message]:
        """Publish texts under the names that their tracks had, and what names have lost, changed or gained."""
        out: list[Message] = []
        for track, name in applied.renamed:
            out += self.texts(track, name)
        for track, _ in applied.ended:
            out += self.texts(track)
        ended = {track.name: at for track, at in applied.ended}
        now = {track.name for track in following.tracks if track.state is not None}
        for name, state in before.items():
            if name not in now:
                out.append(self._publisher.again(state, name, now_us, "lost", ended.get(name)))
        gained: list[Message] = []
        for i, track in enumerate(following.tracks):
            mine = track.state
            if mine is None or mine.track == track.name:
                continue
            old = before.get(track.name)
            # Where it was when it was told last, if it may not be where its region is now.
            unsure = self._is_unsure(following, i, now_us)
            at, at_us = (None, mine.t_us) if unsure else (following.at(i, now_us), now_us)
            change: Change = "accepted" if old is None else "changed"
            track.state = self._publisher.again(mine, track.name, at_us, change, at)
            if old is None or (old.protocol, old.beacon) != (mine.protocol, mine.beacon):
                gained.append(track.state)
        return out + gained

    def refresh(self, following: Following, now_us: int) -> list[Message]:
        """Return the texts that have come, and the identities of all tracks that are where their beacons are."""
        out: list[Message] = []
        held = [i for i, track in enumerate(following.tracks) if track.held is not None]
        sure = [i for i in held if not self._is_unsure(following, i, now_us)]
        self.unsure += len(held) - len(sure)
        duplicates = self.duplicates.look(following, sure)
        for track in following.tracks:
            if track.texts:
                out += self.texts(track)
        for i in sure:
            track = following.tracks[i]
            names = duplicates.get(track.serial, [])
            known = track.state.duplicates if track.state is not None else []
            change: Change = "refreshed" if set(names) <= set(known) else "duplicate"
            out += self.state(track, following.at(i, now_us), now_us, change, names)
        return out

    def _is_unsure(self, following: Following, i: int, now_us: int) -> bool:
        """Return whether the light that region i follows may be another's than the identity's that its track holds."""
        track = following.tracks[i]
        held = track.held
        if held is None or held.identity.payload is None or following.size == (1, 1):
            return False
        read_us = held.identity.t_us
        if track.frame_link == held.link and track.frame_us > read_us:
            return True
        if now_us - read_us <= self._plan.frames_us(held.link, UNSURE_FRAMES) + following.beat_us:
            return False
        hears = now_us - int(following.regions.centred_us()[i]) <= BLIND_US
        return hears or _off_px(following, i) > 0.0 or _is_lost(following, i)

    def state(
        self, track: Track, at: Place, t_us: int, change: Change, duplicates: list[str] | None = None
    ) -> list[Message]:
        """Publish the identity that a track holds, and the names of the other tracks that hold it elsewhere."""
        held = track.held
        if held is None:
            return []
        track.state = self._publisher.identification(
            track.name,
            self._plan.protocol(held.link),
            self._plan.name(held.link, held.identity.payload),
            held.identity,
            at,
            t_us,
            change,
            duplicates or [],
        )
        return [track.state]

    def lose(self, track: Track, at: Place, now_us: int) -> list[Message]:
        """Publish what is left of a track's texts, and the loss of its identity; nothing without one."""
        if track.held is None:
            return []
        out = self.texts(track)
        out += self.state(track, at, now_us, "lost")
        track.held, track.state = None, None
        return out

    def end(self, track: Track, at: Place, now_us: int) -> list[Message]:
        """Publish what a track that ends leaves: its texts, and the loss of what it held."""
        return self.lose(track, at, now_us) if track.read else self.texts(track)

    def texts(self, track: Track, name: str | None = None) -> list[Message]:
        """Publish the texts that have come since the last time, joined; under another name, if one is given."""
        out: list[Message] = []
        texts, track.texts = track.texts, []
        for link in dict.fromkeys(link for link, _ in texts):
            held = track.held
            beacon = self._plan.name(link, held.identity.payload if held is not None and held.link == link else None)
            run: list[Text] = [text for its_link, text in texts if its_link == link]
            out += self._publisher.data(name or track.name, self._plan.protocol(link), beacon, run)
        return out


def _adrift(following: Following, i: int, *, unread: bool) -> bool:
    """Return whether the place of a blind region is not known any more."""
    if following.size == (1, 1):
        return False  # there is but one place
    off_px = _off_px(following, i)
    reach_px = following.regions.place(i).reach_px
    return off_px > reach_px or (unread and (off_px > 0.0 or _is_lost(following, i)))


def _off_px(following: Following, i: int) -> float:
    """Return how far the centre of region i lies off the sensor; negative on it."""
    at = following.regions.place(i)
    sides = zip((at.x_px, at.y_px), following.size, strict=True)
    return max(max(-0.5 - p, p - (side - 0.5)) for p, side in sides)


def _is_lost(following: Following, i: int) -> bool:
    """Return whether the doubt of region i is beyond what it can hear."""
    reach_px = following.regions.place(i).reach_px
    return SIGMAS * following.regions.doubt_px(i) > reach_px + GROW_LIMIT_PX


def _same(one: Accepted, other: Accepted) -> bool:
    return one.link == other.link and one.identity.payload == other.identity.payload
