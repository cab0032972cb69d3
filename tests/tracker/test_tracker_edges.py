"""A beacon that comes out from under a moving board is found while the board's edge still touches it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from heliograph.streams import Onsets
from heliograph_services.tracker import follower
from support.onset_scenes import Disc, Scene, line
from support.tracker_runs import feed_all, new_core

# The board's edge runs to the right and has uncovered the whole disc at x = 103.
SPEED_PX_S = 200.0
X_PX = 40.0
UNCOVERED_US = round((103 - X_PX) / SPEED_PX_S * 1e6)


@dataclass(frozen=True)
class Board(Scene):
    """A scene in which the pixels that the edge crosses become brighter, and what lies ahead of it is covered."""

    def cover(self, disc: Disc, t_s: float) -> npt.NDArray[np.int64]:
        pixel = super().cover(disc, t_s)
        return pixel[pixel % self.width < X_PX + SPEED_PX_S * t_s]

    def with_edge(self, seconds: float) -> Iterator[Onsets]:
        """Yield the onsets with the edge's, a tick a message."""
        for m in self.onsets(seconds, ticks_a_message=1):
            x = X_PX + SPEED_PX_S * np.array([m.t0_us, m.t1_us]) / 1e6
            xx, yy = (a.ravel() for a in np.meshgrid(np.arange(int(x[0]) - 2, int(x[1]) + 1), np.arange(40, 160)))
            image = np.zeros((2, self.height, self.width), np.int64)
            image[0, yy, xx] += 2
            for i, count in enumerate((m.on_count, m.off_count)):
                image[i, m.y_px, m.x_px] += count
            y_px, x_px = np.nonzero(image.sum(axis=0))
            on, off = (image[i, y_px, x_px].astype(np.uint8) for i in range(2))
            columns = {"x_px": x_px.astype(np.uint16), "y_px": y_px.astype(np.uint16), "on_count": on, "off_count": off}
            yield Onsets(
                camera=m.camera, stream=m.stream, width=m.width, height=m.height, t0_us=m.t0_us, t1_us=m.t1_us,
                tick_us=m.tick_us, pool_px=1, tick=np.zeros(len(x_px), np.uint16), **columns,
            )  # fmt: skip


def born_us() -> int:
    """Return when a track at the beacon is first published; its place is right from then on."""
    scene = Board((Disc(line(100, 100), bit_rate=2000.0),), step_us=250)
    for m in feed_all(new_core(), scene.with_edge(0.6)):
        near = [abs(x - 100) < 3 and abs(y - 100) < 3 for x, y in zip(m.x_px, m.y_px, strict=True)]
        if any(near):
            return m.as_of_us
    return 10**9


def test_an_uncovered_beacon_is_published_within_20_ms_though_the_edge_touches_it() -> None:
    assert born_us() <= UNCOVERED_US + 20_000


def test_it_would_be_late_if_what_blinks_were_not_told_from_what_is_crossed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follower, "carve", lambda *_: None)
    assert born_us() > UNCOVERED_US + 20_000
