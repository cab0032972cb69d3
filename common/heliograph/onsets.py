"""Onsets: from raw events to the compact stream that a tracker reads, gated and pooled at the source.

For each tick [t, t + tick_us) and each pooled pixel (X, Y) = (x // pool_px, y // pool_px)::

    on_count  = min(15, brighter events)         off_count = min(15, darker events)

Gate "open": every pooled pixel with an event is an entry. Gate "active": of these, the ones around which, in the 3x3
pooled pixels of this tick and of the tick before, at least m events lie, their own included; what stands alone in
space and time is noise, and is counted. m follows the noise of the stream itself, lambda events a pixel and tick::

    m       the least m >= min_events, at most 8, with   R P(N(lambda) >= 1) P(N(17 lambda) >= m - 1) <= noise_hz
    lambda  of `EPOCH_US`: the lower quartile of the events in blocks of 32x32 pixels, smoothed

N is Poisson's, R is pixels times ticks a second, so about noise_hz entries of noise a second pass; texture everywhere
raises m too. Within the first epoch, lambda is that of the ticks so far; the first tick has m = min_events.

An entry is *light* (`OnsetColumns.light`) if two of the 3x3 pixels around it blink. A pixel flips where its polarity
differs from that of its last entry, or where one tick holds both; it blinks for `memory_us` after the last but one of
its flips (a tick of two events of both polarities is two flips). An edge that crosses flips a pixel once, with the one
that follows it twice, and a texture does it seldom; a code does it at every bit or two.

A tick with more entries than a message can carry is a flash over the whole sensor, which says nothing of where a
beacon is: it is emptied, and counted.
"""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

from heliograph.events import EventBatch
from heliograph.onset_columns import COUNT_LIMIT, TICK_ENTRIES_LIMIT
from heliograph.onset_entries import Gate, OnsetColumns, OnsetSettings
from heliograph.units import US_PER_S

__all__ = ["TICK_ENTRIES_LIMIT", "Gate", "OnsetColumns", "OnsetCounter", "OnsetSettings", "warm"]

TICKS_LIMIT: Final = 65_535
# A block of 32x32 pixels sees 120 events of .4 Mev/s of VGA noise in it: its quartile is 6 % low.
EPOCH_US: Final = 100_000
BLOCK_SHIFT: Final = 5
SMOOTHING: Final = 0.25
# 4 px that fire twice, the faintest target that a tracker may find under noise of 2 Mev/s and more of VGA; up to there
# m is 5 or less, a tracker's own min_events. It keeps 5 Mev/s of noise to 2,600 entries a second; 5 let 240,000 pass.
THRESHOLD_LIMIT: Final = 8

# Kernel tables, indices and masks; a de Bruijn sequence gives the place of a word's only bit, for which numba has no
# instruction: 64 different windows of 6 bits (any B(2, 6) does).
_DE_BRUIJN: Final = 0x03F79D71B4CB0A89
_BIT_PLACE: Final = np.zeros(64, np.int64)
for _place in range(64):
    _BIT_PLACE[((_DE_BRUIJN << _place) & (2**64 - 1)) >> 58] = _place
_LOW: Final = np.uint16(0x00FF)
_ONE_ON: Final = np.uint16(0x0001)
_ONE_OFF: Final = np.uint16(0x0100)
# Flips are remembered as the low 32 bits of their tick: at 100 us a tick, one that is five days old looks new.
_WORD: Final = 0xFFFF_FFFF
_LONG_AGO: Final = 1 << 31
# Places in the counter's whole numbers.
_BEFORE, _HALF, _SINCE, _EPOCHS, _THRESHOLD, _GATED, _FLOODED, _OFF_SENSOR, _WHOLE = range(9)


class OnsetCounter:
    """Counts the events of one stream by tick and pixel; ticks must not fall from call to call, but may be left out.

    Args:
        settings: the sensor and the gate.
    """

    def __init__(self, settings: OnsetSettings) -> None:
        self._settings = s = settings
        columns, rows = -(-s.width // s.pool_px), -(-s.height // s.pool_px)
        # A margin of one pixel all around spares the gate's neighbourhood every test for the border.
        self._stride = columns + 2
        cells = (rows + 2) * self._stride
        # Of this tick and the one before, in turns: on_count + 256 * off_count, and a bit for each that is not 0.
        self._counts = np.zeros((2, cells), np.uint16)
        self._marks = np.zeros((2, cells // 64 + 1), np.uint64)
        self._flips = np.empty((2, cells), np.uint32)  # the last, and the one before it
        self._sign = np.zeros(cells, np.int8)
        self._epoch_ticks = max(1, EPOCH_US // s.tick_us)
        # The blocks at the right and at the bottom may be smaller.
        wide, high = _cut(columns), _cut(rows)
        self._across = len(wide)
        self._blocks = np.zeros(len(wide) * len(high), np.int64)
        self._block_sizes = np.outer(high, wide).ravel().astype(np.float64)
        self._column = (np.arange(s.width) // s.pool_px + 1).astype(np.int64)
        self._row = ((np.arange(s.height) // s.pool_px + 1) * self._stride).astype(np.int64)
        ticks_s = US_PER_S / s.tick_us
        adaptive = s.gate == "active" and s.noise_hz > 0
        self._noise_share = s.noise_hz / (columns * rows * ticks_s) if adaptive else 1.0
        # The open gate asks for one event, which every entry has.
        self._least = s.min_events if s.gate == "active" else 1
        # Nobody asks what blinks where everything passes.
        self._memory = max(1, s.memory_us // s.tick_us) if s.gate == "active" else 0
        self._noise = np.zeros(1, np.float64)
        self._whole = np.zeros(_WHOLE, np.int64)
        self._began = False

    @property
    def noise_hz(self) -> float:
        """What the stream's noise was last taken for, events a second on the whole sensor; 0 while nobody asks."""
        return float(self._noise[0]) * float(self._block_sizes.sum()) * US_PER_S / self._settings.tick_us

    @property
    def threshold(self) -> int:
        """The events that the gate asks for now."""
        return int(self._whole[_THRESHOLD])

    def reset(self) -> None:
        """Forget everything: a new stream begins."""
        self._began = False

    def _begin(self, tick: int) -> None:
        for array in (self._counts, self._marks, self._sign, self._blocks, self._noise, self._whole):
            array.fill(0)
        self._flips.fill((tick - _LONG_AGO) & _WORD)
        self._whole[_BEFORE] = tick - 2
        self._whole[_SINCE] = tick
        self._whole[_THRESHOLD] = self._least
        self._began = True

    def count(self, batch: EventBatch, t0_us: int, t1_us: int) -> OnsetColumns:
        """Return the entries of the ticks of [t0_us, t1_us).

        Args:
            batch: n events of this window, sorted by time.
            t0_us: beginning of the first tick; a multiple of tick_us, as every tick begins at one.
            t1_us: end of the last tick: t0_us plus a multiple of tick_us.

        Raises:
            ValueError: the window is not made of 0 to 65535 whole ticks, or an event lies outside it.
        """
        s = self._settings
        n = len(batch)
        if t0_us % s.tick_us or t1_us % s.tick_us or not 0 <= t1_us - t0_us <= TICKS_LIMIT * s.tick_us:
            raise ValueError(f"[{t0_us}, {t1_us}) must hold 0 to {TICKS_LIMIT} whole ticks of {s.tick_us} us")
        if n and not t0_us <= batch.t_us[0] <= batch.t_us[-1] < t1_us:
            raise ValueError(f"events must lie in [{t0_us}, {t1_us}), not at {batch.t_us[0]} to {batch.t_us[-1]} us")
        if not self._began:
            self._begin(t0_us // s.tick_us)
        tick, x_px, y_px = np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint16)
        on_count, off_count = np.empty(n, np.uint8), np.empty(n, np.uint8)
        light, cell = np.empty(n, np.bool_), np.empty(n, np.int64)
        self._whole[[_GATED, _FLOODED, _OFF_SENSOR]] = 0
        t_us, xs_px, ys_px, on = (_read_only(column) for column in (batch.t_us, batch.x_px, batch.y_px, batch.on))
        kept = _count(
            t_us, xs_px, ys_px, on, t0_us, s.tick_us, self._column, self._row, self._stride, self._least,
            self._noise_share, self._memory, self._epoch_ticks, self._counts, self._marks, self._flips,
            self._sign, self._blocks, self._block_sizes, self._across, self._noise, self._whole, _BIT_PLACE,
            tick, x_px, y_px, on_count, off_count, light, cell,
        )  # fmt: skip
        gated, flooded, off_sensor = self._whole[[_GATED, _FLOODED, _OFF_SENSOR]].tolist()
        return OnsetColumns(
            tick[:kept], x_px[:kept], y_px[:kept], on_count[:kept], off_count[:kept], light[:kept],
            gated, flooded, off_sensor,
        )  # fmt: skip


def _cut(length: int) -> npt.NDArray[np.int64]:
    """Return the lengths of the blocks that a side is cut into."""
    return np.diff(np.append(np.arange(0, length, 1 << BLOCK_SHIFT), length))


def _read_only(column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a view that cannot be written: numba compiles anew for each mixture of writable and read-only columns."""
    view = column.view()
    view.flags.writeable = False
    return view


@numba.njit(cache=True, nogil=True)
def _threshold(noise: float, share: float, least: int) -> int:
    """Return m of the module's gate; `share` is noise_hz / R."""
    # P(N(17 lambda) >= m - 1) by the series of P(N = m).
    own = -np.expm1(-noise)
    m, term, tail = 1, np.exp(-17.0 * noise), 1.0
    while m < least or (m < THRESHOLD_LIMIT and own * tail > share):
        tail -= term
        term *= 17.0 * noise / m
        m += 1
    return m


@numba.njit(cache=True, nogil=True)
def _read_noise(tick: int, share: float, least: int, blocks: Any, sizes: Any, noise: Any, whole: Any) -> None:
    """Take the noise of the ticks from the epoch's first to the one before `tick`; set the threshold."""
    rates = np.sort(blocks / (sizes * (tick - whole[_SINCE])))
    quartile = rates[len(rates) // 4]
    noise[0] = quartile if whole[_EPOCHS] == 0 else noise[0] + SMOOTHING * (quartile - noise[0])
    whole[_THRESHOLD] = _threshold(noise[0], share, least)


@numba.njit(cache=True, nogil=True)
def _begin_tick(
    tick: int, epoch_ticks: int, share: float, least: int, blocks: Any, sizes: Any, noise: Any, whole: Any
) -> None:
    """Read the noise where an epoch has ended; in the first one, at every tick."""
    ended = tick // epoch_ticks != whole[_SINCE] // epoch_ticks
    if share < 1.0 and tick > whole[_SINCE] and (ended or whole[_EPOCHS] == 0):
        _read_noise(tick, share, least, blocks, sizes, noise, whole)
    if ended:
        blocks[:] = 0
        whole[_SINCE] = tick // epoch_ticks * epoch_ticks
        whole[_EPOCHS] += 1


@numba.njit(cache=True, nogil=True)
def _clear(half: int, counts: Any, marks: Any, places: Any) -> None:
    """Empty one of the two ticks."""
    for w in range(marks.shape[1]):
        bits = marks[half, w]
        while bits != 0:
            low = bits & (~bits + np.uint64(1))
            bits ^= low
            counts[half, w * 64 + places[(low * np.uint64(_DE_BRUIJN)) >> np.uint64(58)]] = 0
        marks[half, w] = 0


@numba.njit(cache=True, nogil=True)
def _around(counts: Any, half: int, p: int, stride: int, enough: int) -> bool:
    """Whether the 3x3 around p hold enough events in both ticks; stops at the first moment at which they do."""
    total = np.int64(0)
    for h in (half, 1 - half):
        for base in (p, p - stride, p + stride):
            for q in range(base - 1, base + 2):
                c = counts[h, q]
                total += np.int64(c & _LOW) + np.int64(c >> 8)
            if total >= enough:
                return True
    return False


@numba.njit(cache=True, nogil=True)
def _flip(p: int, c: np.uint16, now: np.uint32, flips: Any, sign: Any) -> None:
    """Note what the counts c of this tick say about whether pixel p blinks."""
    on, off = np.int64(c & _LOW), np.int64(c >> 8)
    n = 0
    if on > 0 and off > 0:
        n = 2 if on > 1 and off > 1 else 1
        sign[p] = 0
    else:
        s = 1 if on > 0 else -1
        n = 1 if sign[p] == -s else 0
        sign[p] = s
    if n > 0:
        flips[1, p] = flips[0, p] if n == 1 else now
        flips[0, p] = now


@numba.njit(cache=True, nogil=True)
def _light(p: int, stride: int, now: int, memory: int, flips: Any) -> bool:
    """Whether two of the 3x3 around p blink."""
    n = 0
    for base in (p, p - stride, p + stride):
        for q in range(base - 1, base + 2):
            if (now - np.int64(flips[1, q])) & _WORD <= memory:
                n += 1
                if n == 2:
                    return True
    return False


@numba.njit(cache=True, nogil=True)
def _finish_tick(
    tick: int, now: int, stride: int, memory: int, counts: Any, marks: Any, flips: Any, sign: Any, blocks: Any,
    across: int, whole: Any, places: Any, kept: int, tick_out: Any, x_out: Any, y_out: Any, on_out: Any, off_out: Any,
    light_out: Any, cells: Any,
) -> int:  # fmt: skip
    """Write a tick's entries from index kept on, make it the tick before; return kept."""
    half = whole[_HALF]
    if whole[_BEFORE] != now - 1:
        _clear(1 - half, counts, marks, places)
    first, gated, enough = kept, 0, whole[_THRESHOLD]
    word = np.uint32(now & _WORD)
    row, row_end = 0, stride
    for w in range(marks.shape[1]):
        bits = marks[half, w]
        while bits != 0:
            low = bits & (~bits + np.uint64(1))
            bits ^= low
            p = w * 64 + places[(low * np.uint64(_DE_BRUIJN)) >> np.uint64(58)]
            while p >= row_end:
                row += 1
                row_end += stride
            c = counts[half, p]
            own = np.int64(c & _LOW) + np.int64(c >> 8)
            x = p - (row_end - stride) - 1
            blocks[((row - 1) >> BLOCK_SHIFT) * across + (x >> BLOCK_SHIFT)] += own
            if own < enough and not _around(counts, half, p, stride, enough):
                gated += 1
                continue
            if memory > 0:
                _flip(p, c, word, flips, sign)
            tick_out[kept] = tick
            x_out[kept] = x
            y_out[kept] = row - 1
            on_out[kept] = min(COUNT_LIMIT, np.int64(c & _LOW))
            off_out[kept] = min(COUNT_LIMIT, np.int64(c >> 8))
            cells[kept] = p
            kept += 1
    for i in range(first, kept):
        light_out[i] = memory > 0 and _light(cells[i], stride, now, memory, flips)
    _clear(1 - half, counts, marks, places)
    whole[_BEFORE] = now
    whole[_HALF] = 1 - half
    whole[_GATED] += gated
    if kept - first > TICK_ENTRIES_LIMIT:
        whole[_FLOODED] += 1
        return first
    return kept


@numba.njit(cache=True, nogil=True)
def _count(
    t_us: Any, x_px: Any, y_px: Any, on: Any, t0_us: int, tick_us: int, column: Any, row: Any, stride: int, least: int,
    share: float, memory: int, epoch_ticks: int, counts: Any, marks: Any, flips: Any, sign: Any, blocks: Any,
    sizes: Any, across: int, noise: Any, whole: Any, places: Any, tick_out: Any, x_out: Any, y_out: Any, on_out: Any,
    off_out: Any, light_out: Any, cells: Any,
) -> int:  # fmt: skip
    """Return the number of entries written; how many were gated, flooded or off the sensor is added to `whole`."""
    kept, i, n = 0, 0, len(t_us)
    first = t0_us // tick_us
    while i < n:
        tick = (t_us[i] - t0_us) // tick_us
        tick_end = t0_us + (tick + 1) * tick_us
        _begin_tick(first + tick, epoch_ticks, share, least, blocks, sizes, noise, whole)
        half = whole[_HALF]
        while i < n and t_us[i] < tick_end:
            x, y, brighter = x_px[i], y_px[i], on[i]
            i += 1
            if x >= len(column) or y >= len(row):
                whole[_OFF_SENSOR] += 1
                continue
            p = row[y] + column[x]
            c = counts[half, p]
            if c == 0:
                marks[half, p >> 6] |= np.uint64(1) << np.uint64(p & 63)
            if brighter:
                if c & _LOW != _LOW:
                    counts[half, p] = c + _ONE_ON
            elif c >> 8 != 255:
                counts[half, p] = c + _ONE_OFF
        kept = _finish_tick(
            tick, first + tick, stride, memory, counts, marks, flips, sign, blocks, across, whole, places, kept,
            tick_out, x_out, y_out, on_out, off_out, light_out, cells,
        )  # fmt: skip
    return kept


def warm() -> None:
    """Compile or load the kernels, so that the first real window waits for nothing."""
    one = EventBatch(np.zeros(1, np.int64), np.zeros(1, np.uint16), np.zeros(1, np.uint16), np.ones(1, np.bool_))
    OnsetCounter(OnsetSettings(width=1, height=1, tick_us=1)).count(one, 0, 1)
