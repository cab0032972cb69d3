"""The default receiver of every cyclic code: one track's events in, frames decided on their own bits out.

It waits for a clock (`heliograph.link.clock`, at every 16 bits of an absolute grid; a likely one is tried, of a young
track at every 8 bits and over all that it has shown: `heliograph.link.trial`), then takes the events of that window
again and goes on with `heliograph.link.demodulator`, so a cold start costs no frame. When the clock is lost it waits
again. Behind images a lock may begin early (`heliograph.link.cyclic_scans`): what is held is kept then until enough was
seen. Where that shows another clock the lock begins anew; where it was lost in the light, the waiting goes on. No stage
knows anything but the events, the nominal bit rate and the words of the code.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Final

import numpy as np

from heliograph.errors import Refusal, Refusals
from heliograph.events import Flags, Times
from heliograph.link import clock, demodulator, one_phase, scan_demodulator, scans, state, trial
from heliograph.link.acceptance import Acceptance, Place, evidence_of, frames_needed
from heliograph.link.beginning import NEVER, Beginner, Window
from heliograph.link.contract import Identity, LinkFrame, LinkQuality, Text, Verdict
from heliograph.link.cyclic_blocks import ClockBlocks, Peaks
from heliograph.link.cyclic_quality import quality_of
from heliograph.link.frames import CyclicCode, Periodic
from heliograph.units import US_PER_S, bit_us

# Fewest bits a window must hold: less than two frames of seed11 cannot be aligned anyway.
WINDOW_LEAST_BITS: Final = 32
# Parts of a block, at the end of each of which a young track is tried: 8 bits, 4 ms at 2 kbit/s, where the decoder is
# fed every 5 ms.
PARTS: Final = 2
# By which the next frame's end may still move towards us: the clock's steps of a frame at a jitter of a tenth of a bit.
EARLY_BITS: Final = 1.0 / 16.0
NEVER_US: Final = 2**60
# Events held while waiting for a clock: 256 bits at 1 kbit/s hold 4 Mev/s in one region, a flicker of the whole image.
WINDOW_EVENTS: Final = 1_000_000

_SOFT_REFUSALS: Final = {state.WEAK: Refusal.WEAK, state.OCCLUSION: Refusal.OCCLUSION, state.OFF_GRID: Refusal.OFF_GRID}


class CyclicReceiver:
    """Receiver of one track (`heliograph.link.contract.Receiver`).

    Args:
        code: its words.
        bit_rate: nominal bits a second; the beacon's own may differ by 5 %.
        periodic: what becomes of words that are plain square waves (`heliograph.link.frames.Periodic`).
    """

    def __init__(self, code: CyclicCode, bit_rate: float, periodic: Periodic = "refused") -> None:
        self.refusals: Refusals = Counter()
        self._code = code
        self._bit_us = bit_us(bit_rate)
        self._refused_payloads = dict.fromkeys(code.twins, Refusal.AMBIGUOUS)
        if periodic == "refused":
            self._refused_payloads |= dict.fromkeys(code.periodic - code.twins.keys(), Refusal.PERIODIC)
        # Read as frames, a row of them is no identity.
        self._no_beacon = code.periodic if periodic == "read" else frozenset()
        self._known = frozenset(code.words)
        self._nats = one_phase.needed_of(code)
        self._needed = frames_needed(code)
        self._acceptance = Acceptance(self._needed, code.bits, bit_rate, evidence_of(code))
        self._state = state.new_state(code)
        self._origin_us: int | None = None  # of the lock; None while there is no clock
        self._locks = 0
        self._early_lock = False  # begun before enough was seen: what is held may still begin anew
        self._held_us = 0  # until when events are held then
        self._frame_end_us: int | None = None
        self._until_us: int | None = None
        self._blocks = ClockBlocks(self._bit_us, code.bits)
        self._scans = self._blocks.scans
        self._beginner = Beginner(code, self._needed - 1, self._state, self._blocks)
        self._recent: deque[tuple[int, bool]] = deque(maxlen=8192)  # (end, accepted) of the last second's frames

    def feed(self, t_us: Times, on: Flags, until_us: int) -> list[LinkFrame | Text]:
        """Take the events before until_us (see the contract)."""
        if self._until_us is not None and until_us < self._until_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            return []
        if len(t_us) and self._until_us is not None and t_us[0] < self._until_us:
            self.refusals[Refusal.TIME_BACKWARDS] += 1
            start = int(np.searchsorted(t_us, self._until_us))
            t_us, on = t_us[start:], on[start:]
        self._until_us = until_us
        out: list[LinkFrame | Text] = []
        while True:
            if self._origin_us is None:
                t_us, on = self._wait(t_us, on, until_us)
                if self._origin_us is None:
                    return out
            if self._early_lock:
                t_us, on = self._follow_early(t_us, on, until_us, out)
                if self._early_lock:
                    return out
            if self._origin_us is not None:
                t_us, on = self._follow(t_us, on, until_us, out)
                if self._origin_us is not None:
                    return out

    def due_us(self) -> int:
        """Return when the slot at the end of the next frame closes, half a bit behind it; never without an alignment.

        The clock is steered on the way: a little earlier is fed in vain once, a little later is a window late.
        """
        floats, ints = self._state.floats, self._state.ints
        aligned = int(ints[state.ALIGNED])
        if self._origin_us is None or aligned < 0:
            return NEVER_US
        slots = (aligned - int(ints[state.SLOT])) % self._code.bits
        at = float(floats[state.BOUNDARY]) + (slots + 0.5) * float(floats[state.PERIOD])
        if self._scans.scanned is not None:
            at += scans.TOGETHER
        return self._origin_us + int(np.ceil((at - (EARLY_BITS if slots else 0.0)) * self._bit_us))

    def flush(self) -> list[LinkFrame | Text]:
        """Decide the frame that ends within the last bit; the stream has ended."""
        if self._until_us is None:
            return []
        t_us, on = self._blocks.held_t[:0], self._blocks.held_on[:0]
        # What is left of the last block counts as a whole one.
        if self._origin_us is None and len(self._blocks.held_t) and self._attempt(clock.BLOCK_BITS * self._bit_us):
            t_us, on = self._locked()
        if self._origin_us is None:
            return []
        out: list[LinkFrame | Text] = []
        slots = self._scans.ended((self._until_us - self._origin_us) / self._bit_us)
        self._early_lock = False
        self._blocks.drop(len(self._blocks.held_t))
        self._follow(t_us, on, self._until_us + int(slots * self._bit_us) + 1, out)
        return out

    def identity(self) -> Identity | None:
        """Return the accepted identity, or None."""
        return self._acceptance.identity()

    def verdict(self, now_us: int) -> Verdict:
        """Return what the track is at now_us."""
        return self._acceptance.verdict(now_us)

    def quality(self, now_us: int) -> LinkQuality:
        """Return how well the last second was read."""
        while self._recent and self._recent[0][0] <= now_us - US_PER_S:
            self._recent.popleft()
        newest = [ok for end_us, ok in self._recent if now_us - US_PER_S < end_us <= now_us]
        mar = sum(newest) / len(newest) if newest else None
        scanned = None if self._scans.scanned is None else self._scans.figures(self._scans.scanned)
        return quality_of(None if self._origin_us is None else self._state, scanned, self._bit_us, mar)

    def _wait(self, t_us: Times, on: Flags, until_us: int) -> tuple[Times, Flags]:
        """Look for the clock; return the events from the lock's origin on, or none."""
        if len(t_us):
            if self._blocks.since_us is None:
                self._blocks.since_us = int(t_us[0])
            self._acceptance.heard(int(t_us[-1]))
            self._blocks.hold(t_us, on)
        block_us = clock.BLOCK_BITS * self._bit_us
        while len(self._blocks.held_t):
            # A long dark time is skipped, block by block no further than a window reaches back.
            if self._blocks.block - int(self._blocks.held_t[-1] // block_us) > clock.LONG_BLOCKS:
                self._blocks.drop(len(self._blocks.held_t))
                break
            first = int(self._blocks.held_t[0] // block_us)
            if first >= self._blocks.block + clock.LONG_BLOCKS or first < self._blocks.block - clock.LONG_BLOCKS:
                self._blocks.block = first
                self._blocks.clear()
                self._blocks.dark = clock.SHORT_BLOCKS
            if (self._blocks.block + (self._blocks.part + 1) / PARTS) * block_us > until_us:
                break
            self._blocks.part += 1
            if self._early(block_us) if self._blocks.part < PARTS else self._attempt(block_us):
                return self._locked()
        return t_us[:0], on[:0]

    def _locked(self) -> tuple[Times, Flags]:
        """Return the events held from the lock's origin on; of an early lock, those that were looked at are kept."""
        start = int(np.searchsorted(self._blocks.held_t, self._origin_us or 0))
        held = self._blocks.held_t[start:], self._blocks.held_on[start:]
        self._held_us = int(np.ceil(self._blocks.block * clock.BLOCK_BITS * self._bit_us))
        kept = int(np.searchsorted(self._blocks.held_t, self._held_us)) if self._early_lock else 0
        self._blocks.held_t, self._blocks.held_on = self._blocks.held_t[:kept], self._blocks.held_on[:kept]
        return held

    def _follow_early(self, t_us: Times, on: Flags, until_us: int, out: list[LinkFrame | Text]) -> tuple[Times, Flags]:
        """Follow an early lock, block by block, until enough was seen or it is lost; return the events left then."""
        block_us = clock.BLOCK_BITS * self._bit_us
        while True:
            end_us = min(int(np.ceil((self._blocks.block + 1) * block_us)), until_us + 1)
            start, stop = (int(i) for i in np.searchsorted(t_us, (self._held_us, end_us)))
            self._blocks.hold(t_us[start:stop], on[start:stop])
            self._held_us = min(end_us, until_us)
            left = self._follow(t_us[:stop], on[:stop], self._held_us, out)
            t_us, on = t_us[stop:], on[stop:]
            if self._origin_us is not None:
                if end_us > until_us:
                    return t_us, on
                self._blocks.next()
                left = self._decide(block_us)
            if not self._early_lock:
                return np.concatenate([left[0], t_us]), np.concatenate([left[1], on])

    def _decide(self, block_us: float) -> tuple[Times, Flags]:
        """Confirm an early lock where enough was seen, or begin anew; return what is to follow from a new origin."""
        end_us = self._blocks.block * block_us
        seen = (end_us - (self._blocks.since_us or 0)) / block_us
        if self._scans.settled(seen):
            self._early_lock = False
            self._blocks.look(self._blocks.held_t, self._blocks.held_on, self._blocks.block, rare=True)
            blocks = min(clock.LONG_BLOCKS, math.ceil(seen))
            peaks = self._blocks.peaks(blocks, min(blocks, seen), clock.THRESHOLD_LONG)
            turns = peaks[2]
            anew = turns[0, 1] >= clock.THRESHOLD_LONG and not self._scans.in_step(blocks, turns)
            if anew and self._lock(peaks, clock.THRESHOLD_LONG, end_us - blocks * block_us, end_us, blocks):
                self._early_lock = False
                return self._locked()
        self._blocks.drop(max(len(self._blocks.held_t) - (WINDOW_EVENTS if self._early_lock else 0), 0))
        return self._blocks.held_t[:0], self._blocks.held_on[:0]

    def _attempt(self, block_us: float) -> bool:
        """Take in the next whole block and look for the clock in the windows that end with it."""
        start, stop, end_us = self._blocks.next()
        since_us = self._blocks.since_us or 0
        if stop > start and self._try(None, end_us, end_us, block_us):
            return True
        if stop > start and end_us - since_us >= WINDOW_LEAST_BITS * self._bit_us:
            windows = [(clock.SHORT_BLOCKS, clock.THRESHOLD_SHORT)]
            # A quarter more of a long window rarely tells more than the last one did, and most tracks are clutter that
            # no window finds a clock in: so the long one is looked at once for a short one's length.
            if self._blocks.block % clock.SHORT_BLOCKS == 0:
                windows.append((clock.LONG_BLOCKS, clock.THRESHOLD_LONG))
            elif end_us - since_us < clock.LONG_BLOCKS * block_us:
                # A young track may be a beacon whose word has few edges: 64 bits of it stay just below the threshold.
                windows.append((2 * clock.SHORT_BLOCKS, clock.THRESHOLD_LONG))
            for blocks, threshold in windows:
                peaks = self._blocks.peaks(blocks, min(blocks, (end_us - since_us) / block_us), threshold)
                if max(found[0, 1] for found in peaks) >= threshold and self._lock(
                    peaks, threshold, end_us - blocks * block_us, end_us, blocks
                ):
                    return True
            # Once for a short window's length, so that a light that needs a long one is not given up before.
            if end_us - since_us >= clock.SHORT_BLOCKS * block_us and self._blocks.block % clock.SHORT_BLOCKS == 0:
                self.refusals[Refusal.NO_CLOCK] += 1
                self._acceptance.refuse()
        keep_us = end_us - (clock.LONG_BLOCKS - 1) * block_us
        self._blocks.drop(max(int(np.searchsorted(self._blocks.held_t, keep_us)), stop - WINDOW_EVENTS))
        return False

    def _early(self, block_us: float) -> bool:
        """Try the clock of a young track with a part of the next block."""
        begin_us = self._blocks.block * block_us
        end_us = begin_us + self._blocks.part / PARTS * block_us
        if not self._young(end_us, block_us):
            return False
        start, stop = (int(i) for i in np.searchsorted(self._blocks.held_t, (begin_us, end_us)))
        if stop == 0:
            return False
        t: clock.Floats = np.asarray((self._blocks.held_t[start:stop] - begin_us) / self._bit_us, np.float64)
        return self._try((t, self._blocks.held_on[start:stop]), end_us, begin_us + block_us, block_us)

    def _young(self, end_us: float, block_us: float) -> bool:
        """Return whether a track has shown as many frames as an identity takes, and not yet a long window."""
        since_us = self._blocks.since_us or 0
        return self._needed * self._code.bits * self._bit_us <= end_us - since_us < clock.LONG_BLOCKS * block_us

    def _try(
        self, more: tuple[clock.Floats, Flags] | None, end_us: float, blocks_end_us: float, block_us: float
    ) -> bool:
        """Lock to a likely clock, in a short window or in all since a young track began, if its code repeats."""
        since_us = self._blocks.since_us or 0
        if end_us - since_us < self._needed * self._code.bits * self._bit_us:
            return False
        all_blocks = int(np.ceil((blocks_end_us - since_us) / block_us))
        windows = [min(clock.SHORT_BLOCKS, all_blocks)]
        if windows[0] < all_blocks and self._young(end_us, block_us):
            windows.append(min(all_blocks, clock.LONG_BLOCKS))
        for blocks in windows:
            peaks = self._blocks.tried(blocks, more, trial.THRESHOLD)
            if max(found[0, 1] for found in peaks) < trial.THRESHOLD:
                continue
            begin_us = max(blocks_end_us - blocks * block_us, float(since_us))
            if self._lock(peaks, trial.THRESHOLD, begin_us, end_us, blocks, tried=True):
                return True
        return False

    def _lock(
        self,
        peaks: Peaks,
        threshold: float,
        begin_us: float,
        end_us: float,
        blocks: int,
        *,
        tried: bool = False,
    ) -> bool:
        """Begin with a clock found in a window, if what was found is one; the events before it are dropped."""
        origin_us = int(np.floor(begin_us))
        start, stop = (int(i) for i in np.searchsorted(self._blocks.held_t, (begin_us, end_us)))
        window = Window(
            t=(self._blocks.held_t[start:stop] - origin_us) / self._bit_us,
            on=self._blocks.held_on[start:stop],
            until=(end_us - origin_us) / self._bit_us,
            blocks=blocks,
            begin_us=begin_us - origin_us,
            last_end=NEVER if self._frame_end_us is None else (self._frame_end_us - origin_us) / self._bit_us,
            seen=(end_us - max(begin_us, float(self._blocks.since_us or 0))) / (clock.BLOCK_BITS * self._bit_us),
            read_out=one_phase.read_out(self._blocks.held_t[start:stop] / self._bit_us),
        )
        if not self._beginner.begin(window, peaks, threshold, tried=tried):
            return False
        if self._scans.scanned is None:
            self._early_lock = window.seen < clock.LONG_BLOCKS and self._scans.hides(window.t)
        else:
            self._early_lock = not tried and not self._scans.enough(window.seen)
        if not self._early_lock:
            self._blocks.drop(start)
        self._origin_us = origin_us
        self._locks += 1
        return True

    def _follow(self, t_us: Times, on: Flags, until_us: int, out: list[LinkFrame | Text]) -> tuple[Times, Flags]:
        """Demodulate; return the events that are left when the clock is lost."""
        origin_us = self._origin_us
        if origin_us is None:
            return t_us, on
        t = (t_us - origin_us) / self._bit_us
        until = (until_us - origin_us) / self._bit_us
        done = 0
        while True:
            if (scanned := self._scans.scanned) is None:
                outcome, taken = demodulator.advance(t[done:], on[done:], until, self._state)
            else:
                outcome, taken = scan_demodulator.advance(t[done:], on[done:], until, self._state, scanned)
            done += taken
            self._settle(origin_us, out)
            if outcome == demodulator.DONE:
                break
            if outcome == demodulator.LOST:
                # From here on the search begins anew, with what the lost lock has not taken.
                lost = self._state.floats[state.BOUNDARY] - 0.5 * self._state.floats[state.PERIOD]
                self._origin_us = None
                self._scans.scanned = None
                if self._early_lock and self._doubted():
                    return t_us[:0], on[:0]
                self._blocks.since_us = origin_us + int(np.ceil(lost * self._bit_us))
                self._blocks.block = int(self._blocks.since_us // (clock.BLOCK_BITS * self._bit_us))
                self._blocks.clear()
                break
        return t_us[done:], on[done:]

    def _doubted(self) -> bool:
        """Return whether an early lock was lost though there is light: then what is held and will be decides."""
        self._early_lock = False
        self._scans.doubted = int(self._state.ints[state.SILENT]) <= demodulator.SILENT_FRAMES * self._code.bits
        # What no window reaches back to is not looked at again, else the search would begin there anew, for ever.
        oldest_us = (self._blocks.block - clock.LONG_BLOCKS + 1) * clock.BLOCK_BITS * self._bit_us
        stale = int(np.searchsorted(self._blocks.held_t, oldest_us))
        self._blocks.drop(stale if self._scans.doubted else len(self._blocks.held_t))
        return self._scans.doubted

    def _settle(self, origin_us: int, out: list[LinkFrame | Text]) -> None:
        """Turn the demodulator's records into frames and refusals."""
        floats, ints, acceptance = self._state.floats, self._state.ints, self._acceptance
        heard = float(floats[state.BOUNDARY]) - (int(ints[state.SILENT]) + 1) * float(floats[state.PERIOD])
        acceptance.heard(origin_us + round(heard * self._bit_us))
        records = self._state.out[: ints[state.OUT]].tolist()
        ints[state.OUT] = 0
        for end, code, score, margin, slot, grid in records:
            end_us = origin_us + round(end * self._bit_us)
            reason = self._reason(int(code))
            self._recent.append((end_us, reason is None))
            if reason is not None:
                self.refusals[reason] += 1
                if reason is not Refusal.OCCLUSION:
                    acceptance.refuse()
                continue
            frame = LinkFrame(end_us, int(code), min(score, 1.0), margin)
            self._frame_end_us = end_us
            is_lamp = int(code) in self._no_beacon
            on_grid = grid >= self._nats[int(code)] and not is_lamp
            if acceptance.frame(frame, Place(self._locks, int(slot)), on_grid=on_grid):
                self.refusals[Refusal.PAYLOAD_CHANGED] += 1
            elif acceptance.held_back:
                self.refusals[Refusal.PERIODIC if is_lamp else Refusal.OFF_GRID] += 1
            out.append(frame)

    def _reason(self, code: int) -> Refusal | None:
        if code >= 0:
            return self._refused_payloads.get(code)
        if code > state.HARD:
            return _SOFT_REFUSALS[code]
        word = state.HARD - code
        if word not in self._known:
            return self._code.hard_refusal(word)
        # Read clearly, but not at a position of its own: as two payloads, or as one that will not stay in its place.
        return self._refused_payloads.get(self._code.words.index(word), Refusal.WEAK)
