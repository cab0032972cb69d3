"""The table of tracks: one row a track, one array a column, rows in the order of birth.

A row is in birth (`number` -1) until it is confirmed; then it has a number, which it may exchange with another row's
(`identity`); a number that has ended is never used again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.messages import StatusWord

Floats = npt.NDArray[np.float64]
Longs = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

WORDS: Final[tuple[StatusWord, ...]] = ("new", "valid", "invalid")
NEW: Final = 0
VALID: Final = 1
INVALID: Final = 2
UNNAMED: Final = -1
NEVER: Final = -(2**62)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The published tracks at one instant, by rising number; the columns of heliograph.messages.Tracks."""

    number: list[int]
    born_us: list[int]
    seen_us: list[int]
    x_px: list[float]
    y_px: list[float]
    vx_px_s: list[float]
    vy_px_s: list[float]
    x_var_px2: list[float]
    x_vx_cov_px2_s: list[float]
    vx_var_px2_s2: list[float]
    y_var_px2: list[float]
    y_vy_cov_px2_s: list[float]
    vy_var_px2_s2: list[float]
    radius_px: list[float]
    size_px: list[float]
    polarity: list[float]
    status: list[StatusWord]


@dataclass(slots=True)
class Numbers:
    """The next track's number, across streams; never falls."""

    next: int = 0

    def take(self) -> int:
        """Return a number and never again the same."""
        self.next += 1
        return self.next - 1


class TrackTable:
    """Struct of arrays of n rows.

    Attributes:
        number: (n,) int64; UNNAMED while in birth.
        born_us: (n,) int64, begin of the window of the first target.
        seen_us: (n,) int64, end of the window of the last target.
        invalid_us: (n,) int64, since when the decoder calls it invalid, else NEVER.
        hits: (n,) int64, windows with a target that has the shape of a light.
        blinks: (n,) int64, windows that show a blinking light and no crossing edge (`shape.BOTH_SHARE`).
        blink_us: (n,) int64, end of the last of them; of the first window if there was none.
        habit: (n,) float64, share of the windows that a switched light may have made, smoothed (`sighting`).
        shine: (n,) float64, share of the windows that a moving light may have made, smoothed (`sighting`).
        sign: (n,) int64, of the last clear polarity: 1, -1, or 0 before there was one.
        status: (n,) int64, index into WORDS.
        radius_px: (n,) float64, covers nine tenths of the target's pixels, smoothed.
        size_px: (n,) float64, distinct sensor pixels of the target, smoothed.
        polarity: (n,) float64, of the last target.
        state: (n, 4) float64, see `kalman`.
        cov: (n, 6) float64.
        read: (n,) bool, whether it was ever valid.
        flow_px_s: (n, 2) float64, the last velocity that the flow gave; nan before.
        q: (n,) float64, px^2/s^3, the acceleration that it is believed capable of (`sighting`).
        lag_px: (n, 2) float64, mean of the last innovations.
        power_px2: (n,) float64, mean of their squares.
        turn_rad_s: (n,) float64, how fast its course turns (`turning`).
    """

    COLUMNS: Final = (
        "number", "born_us", "seen_us", "invalid_us", "hits", "blinks", "blink_us", "habit", "shine", "sign", "status",
        "read", "radius_px", "size_px", "polarity", "state", "cov", "flow_px_s", "q", "lag_px", "power_px2",
        "turn_rad_s",
    )  # fmt: skip

    def __init__(self) -> None:
        self.number: Longs = np.empty(0, np.int64)
        self.born_us: Longs = np.empty(0, np.int64)
        self.seen_us: Longs = np.empty(0, np.int64)
        self.invalid_us: Longs = np.empty(0, np.int64)
        self.hits: Longs = np.empty(0, np.int64)
        self.blinks: Longs = np.empty(0, np.int64)
        self.blink_us: Longs = np.empty(0, np.int64)
        self.habit: Floats = np.empty(0, np.float64)
        self.shine: Floats = np.empty(0, np.float64)
        self.sign: Longs = np.empty(0, np.int64)
        self.status: Longs = np.empty(0, np.int64)
        self.read: Flags = np.empty(0, np.bool_)
        self.radius_px: Floats = np.empty(0, np.float64)
        self.size_px: Floats = np.empty(0, np.float64)
        self.polarity: Floats = np.empty(0, np.float64)
        self.state: Floats = np.empty((0, 4), np.float64)
        self.cov: Floats = np.empty((0, 6), np.float64)
        self.flow_px_s: Floats = np.empty((0, 2), np.float64)
        self.q: Floats = np.empty(0, np.float64)
        self.lag_px: Floats = np.empty((0, 2), np.float64)
        self.power_px2: Floats = np.empty(0, np.float64)
        self.turn_rad_s: Floats = np.empty(0, np.float64)

    def __len__(self) -> int:
        return len(self.number)

    @property
    def named(self) -> Flags:
        """(n,) bool: the rows that are published."""
        return self.number >= 0

    def keep(self, mask: Flags) -> None:
        """Drop the other rows; the order stays."""
        for name in self.COLUMNS:
            setattr(self, name, getattr(self, name)[mask])

    def append(
        self,
        *,
        xy_px: Floats,
        var_px2: Floats,
        radius_px: Floats,
        size_px: Floats,
        polarity: Floats,
        blinks: Flags,
        sign: Longs,
        born_us: int,
        seen_us: int,
        speed_var: Floats | float,
        q: float = 0.0,
        v_px_s: Floats | None = None,
        cross: Floats | float = 0.0,
    ) -> None:
        """Add k rows in birth.

        Args:
            xy_px: (k, 2) float64.
            var_px2: (k, 2) float64, of the place on each axis; or (k,), of both.
            radius_px: (k,) float64.
            size_px: (k,) float64.
            polarity: (k,) float64.
            blinks: (k,) bool, whether the first window shows it.
            sign: (k,) int64, of a clear polarity, else 0.
            born_us: of all.
            seen_us: of all.
            speed_var: (k, 2) float64, or one, variance of the unknown speed on each axis, (px/s)^2.
            q: of all, px^2/s^3; a sighting raises it to what is allowed at least.
            v_px_s: (k, 2) float64; None: at rest, as far as is known.
            cross: (k, 2) float64, or one, covariance of place and speed on each axis, px^2/s.
        """
        k = len(xy_px)
        cov = np.zeros((k, 6))
        cov[:, [0, 3]] = var_px2.reshape(k, -1)
        cov[:, [1, 4]] = cross
        cov[:, [2, 5]] = speed_var
        new: dict[str, Floats | Longs | Flags] = {
            "number": np.full(k, UNNAMED, np.int64),
            "born_us": np.full(k, born_us, np.int64),
            "seen_us": np.full(k, seen_us, np.int64),
            "invalid_us": np.full(k, NEVER, np.int64),
            "hits": np.ones(k, np.int64),
            "blinks": blinks.astype(np.int64),
            "blink_us": np.full(k, seen_us, np.int64),
            "habit": np.zeros(k),
            "shine": np.zeros(k),
            "sign": sign,
            "status": np.full(k, NEW, np.int64),
            "read": np.zeros(k, np.bool_),
            "radius_px": radius_px,
            "size_px": size_px,
            "polarity": polarity,
            "state": np.concatenate([xy_px, np.zeros((k, 2)) if v_px_s is None else v_px_s], axis=1),
            "cov": cov,
            "flow_px_s": np.full((k, 2), np.nan),
            "q": np.full(k, q),
            "lag_px": np.zeros((k, 2)),
            "power_px2": np.zeros(k),
            "turn_rad_s": np.zeros(k),
        }
        for name in self.COLUMNS:
            setattr(self, name, np.concatenate([getattr(self, name), new[name]]))

    def judge(self, words: dict[int, StatusWord], at_us: int) -> None:
        """Take the decoder's words, by number; rows it does not name keep theirs."""
        for i in np.flatnonzero(self.named):
            word = words.get(int(self.number[i]))
            if word is None:
                continue
            code = WORDS.index(word)
            if code != INVALID:
                self.invalid_us[i] = NEVER
            elif self.status[i] != INVALID:
                self.invalid_us[i] = at_us
            self.status[i] = code
            self.read[i] |= code == VALID

    def rename(self, number: dict[int, int]) -> None:
        """Give rows other numbers, by the old ones; a number keeps its birth.

        Args:
            number: of each old number, the new one; both named rows.
        """
        born_us = dict(zip(self.number.tolist(), self.born_us.tolist(), strict=True))
        for i in np.flatnonzero(self.named):
            new = number.get(int(self.number[i]))
            if new is not None:
                self.number[i], self.born_us[i] = new, born_us[new]

    def snapshot(self, rows: Longs, state: Floats, cov: Floats) -> Snapshot:
        """Return some rows with the states given for them, rounded to a thousandth, by rising number.

        Covariances are rounded to a tenth of that: those of a track long seen are a few hundredths.
        """
        order = np.argsort(self.number[rows])
        rows, state, cov = rows[order], np.round(state[order], 3) + 0.0, np.round(cov[order], 4) + 0.0
        return Snapshot(
            number=self.number[rows].tolist(),
            born_us=self.born_us[rows].tolist(),
            seen_us=self.seen_us[rows].tolist(),
            x_px=state[:, 0].tolist(),
            y_px=state[:, 1].tolist(),
            vx_px_s=state[:, 2].tolist(),
            vy_px_s=state[:, 3].tolist(),
            x_var_px2=cov[:, 0].tolist(),
            x_vx_cov_px2_s=cov[:, 1].tolist(),
            vx_var_px2_s2=cov[:, 2].tolist(),
            y_var_px2=cov[:, 3].tolist(),
            y_vy_cov_px2_s=cov[:, 4].tolist(),
            vy_var_px2_s2=cov[:, 5].tolist(),
            radius_px=np.round(self.radius_px[rows], 3).tolist(),
            size_px=np.round(self.size_px[rows], 3).tolist(),
            polarity=(np.round(self.polarity[rows], 3) + 0.0).tolist(),
            status=[WORDS[code] for code in self.status[rows]],
        )
