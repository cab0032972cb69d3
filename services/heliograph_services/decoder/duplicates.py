"""Two beacons with one ID: which tracks hold the same identity at places that cannot be one light.

Tracks i and k that hold one payload of one link are *duplicates* once all of this has been seen:

- both have read it at the same time, for `FRAMES` frames: min(t_i, t_k) - max(since_i, since_k), newest supporting
  frame and acceptance. One light under two names is read by one of them at a time, or lies on one spot
  (heliograph_services.decoder.identities);
- they are apart: their regions do not meet, or their frames end at different times. Where regions meet, two tracks may
  hear two parts of one light; its parts blink as one, two beacons have two clocks. Frames tell the time where they
  follow each other without a pause, in cyclic codes; for other links the regions alone decide.

Seen once, it stands while both hold the identity: two clocks pass each other now and then. A mirror that shows a beacon
a second time makes a duplicate too: the same ID, twice on the sensor.
"""

from __future__ import annotations

from itertools import combinations
from typing import Final

from heliograph_services.decoder.following import Following
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.links import Accepted
from heliograph_services.decoder.regions import Place
from heliograph_services.decoder.tracks import Track

# An acceptance takes four frames; one more is of a time at which both held it.
FRAMES: Final = 5
# Ends of frames of one light differ by its two parts' delays and by the clock's error over a frame or two: 2 % of 22
# bits. Two clocks of one rate are nearer than that by chance in one of eleven cases, and not for long.
SAME_TIME_BITS: Final = 0.5
# More of one ID than that are a site's own choice; all pairs of hundreds would cost more than reading them.
GROUP_LIMIT: Final = 16


class Duplicates:
    """Remembers the pairs.

    Args:
        plan: the links of the site.
    """

    def __init__(self, plan: LinkPlan) -> None:
        self._plan = plan
        self._pairs: set[tuple[int, int]] = set()  # of the tracks' serial numbers, the lower one first
        self.found = 0  # pairs, counted

    def look(self, following: Following, sure: list[int]) -> dict[int, list[str]]:
        """Return the names of the duplicates of each track that has some, by its serial number.

        Args:
            following: the tracks; the first `GROUP_LIMIT` that hold an identity are compared.
            sure: indices of those whose place is surely their beacon's.
        """
        groups: dict[tuple[int, int | None], list[tuple[int, Track, Accepted]]] = {}
        for i, track in enumerate(following.tracks):
            if track.held is not None and track.held.identity.payload is not None:
                groups.setdefault((track.held.link, track.held.identity.payload), []).append((i, track, track.held))
        standing: set[tuple[int, int]] = set()
        names: dict[int, list[str]] = {}
        placed = set(sure)
        for group in groups.values():
            for (i, one, its), (k, other, others) in combinations(group[:GROUP_LIMIT], 2):
                pair = (min(one.serial, other.serial), max(one.serial, other.serial))
                new = pair not in self._pairs
                if new and not (
                    {i, k} <= placed
                    and self._are_two(its, others, following.regions.place(i), following.regions.place(k))
                ):
                    continue
                standing.add(pair)
                self.found += new
                names.setdefault(one.serial, []).append(other.name)
                names.setdefault(other.serial, []).append(one.name)
        self._pairs = standing
        return names

    def _are_two(self, one: Accepted, other: Accepted, at: Place, there: Place) -> bool:
        both_us = min(one.identity.t_us, other.identity.t_us) - max(one.identity.since_us, other.identity.since_us)
        if both_us < self._plan.frames_us(one.link, FRAMES):
            return False
        if at.away_px(there) > at.reach_px + there.reach_px:
            return True
        word_us, bit_us = self._plan.word_us(one.link)
        if not word_us:
            return False
        apart_us = abs(one.identity.t_us - other.identity.t_us) % word_us
        return SAME_TIME_BITS * bit_us < apart_us < word_us - SAME_TIME_BITS * bit_us
