"""Names by what is read: a beacon keeps its track's number although the tracks have changed places.

The decoder says for each track a token of the identity that it reads there (`Status.identity`). The first token of a
number is remembered. Let the track of number n read t, and t be the remembered token of the number m, not n::

    m is not seen any more                      n's track takes the number m: the beacon is back
    m's track reads something else than t       n and m are exchanged, if n has a token of its own to defend
    m's track reads t too                       nothing: two lights with one code, or the decoder is not sure
    m's track reads nothing as yet              exchanged if n has a token of its own, else nothing

A number that is exchanged without having had a token (a new track that took over an ended one's name) ends. Chains
and rings of tracks that have changed places are undone pair by pair. A token that belongs to no other number and is
read for `ADOPT_US` replaces the remembered one: the beacon was given a new payload.

The decoder hears of new names some time later, and statuses that it has sent till then speak of the old ones: so an
exchanged number is on hold until it reads its own token, or for `HOLD_US`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

# A code's dark run lasts .2 s at 50 bit/s, and it takes longer than that to read another track's identity.
UNSEEN_US: Final = 250_000
# A track that reads a stranger's token may have changed places with one that is not identified yet: at 50 bit/s four
# frames take .9 s.
ADOPT_US: Final = 2_000_000
# Two periods of the tracker and one of the decoder at 10 Hz, and a slow link; if the decoder did not follow in that
# time, what it says is taken as it is.
HOLD_US: Final = 1_000_000


@dataclass(slots=True)
class _Memory:
    """What is remembered of a number."""

    token: str | None = None  # the first one that it read
    stranger: str | None = None  # another that nobody owns, and that it reads now
    stranger_us: int = 0  # since when
    hold_us: int | None = None  # exchanged: wait until it reads `token`, or until this time

    def heard(self, token: str | None, at_us: int) -> None:
        """Take what the number reads: a hold may end, and a stranger be gone."""
        if self.hold_us is not None and (token == self.token or at_us >= self.hold_us):
            self.hold_us = None
        if token != self.stranger:
            self.stranger = None

    def learn(self, token: str, at_us: int) -> None:
        """Remember a token that nobody owns: the first at once, another when it has been read for long."""
        if self.token is None:
            self.token = token
        elif self.stranger != token:
            self.stranger, self.stranger_us = token, at_us
        elif at_us - self.stranger_us >= ADOPT_US:
            self.token, self.stranger = token, None


@dataclass(frozen=True, slots=True)
class Renaming:
    """What follows from a status.

    Args:
        number: of each old number, the new one; numbers that stay are left out. If a new number is not among the old
            ones' values, its old track ends.
        ended: numbers whose tracks end, by their old names.
    """

    number: dict[int, int]
    ended: frozenset[int]


class Identities:
    """The tokens of the tracks that live; bounded by their number."""

    def __init__(self) -> None:
        self._memory: dict[int, _Memory] = {}

    def __len__(self) -> int:
        return len(self._memory)

    def judge(self, tokens: Mapping[int, str | None], unseen_us: Mapping[int, int], at_us: int) -> Renaming:
        """Take what the tracks read and return who changes names.

        Args:
            tokens: by number; numbers that are not among the living are ignored.
            unseen_us: of each living number, for how long its track has not been seen.
            at_us: of this status; never earlier than the one before.
        """
        self._memory = {number: self._memory.get(number, _Memory()) for number in unseen_us}
        for number, memory in self._memory.items():
            memory.heard(tokens.get(number), at_us)
        case = _Case(
            memory=self._memory,
            reads={row: tokens.get(row) for row in unseen_us},
            called={row: row for row in unseen_us},
            seen={row for row, us in unseen_us.items() if us < UNSEEN_US},
            at_us=at_us,
        )
        # Each exchange gives a track its own number, so there are no more of them than tracks.
        for _ in range(len(case.seen)):
            if not any(case.settle(row) for row in sorted(case.seen)):
                break
        renamed = {row: number for row, number in case.called.items() if row != number}
        for number in renamed:
            self._memory[number].hold_us = at_us + HOLD_US
        return Renaming(renamed, frozenset(case.ended))


@dataclass(slots=True)
class _Case:
    """One status under judgement. A row is named by the number that it had when the status came."""

    memory: dict[int, _Memory]
    reads: dict[int, str | None]
    called: dict[int, int]
    seen: set[int]
    at_us: int
    ended: set[int] = field(default_factory=set)

    def settle(self, row: int) -> bool:
        """Judge one row that is seen; return whether names have changed."""
        token, mine = self.reads[row], self.memory[self.called[row]]
        if token is None or token == mine.token or self.memory[row].hold_us is not None:
            return False
        holder = self._holder(token)
        if holder is None:
            mine.learn(token, self.at_us)
            return False
        if self.memory[holder].hold_us is not None or self._is_read_twice(token):
            return False
        if mine.token is None:
            if holder not in self.seen:
                self.ended.add(holder)
            elif self.reads[holder] is None:
                return False
        self.called[row], self.called[holder] = self.called[holder], self.called[row]
        return True

    def _holder(self, token: str) -> int | None:
        """Return the row whose number owns the token."""
        for row, number in self.called.items():
            if self.memory[number].token == token and row not in self.ended:
                return row
        return None

    def _is_read_twice(self, token: str) -> bool:
        return sum(self.reads[row] == token for row in self.seen) > 1
