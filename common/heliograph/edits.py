"""How one text differs from another: the least number of characters replaced, missing and inserted (Levenshtein 1966).

    CER = (S + D + I) / characters sent

Of several ways with the least S + D + I the one with the fewest D + I is counted, so that the three are what they are
whatever the order of the search. Costs the product of the lengths: some tenths of a second for a sonnet.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Edits:
    """What must be done to the text sent to get the text read.

    Args:
        sent: characters sent.
        replaced: S.
        missing: D.
        inserted: I.
    """

    sent: int
    replaced: int
    missing: int
    inserted: int

    @property
    def errors(self) -> int:
        """The edit distance."""
        return self.replaced + self.missing + self.inserted

    @property
    def cer(self) -> float | None:
        """The character error rate, which may exceed 1; None where nothing was sent."""
        return self.errors / self.sent if self.sent else None


def edits(sent: str, read: str) -> Edits:
    """Return how the text read differs from the text sent."""
    # Of each prefix pair: (S + D + I, D + I, D); the rest follows from it.
    row = [(j, j, 0) for j in range(len(read) + 1)]
    for i, a in enumerate(sent, 1):
        diagonal, row[0] = row[0], (i, i, i)
        for j, b in enumerate(read, 1):
            above, left = row[j], row[j - 1]
            best = diagonal if a == b else (diagonal[0] + 1, diagonal[1], diagonal[2])
            if above[0] < best[0] or left[0] < best[0]:
                best = min(best, (above[0] + 1, above[1] + 1, above[2] + 1), (left[0] + 1, left[1] + 1, left[2]))
            diagonal, row[j] = above, best
    total, gaps, missing = row[-1]
    return Edits(len(sent), total - gaps, missing, gaps - missing)
