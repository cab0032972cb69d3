"""When a track of checked characters is a text beacon, and what is let out (`heliograph.link.checked_characters`).

Until it is accepted, words count only where they are characters without an error, in a run that no other word breaks,
and only if they differ from the `MEMORY` before them: a lamp, or a code that repeats itself, is no news. With w words
worth 1/256 each (1/512 with 16 bits), at a place that has not been chosen, the chance a bit position is 256^-w:
`NEEDED` = 6 make 3.6e-15 (5.6e-17). A text that does not have six different characters within so many is never
accepted. What the run held back is released at once; words with one wrong bit are then corrected, others withheld.

Margin of a word with e wrong bits, of a code of distance d, at a share p of wrong bits (learned): that of the nearest
other word to it, ``(d - 2 e) ln((1 - p) / p)``.
"""

from __future__ import annotations

from collections import deque
from math import log
from typing import Final

from heliograph.errors import Refusal, Refusals
from heliograph.link.checked_characters import TIME_FILL
from heliograph.link.contract import Identity, LinkFrame, Text, Verdict
from heliograph.link.pulse_words import probability
from heliograph.units import US_PER_S

NEEDED: Final = 6
MEMORY: Final = 8
# Of the last 20 words so many refused: no text any more, or read at the wrong place.
WATCHED: Final = 20
REFUSED_MAX: Final = 10
# The paper's score, as for text of `uart` (heliograph.link.text_identity).
SCORE_START: Final = 10
SCORE_MAX: Final = 20
SCORE_MIN: Final = -10
GAIN: Final = 2
SILENCE_US: Final = 2 * US_PER_S
NEW_US: Final = 300_000
SILENCE_WORDS: Final = 64
# Words over which the share of wrong bits is averaged, and where it starts.
ERROR_MEMORY: Final = 64
ERROR_START: Final = 0.01
ERROR_LEAST: Final = 1e-4
HELD_MOST: Final = 256  # characters held back: "aaa ..." is let go


class TextRun:
    """Judges the words of one track.

    Args:
        refusals: where refused words are counted.
        word_us: nominal length of a word.
        bits: of a word, 15 or 16.
    """

    def __init__(self, refusals: Refusals, word_us: float, bits: int) -> None:
        self._refusals = refusals
        self._word_us = word_us
        self._bits = bits
        self._distance = 5 if bits == 15 else 6
        self._begun_us: int | None = None
        self._since_us: int | None = None
        self._support_us: int | None = None
        self._held: list[LinkFrame] = []
        self._last: deque[int] = deque(maxlen=MEMORY)
        self._news = 0
        self._frames = 0
        self._margin = 0.0
        self._error = ERROR_START
        self._watched: deque[float] = deque(maxlen=WATCHED)
        self._score = SCORE_START
        self._recent: deque[tuple[int, bool]] = deque(maxlen=8192)

    @property
    def accepted(self) -> bool:
        """Whether the track is a text beacon."""
        return self._since_us is not None

    def begin(self, t_us: int) -> None:
        """Note the track's first event."""
        if self._begun_us is None:
            self._begun_us = t_us

    def word(self, nearest: int, end_us: int) -> list[LinkFrame | Text]:
        """Judge a word; return what it releases.

        Args:
            nearest: its entry of `checked_characters.nearest`.
            end_us: when it ended.
        """
        wrong = nearest >> 8
        if nearest < 0 or (wrong and not self.accepted):
            self.refuse(Refusal.WEAK if nearest >= 0 else Refusal.UNKNOWN_WORD, end_us)
            return []
        self._error += (wrong / self._bits - self._error) / ERROR_MEMORY
        p = max(self._error, ERROR_LEAST)
        return self.character(nearest & 0xFF, (self._distance - 2 * wrong) * log((1.0 - p) / p), end_us)

    def character(self, code: int, margin: float, end_us: int) -> list[LinkFrame | Text]:
        """Take a character that is sure enough to be told, and without an error as long as the track is not accepted.

        Args:
            code: of the character.
            margin: log-likelihood (nats) to the runner-up.
            end_us: when it ended.

        Returns:
            What it releases.
        """
        frame = LinkFrame(end_us, code, probability(margin), margin)
        self._watched.append(frame.score)
        self._recent.append((end_us, True))
        self._score = min(self._score + GAIN, SCORE_MAX)
        self._frames += 1
        self._margin += margin
        self._support_us = end_us
        self._news += frame.payload not in self._last
        self._last.append(frame.payload)
        self._held.append(frame)
        if not self.accepted:
            if self._news < NEEDED:
                if len(self._held) > HELD_MOST:
                    self._refusals[Refusal.PERIODIC] += 1
                    del self._held[0]
                return []
            self._since_us = end_us
        return self._release(end_us)

    def refuse(self, reason: Refusal, end_us: int) -> None:
        """Note a word that is none."""
        self._refusals[reason] += 1
        self._recent.append((end_us, False))
        self._watched.append(0.0)
        self._score = max(self._score - 1, SCORE_MIN)
        if not self.accepted:
            self._break()
        elif sum(score == 0.0 for score in self._watched) >= REFUSED_MAX:
            self._since_us = None
            self._watched.clear()
            self._break()

    def _break(self) -> None:
        """Begin the run anew."""
        self._held.clear()
        self._last.clear()
        self._news = 0
        self._frames = 0
        self._margin = 0.0

    def _release(self, end_us: int) -> list[LinkFrame | Text]:
        out: list[LinkFrame | Text] = list(self._held)
        text = "".join(chr(frame.payload) for frame in self._held if frame.payload != TIME_FILL)
        self._held.clear()
        if text:
            out.append(Text(end_us, text, None))
        return out

    def identity(self) -> Identity | None:
        """Return the accepted identity (its payload is None: text), or None."""
        if self._since_us is None or self._support_us is None:
            return None
        confidence = sum(self._watched) / max(len(self._watched), 1)
        return Identity(None, self._since_us, self._support_us, self._frames, self._margin, confidence)

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        limit = max(SILENCE_US if self.accepted else NEW_US, SILENCE_WORDS * self._word_us)
        since_us = self._support_us if self._support_us is not None else self._begun_us
        if self._score <= SCORE_MIN or (since_us is not None and now_us - since_us > limit):
            return "invalid"
        return "valid" if self.accepted else "new"

    def share_read(self, now_us: int) -> float | None:
        """Return the share of the last second's words that were read, or None."""
        newest = [ok for end_us, ok in self._recent if now_us - US_PER_S < end_us <= now_us]
        return sum(newest) / len(newest) if newest else None
