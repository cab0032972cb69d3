"""Right bits by slot: how many bits of a sent frame a published frame has right, and how many chance would have.

Both payloads are encoded with the beacon's own modulation; bit i of one is compared with bit i of the other. A missing
frame has none right. Chance is the mean agreement with the words of all payloads, equally likely.
"""

from __future__ import annotations

from heliograph.link.modulations import TEXT, modulation
from heliograph.site import Beacon

# Payloads tried for the words of chance: all of seed11 (64), uart (128) and the largest codebook (507).
PAYLOADS_TRIED = 1024
# Different payloads whose bits are remembered, for each beacon; random payloads of 32 bits would fill the memory.
WORDS_KEPT = 4096


class Slots:
    """The words of one beacon.

    Args:
        beacon: its row of the site file.

    Raises:
        ValueError: there is no such modulation, or it refuses the options.
    """

    def __init__(self, beacon: Beacon) -> None:
        self._modulation = modulation(beacon.protocol, **beacon.options)
        self._is_text = beacon.protocol in TEXT
        self._words: dict[int, tuple[int, ...] | None] = {}
        self._chance: tuple[float, ...] | None = None
        self._payload_bits: int | None = None

    @property
    def payload_bits(self) -> int:
        """The data bits of a frame: 7 of a character, else the whole bits of a payload's values (seed11: 6 of 64)."""
        if self._is_text:
            return 7
        if self._payload_bits is None:
            code = getattr(self._modulation, "code", None)
            sendable = [payload for payload in range(PAYLOADS_TRIED) if self.word(payload) is not None]
            values = max(sendable, default=0) + 1 if code is None else len(code.words)
            self._payload_bits = values.bit_length() - 1
        return self._payload_bits

    def word(self, payload: int) -> tuple[int, ...] | None:
        """Return the bits of a payload, or None where it cannot be sent."""
        if payload not in self._words:
            if len(self._words) >= WORDS_KEPT:
                self._words.clear()
            try:
                bits = self._modulation.encode(chr(payload) if self._is_text else payload)
            except (ValueError, OverflowError):
                self._words[payload] = None
            else:
                self._words[payload] = tuple(int(bit) for bit in bits)
        return self._words[payload]

    def right(self, sent: int, received: int) -> int:
        """Return how many bits agree; 0 where one of them cannot be sent."""
        a, b = self.word(sent), self.word(received)
        if a is None or b is None:
            return 0
        return sum(x == y for x, y in zip(a, b, strict=False))

    def chance(self, sent: int) -> float:
        """Return how many bits of the sent frame a random word of the modulation has right, on average."""
        if self._chance is None:
            words = [word for word in map(self.word, range(PAYLOADS_TRIED)) if word is not None]
            slots = max((len(word) for word in words), default=0)
            whole = [word for word in words if len(word) == slots]
            self._chance = tuple(sum(column) / len(whole) for column in zip(*whole, strict=True))
        word = self.word(sent)
        if word is None:
            return 0.0
        return sum(p if bit else 1.0 - p for bit, p in zip(word, self._chance, strict=False))
