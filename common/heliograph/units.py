"""Units of time, and the arithmetic between bit rates and microseconds.

Time is int64 microseconds on the camera's clock; bits go by bit/s (`bit_rate`), blinking by Hz.
"""

from __future__ import annotations

from typing import Final

US_PER_S: Final = 1_000_000
US_PER_MS: Final = 1_000
NS_PER_US: Final = 1_000

# The slowest code of the field (the paper's simulated beacons) and the fastest (on-off keying at 60 kbit/s).
BIT_RATE_MIN: Final = 1.0
BIT_RATE_MAX: Final = 100_000.0


def bit_us(bit_rate: float) -> float:
    """Return the length of one bit in microseconds.

    Raises:
        ValueError: the bit rate lies outside [1, 100000] bit/s.
    """
    if not BIT_RATE_MIN <= bit_rate <= BIT_RATE_MAX:
        raise ValueError(f"bit rate must be in [{BIT_RATE_MIN:g}, {BIT_RATE_MAX:g}] bit/s, not {bit_rate}")
    return US_PER_S / bit_rate
