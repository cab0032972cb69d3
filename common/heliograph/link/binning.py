"""Fixed windows (Perez-Ramirez et al. 2019), as a receiver to compare with: events become images, and images bits.

"Optical wireless camera communications using neuromorphic vision sensors" (ICC workshops 2019) adds the events of fixed
windows into images and reads 500 bit/s. What is definite of it here: windows of 1/500 s on an absolute grid, whatever
the bit rate, and the LED's level after each of them::

    N_on > N_off: it went on      N_off > N_on: it went off      no event, or as many of each: it stayed

Everything after it is the paper's receiver (`heliograph.link.paper`): runs of n = round(gap x bit rate) bits, rotation
to a word of the code, Algorithm 1. So a comparison with it is one of windows alone. A bit shorter than a window is not
read, or as something else: that is the method's limit, and no mistake of the operator's.
"""

from __future__ import annotations

from typing import Final

from heliograph.link.frames import CyclicCode
from heliograph.link.paper import PaperParameters, PaperReceiver
from heliograph.units import US_PER_S, bit_us

WINDOW_US: Final = US_PER_S / 500.0
# The setting of 21 that reads most over 12 scenes (bench/tune_others.py), on development seeds: .76 of the frames, .39
# as described. Fewer events than a cluster has are noise.
TUNED_EVENTS: Final = 5
# Any majority is a polarity; the least share that float division can yield for one event in 2^31.
_MAJORITY: Final = 2.0**-31


class BinningReceiver(PaperReceiver):
    """The receiver of one track by fixed windows.

    Args:
        code: a cyclic code.
        bit_rate: nominal bits a second, taken as exact; above 500 nothing sensible is read.
        min_events: windows with fewer say nothing; 1: as described.

    Raises:
        ValueError: the bit rate is out of range.
    """

    def __init__(self, code: CyclicCode, bit_rate: float, min_events: int = 1) -> None:
        super().__init__(code, bit_rate, PaperParameters(WINDOW_US / bit_us(bit_rate), _MAJORITY, min_events))
