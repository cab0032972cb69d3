"""How the default receiver of cyclic codes comes to read scanned light (`heliograph.link.scan_demodulator`).

Beside the events of a block (`heliograph.link.cyclic`) the turns of the light (`heliograph.link.scans`) are summed,
where the events are scans long enough to matter. They show the clock of a light whose bursts go on for more than a bit,
and of one whose scans are half a bit. There, though, times on the grid of the scans, of rate s, are as coherent at
s - f as at f, and within what a window resolves about s / 2 both blur into one. So where s is nearly 2, the nominal
rate, the peaks, and there all of the lobe are candidates, and what is read under each decides
(`heliograph.link.beginning`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from heliograph.events import Flags, Times
from heliograph.link import clock, scan_lock, scan_state, scans
from heliograph.link.scan_state import ScanState, new_scan_state

# Where the grid of the scans mirrors a rate of the span into the span, any peak may be the true one or its image; where
# both blur, any rate whose z is half of the best.
MIRRORED: Final = 2.0 * clock.SPAN
AS_GOOD: Final = 0.5
# Of what a window resolves, a peak this near to the nominal rate is its own.
NOMINAL: Final = 0.25
# A response must have been seen at all places of a scan in a bit, the more of them the longer the scan is: 16 blocks
# where it is .44 bit or more (64 bits of a light at 2.5 kbit/s behind 199 us led to one that read half of the frames
# and a quarter wrong, for good).
WINDOW_BLOCKS_A_BIT: Final = 36.0

# Images are as long as half a bit to the camera's clock; a sensor's scans are so by accident only.
IN_STEP: Final = 1e-3
# Within so long a scan pixels settle (in about a millisecond): no edge is in two of them, little is to be learned of a
# response, and the wait for all of its places takes seconds at such bit rates. So a lock begins early, and what has
# been waited for confirms it or begins anew (`heliograph.link.cyclic`). Behind 199 us, of 456 frames at 2512 bit/s 93
# were read after 2.5 blocks, 383 after 16.
IMAGE_LEAST_US: Final = 4000.0
# Blocks of the light that tell its clock then; two images a bit, in step, show the same two places for good. Else, of
# 2400 frames at two and a half images a bit, clocks up to 1 % off, 2132 were read after 4, 2304 after 6, 2334 after 16.
BLURRED_BLOCKS: Final = 6.0
IN_STEP_BLOCKS: Final = 2.5
# Of the turns of a light in step, so many are in one phase. A clock .5 % off moves from one image of a bit to the other
# within 100 bits; where that is not at the very end of a window, less is left.
COHERENT: Final = 0.8
# No rates: the events are no scans.
_NONE: Final[clock.Floats] = np.array([[1.0, 0.0]])

# Half the delay ON - OFF, in bits, is known but for half bits; a rise that much behind a fall is a fall that is late:
# overexposed pixels fall one scan late, and half a bit either way would be a draw.
LATE: Final = 0.125


class ScanSearch:
    """Sums the turns of one track's light, and begins with what they show.

    Args:
        bit_us: nominal length of a bit.
        frame_bits: of the code.
    """

    def __init__(self, bit_us: float, frame_bits: int) -> None:
        self._bit_us = bit_us
        self._frame_bits = frame_bits
        self.scanned: ScanState | None = None  # of the present lock, or of one on trial
        self._kept: ScanState | None = None
        self.fit: clock.Floats = np.empty(0)  # of the scans of the window begun with (`heliograph.link.scan_lock`)
        self.doubted = False  # a lock that was begun early was not the light's
        self._quantum = 0.0  # length of a scan in bits; 0 while the events are not known to be scans
        self._turn = np.zeros(scans.FIELDS)
        self._sums = np.zeros((clock.LONG_BLOCKS, clock.SUMS))

    def clear(self) -> None:
        """Forget the blocks that were summed."""
        self._sums[:] = 0.0
        self._turn[:] = 0.0
        self.doubted = False

    @property
    def known(self) -> bool:
        """Whether the events are known to be scans."""
        return self._quantum > 0.0

    @property
    def drift(self) -> bool:
        """Whether the events are scans, and not two a nominal bit, as images are taken."""
        return self.known and abs(self._quantum - 0.5) > IN_STEP

    @property
    def _images(self) -> bool:
        return self._quantum * self._bit_us >= IMAGE_LEAST_US

    def look(self, t_us: Times, *, rare: bool = False) -> bool:
        """Learn from events held whether they are scans; return it. Rare: as of `heliograph.link.scans.spacing`."""
        self._quantum = scans.quantum(scans.starts(t_us / self._bit_us), rare=rare)
        return self.known

    def hides(self, t: clock.Floats) -> bool:
        """Return whether events, (n,) times in bits, that are not known to be scans may yet turn out to be.

        Where two scans are nearly a bit, all edges of a hundred bits may lie in every second scan.
        """
        return not self.known and scans.spacing(scans.starts(t), scans.LEAST, 2.0 * scans.MOST, rare=True) > 0.0

    def take(self, t: clock.Floats, on: Flags) -> None:
        """Sum the next block (times in bits from its beginning)."""
        self._sums[:-1] = self._sums[1:]
        self._sums[-1] = 0.0
        if not self.known:
            return
        found_t, found_on = np.empty(4 * clock.BLOCK_BITS), np.empty(4 * clock.BLOCK_BITS, np.bool_)
        self._turn[scans.AT] -= clock.BLOCK_BITS
        n = scans.turns(t, on, self._turn, found_t, found_on)
        clock.block(found_t[:n], found_on[:n], self._sums[-1])

    def enough(self, seen: float) -> bool:
        """Return whether so many blocks of the light may show its response; True where the events are no scans."""
        return seen >= min(WINDOW_BLOCKS_A_BIT * self._quantum, clock.LONG_BLOCKS)

    def settled(self, seen: float) -> bool:
        """Return whether after so many blocks of the light it is plain whether the events are scans, and `enough`."""
        return self.enough(seen) if self.known else seen >= clock.LONG_BLOCKS

    def peaks(self, blocks: int, threshold: float) -> clock.Floats:
        """Return (n, 2) the rates that the newest blocks' turns may show, and z; z = 0 where there are no scans."""
        if not self.known:
            return _NONE
        newest = self._sums[-blocks:]
        found = peaks(newest, threshold)
        if found[0, 1] < threshold:
            return found
        resolved = 1.0 / (blocks * clock.BLOCK_BITS)
        # Scans shift the lines of a word that repeats so that one may lie beside the bit rate, alone (42 at 3.5 kbit/s
        # behind 199 us: .981); where the nominal rate is as far off, its frames tell.
        if abs(1.0 / self._quantum - 2.0) >= MIRRORED and abs(found[0, 0] - 1.0) <= resolved:
            return found
        if self._images and self.in_step(blocks, found):
            return found[:1]
        # Most clocks are the nominal, far nearer than a window resolves (begun with .17 % off, some drifted away).
        rates = np.append(1.0, found[np.abs(found[:, 0] - 1.0) > NOMINAL * resolved, 0])
        if np.abs(found[:, 0] - 0.5 / self._quantum).min() < resolved:
            rates = np.concatenate([rates, clock.lobes(newest, AS_GOOD)])
        return np.column_stack([rates, np.full(len(rates), found[0, 1])])

    def early(self, blocks: int, seen: float, threshold: float) -> clock.Floats:
        """Return, as `peaks` does, what may be begun with before `enough` has been seen; z = 0 where nothing may."""
        if not self._images or self.doubted:
            return _NONE
        if seen < (BLURRED_BLOCKS if self.drift else IN_STEP_BLOCKS):
            return _NONE
        found = self.peaks(blocks, threshold)
        return found if self.drift or self.in_step(blocks, found) else _NONE

    def may_try(self, blocks: int, seen: float, found: clock.Floats) -> bool:
        """Return whether a rate may be begun with if the code repeats under it: the turns of images must all show it.

        At .8 % beside the rate a word that repeats was read as another, four times, and named.
        """
        if not self.known or self.enough(seen):
            return True
        return not self.drift and (not self._images or self.in_step(blocks, found))

    def on_grid(self, rate: float, blocks: int) -> bool:
        """Return whether a rate is that of two scans, as far as a window of these blocks resolves."""
        return self.known and abs(rate - 0.5 / self._quantum) < 0.5 / (blocks * clock.BLOCK_BITS)

    def in_step(self, blocks: int, found: clock.Floats) -> bool:
        """Return whether all turns of the newest blocks are in one phase of two images a bit, at the nominal rate."""
        near = abs(found[0, 0] - 1.0) <= NOMINAL / (blocks * clock.BLOCK_BITS)
        coherent = found[0, 1] >= COHERENT * self._sums[-blocks:, clock.POWER :].sum()
        return self.known and not self.drift and near and bool(coherent)

    def begin(self, t: clock.Floats, on: Flags, until: float, f: float, found: clock.Floats) -> bool:
        """Begin with a clock that the turns of a window show.

        Args:
            t: (n,) event times of the window in nominal bits from the lock's origin.
            on: (n,) polarities.
            until: end of the window.
            f: bits a nominal bit.
            found: (4,) out, as of `heliograph.link.clock.grid`.

        Returns:
            Whether the window's events are scans.
        """
        found_t, found_on = np.empty(len(t)), np.empty(len(t), np.bool_)
        turn = self._turn.copy()
        turn[scans.UP : scans.USUAL_OFF] = 0.0
        n = scans.turns(t, on, turn, found_t, found_on)
        if n == 0:
            return False
        if self._kept is None:
            self._kept = new_scan_state()
        clock.grid(found_t[:n], found_on[:n], f, until, found, np.empty((2, clock.SUB)))
        if found[2] > LATE:
            found[2] -= 0.5
            found[0] -= 0.5 * found[1]
        fit = scan_lock.begin(self._kept, t, on, until, found, (found_t[:n], found_on[:n]), self._frame_bits)
        if fit is None:
            return False
        self.fit = fit
        self.scanned = self._kept
        self.scanned.turn[:] = 0.0
        self.scanned.turn[scans.USUAL_OFF : scans.SWING] = turn[scans.USUAL_OFF : scans.SWING]
        return True

    def ended(self, until: float) -> int:
        """Take note that the stream ends, in bits from the lock's origin; return in how many slots its last is judged.

        Silence behind the end is no evidence: taken for it, one frame in thirty that ended there was read wrongly.
        """
        if self.scanned is None:
            return 1
        self.scanned.floats[scan_state.END] = until
        return 1 + scan_state.LAG

    def figures(self, scanned: ScanState) -> tuple[float, float]:
        """Return events of a transition and background events a slot."""
        burst = 0.5 * float(scanned.turn[scans.USUAL_OFF] + scanned.turn[scans.USUAL_ON])
        quiet = 0.5 * float(scanned.mean[[0, -1]].sum()) / clock.SUB
        return burst, quiet / float(scanned.floats[scan_state.QUANTUM])


def peaks(sums: clock.Floats, threshold: float) -> clock.Floats:
    """Return (n, 2) the rates that a window of these blocks may show, and z, as `clock.peaks` finds them."""
    found = np.empty((clock.PEAKS, 2))
    return found[: clock.peaks(sums, threshold, found)]
