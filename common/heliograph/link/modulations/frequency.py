"""`frequency`: the frequency at which a light blinks is its ID (markers of Censi et al. 2013: kilohertz, 50 % lit).

The payload is the frequency in hertz, the bit rate twice as much: a bit is half a period, and the light sends::

    1 0 1 0 1 0 ...        a frame is 32 periods; nothing marks its beginning

Nothing else is on the air, so any lamp at that frequency is that beacon. Hence frequencies are read only where a site
lists them (or the command line gives the bit rate), and a site may list none that

- lies outside 100 Hz to 10 kHz;
- lies below 1 kHz and within 2 % of a multiple of 100 or 120 Hz: what the mains drives, and its harmonics;
- lies above half the scan rate of the camera: each scan must see one level;
- is nearer to another than the receiver tells apart: both tolerances, and two lines of its window (`resolution_hz`).
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

from heliograph.link.contract import Bits, Receiver
from heliograph.link.options import whole
from heliograph.units import US_PER_S

F_LEAST_HZ: Final = 100
F_MOST_HZ: Final = 10_000
PERIODS: Final = 32
MAINS_HZ: Final = (100, 120)
MAINS_BELOW_HZ: Final = 1_000
MAINS_SHARE: Final = 0.02
# Half a per cent holds ceramic resonators (0.5 %), not RC oscillators; 8.0, 8.2, 8.4 kHz are still three.
TOLERANCE_PERMILLE: Final = 5
# A window is no shorter: it resolves 20 Hz, and two of them, an identity, take a tenth of a second.
WINDOW_LEAST_US: Final = 50_000


def window_us(frequency_hz: float) -> int:
    """Return the length of the receiver's window: 64 half periods, at least `WINDOW_LEAST_US`."""
    return max(WINDOW_LEAST_US, int(PERIODS * US_PER_S / frequency_hz))


def resolution_hz(low_hz: float, high_hz: float, tolerance: float) -> float:
    """Return how far apart two frequencies must lie to be told apart."""
    return tolerance * (low_hz + high_hz) + 2.0 * US_PER_S / window_us(low_hz)


class Frequency:
    """Identity by blink frequency; obeys `heliograph.link.contract.Modulation`.

    Args:
        tolerance_permille: how far a beacon's clock may be off, in thousandths.

    Raises:
        ValueError: the option is out of its range.
    """

    name = "frequency"
    frame_bits = 2 * PERIODS

    def __init__(self, tolerance_permille: int | str = TOLERANCE_PERMILLE) -> None:
        self._tolerance = whole("tolerance_permille of frequency", tolerance_permille, 1, 20) / 1000.0

    def encode(self, payload: int) -> Bits:
        """Return the bits of a frame: 32 periods.

        Raises:
            ValueError: no beacon may have this frequency; the text says why.
        """
        _check(payload)
        return (1, 0) * PERIODS

    def check_beacons(self, beacons: Iterable[tuple[str, int | None, float]], scan_rate_hz: float = 0.0) -> None:
        """Check the beacons of a site that blink, together.

        Args:
            beacons: name, payload (Hz) and bit rate of each.
            scan_rate_hz: scans a second of the camera; 0: it is asynchronous, or not known.

        Raises:
            ValueError: one of the rules at the head of this file is broken; the text names beacon, value and range.
        """
        listed: list[tuple[int, str]] = []
        for name, payload, bit_rate in beacons:
            if payload is None:
                raise ValueError(f"beacon {name}: its payload must be its frequency in Hz, not missing")
            try:
                _check(payload)
            except ValueError as error:
                raise ValueError(f"beacon {name}: {error}") from None
            if bit_rate != 2 * payload:
                raise ValueError(
                    f"beacon {name}: bit_rate must be {2 * payload} (twice the frequency), not {bit_rate:g}"
                )
            if scan_rate_hz > 0.0 and payload > scan_rate_hz / 2.0:
                half = f"{scan_rate_hz / 2.0:g} Hz (half the scan rate of the camera)"
                raise ValueError(f"beacon {name}: frequency must be at most {half}, not {payload}")
            listed.append((payload, name))
        for (low, first), (high, second) in pairwise(sorted(listed)):
            apart = resolution_hz(low, high, self._tolerance)
            if high - low < apart:
                raise ValueError(
                    f"beacons {first} and {second}: frequencies near {low} Hz must be at least {apart:.0f} Hz apart,"
                    f" not {high - low}"
                )

    def receiver(self, bit_rate: float, name: str = "default") -> Receiver:
        """Return a receiver of one track, for the one frequency of half the bit rate.

        Raises:
            ValueError: another name than "default", or no beacon may have this frequency.
        """
        if name != "default":
            raise ValueError(f"receiver of frequency must be default, not {name!r}")
        frequency_hz = round(bit_rate / 2.0)
        _check(frequency_hz)
        from heliograph.link.blinks import BlinkReceiver  # noqa: PLC0415 - only where something is received

        return BlinkReceiver(frequency_hz, self._tolerance)


def _check(frequency_hz: int) -> None:
    if isinstance(frequency_hz, bool) or not isinstance(frequency_hz, int):
        raise ValueError(f"frequency must be a whole number of Hz, not {frequency_hz!r}")
    if not F_LEAST_HZ <= frequency_hz <= F_MOST_HZ:
        raise ValueError(f"frequency must be in [{F_LEAST_HZ}, {F_MOST_HZ}] Hz, not {frequency_hz}")
    if frequency_hz >= MAINS_BELOW_HZ:
        return
    for mains_hz in MAINS_HZ:
        harmonic_hz = mains_hz * max(round(frequency_hz / mains_hz), 1)
        if abs(frequency_hz - harmonic_hz) <= MAINS_SHARE * harmonic_hz:
            raise ValueError(
                f"frequency must be more than 2 % off every multiple of {mains_hz} Hz below 1 kHz (lamps),"
                f" not {frequency_hz}, near {harmonic_hz}"
            )
