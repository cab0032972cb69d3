"""The receiver of `ook_fast` (`heliograph.link.modulations.ook_fast`): bits in, characters out.

Where words begin is told by the words: of the 16 places, the one at which `ALIGN` words in a row are characters without
an error; it is left for another at which that is so once its own last word was none. Each is one in 512 by chance, so a
wrong place is believed once in 512^3 / 16 bits. After a run of `IDLE_BITS` equal bits, which no text has, nothing is
aligned and nothing is refused: the LED idles.
"""

from __future__ import annotations

from collections import Counter
from math import log10
from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link.checked_characters import nearest, word16
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict, edges_of
from heliograph.link.frames import bits_of
from heliograph.link.inlet import Inlet
from heliograph.link.modulations.ook_fast import COSET, WORD_BITS
from heliograph.link.ook_bits import OokBits, Piece
from heliograph.link.text_run import TextRun
from heliograph.units import US_PER_S, bit_us

ALIGN: Final = 3
# The longest run in a text has 14 bits; 20 leave room for a wrong one.
IDLE_BITS: Final = 20
# Bits read in a row without an alignment after which the clock is doubted: 64 words.
UNALIGNED_MOST: Final = 1024

_REG, _COUNT, _ALIGNED, _RUN, _FAILED, _UNALIGNED = range(6)


@numba.njit(cache=True, nogil=True)
def _align(
    bits: npt.NDArray[np.uint8],
    table: npt.NDArray[np.int16],
    s: npt.NDArray[np.int64],
    runs: npt.NDArray[np.int64],
    out: npt.NDArray[np.int64],
) -> int:
    """Cut bits into words.

    Args:
        bits: (n,) decided bits.
        table: `nearest(16)`.
        s: (6,) state.
        runs: (WORD_BITS, ALIGN + 1) of each place: words in a row, and the last of them, newest first.
        out: (>= n * 2, 2) out: the bit (of these) that ends a word, negative for earlier ones; the word's entry.

    Returns:
        How many words.
    """
    n = 0
    for i in range(len(bits)):
        bit = np.int64(bits[i])
        s[_RUN] = s[_RUN] + 1 if s[_COUNT] > 0 and bit == (s[_REG] & 1) else 1
        s[_REG] = ((s[_REG] << 1) | bit) & 0xFFFF
        s[_COUNT] += 1
        s[_UNALIGNED] += 1
        if s[_RUN] >= IDLE_BITS:
            s[_ALIGNED] = -1
            s[_UNALIGNED] = 0
            runs[:, 0] = 0
            continue
        if s[_COUNT] < WORD_BITS:
            continue
        place = s[_COUNT] % WORD_BITS
        entry = np.int64(table[s[_REG] ^ COSET])
        is_character = 0 <= entry < 256
        runs[place, 0] = min(runs[place, 0] + 1, ALIGN) if is_character else 0
        for k in range(ALIGN, 1, -1):
            runs[place, k] = runs[place, k - 1]
        runs[place, 1] = entry
        if s[_ALIGNED] == place:
            s[_UNALIGNED] = 0
            s[_FAILED] = 0 if entry >= 0 else s[_FAILED] + 1
            out[n, 0], out[n, 1] = i, entry
            n += 1
        elif runs[place, 0] == ALIGN and (s[_ALIGNED] < 0 or s[_FAILED] > 0):
            s[_ALIGNED] = place
            s[_UNALIGNED] = s[_FAILED] = 0
            for k in range(ALIGN, 0, -1):
                out[n, 0], out[n, 1] = i - WORD_BITS * (k - 1), runs[place, k]
                n += 1
    return n


class OokReceiver:
    """Reads one track; obeys `heliograph.link.contract.Receiver`.

    Args:
        bit_rate: nominal bits a second.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, bit_rate: float) -> None:
        self.refusals: Refusals = Counter()
        self._bit_us = bit_us(bit_rate)
        self._inlet = Inlet(self.refusals)
        self._bits = OokBits(bit_rate, self.refusals)
        self._run = TextRun(self.refusals, WORD_BITS * self._bit_us, WORD_BITS)
        self._table = nearest(WORD_BITS)
        self._state = np.zeros(6, np.int64)
        self._runs = np.zeros((WORD_BITS, ALIGN + 1), np.int64)
        self._forget()

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take events and return what they decide; see the contract."""
        t_us, on = self._inlet.take(t_us, on, until_us)
        if len(t_us):
            self._run.begin(int(t_us[0]))
        out: list[LinkFrame | Text] = []
        for piece in self._bits.feed(t_us, on, until_us):
            self._take(piece, out)
        return out

    def flush(self) -> list[LinkFrame | Text]:
        """Decide what is still held, as if silence followed."""
        if self._inlet.until_us is None:
            return []
        # The last bits are decided once the paths behind them have met, and a window is searched when it is whole.
        return self.feed(np.empty(0, np.int64), np.empty(0, np.bool_), self._inlet.until_us + int(320 * self._bit_us))

    def identity(self) -> Identity | None:
        """Return the accepted identity (its payload is None: text), or None."""
        return self._run.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._run.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read; snr_db is that of a slot with an edge."""
        mar = self._run.share_read(now_us)
        if not self._bits.locked:
            return LinkQuality(US_PER_S / self._bit_us, None, None, None, None, mar)
        rate, ppm = self._bits.quality()
        events = self._bits.amplitude
        snr_db = 10.0 * log10(max(events, 1e-3) ** 2 / max(self._bits.spread, 1e-3))
        return LinkQuality(rate, snr_db, None, ppm, events, mar)

    def _take(self, piece: Piece, out: list[LinkFrame | Text]) -> None:
        if piece.fresh:
            self._forget()
        words = np.empty((2 * len(piece.bits) + ALIGN, 2), np.int64)
        n = _align(piece.bits, self._table, self._state, self._runs, words)
        for at, entry in words[:n].tolist():
            # A word that began before this piece ended a whole number of words before one of its bits.
            end_us = piece.end_us[at] if at >= 0 else piece.end_us[0] + at * self._bit_us * self._bits.period
            out += self._run.word(entry, int(end_us))
        if self._state[_UNALIGNED] > UNALIGNED_MOST:
            self.refusals[Refusal.NO_START_CODE] += 1
            self._run.refuse(Refusal.WEAK, int(piece.end_us[-1]))
            self._state[_UNALIGNED] = 0

    def _forget(self) -> None:
        self._state[:] = 0
        self._state[_ALIGNED] = -1
        self._runs[:] = 0


def warm() -> None:
    """Compile, or load from the cache, the kernels."""
    bits = [bit for code in (72, 101, 108, 111) * 8 for bit in bits_of(word16(code) ^ COSET, WORD_BITS)]
    at_us, levels = edges_of(bits, 0.0, 100.0)
    t_us, on = np.repeat(at_us, 8).astype(np.int64), np.repeat(levels, 8)
    t_us.flags.writeable = on.flags.writeable = False
    receiver = OokReceiver(10_000.0)
    for part in (slice(0, 100), slice(100, len(t_us))):
        receiver.feed(t_us[part], on[part], int(t_us[part][-1]) + 1)
    receiver.flush()
