"""Which identities are published: one light is one beacon, and a beacon whose place is not known is lost."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from heliograph.events import EventBatch
from heliograph.messages import Frames, Message, Status, Tracks
from heliograph_services.decoder.core import DecoderCore
from support.blinkers import FRAME_US, Disc, scene, still, straight, tracks
from support.decoding import core, states
from support.decoding import run as decoded

WIDTH, HEIGHT = 320, 240


def run(decoder: DecoderCore, batch: EventBatch, told: Iterable[tuple[int, Tracks]], end_us: int) -> list[Message]:
    return decoded(decoder, batch, told, end_us, (WIDTH, HEIGHT))


def changes(out: Iterable[Message]) -> list[tuple[str, str]]:
    return [(one.track, one.change) for one in states(out) if one.change != "refreshed"]


def test_a_beacon_that_has_left_the_sensor_is_lost_once_and_never_told_outside() -> None:
    disc = Disc(5, straight(200, 120, 400, 0))
    batch = scene([disc], 0, 1_500_000, WIDTH, HEIGHT)
    told = [(t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(0, 300_000, 100_000)]
    # The tracker goes on telling of it, or lets it go: it is lost either way.
    late = [(t + 20_000, tracks(t, [("a-0", disc, 0)])) for t in range(300_000, 900_000, 100_000)]
    for more in ([], late):
        out = run(core(), batch, [*told, *more], 1_500_000)
        assert changes(out) == [("a-0", "accepted"), ("a-0", "lost")]
        lost = states(out)[-1]
        assert lost.change == "lost"
        assert 300_000 <= lost.t_us <= 400_000
        assert max(one.x_px for one in states(out)) < WIDTH + 20


def test_a_beacon_that_is_dark_for_a_moment_is_not_lost_and_one_hidden_is_found_again_with_its_first_frame() -> None:
    # It turns, so that nobody knows where it is after a second.
    def path(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return 160 + 60 * np.cos(s / 0.3), 120 + 60 * np.sin(s / 0.3)

    for dark_us, expected in ((90_000, ["accepted"]), (900_000, ["accepted", "lost", "accepted"])):
        discs = [Disc(5, path, lit_us=(0, 500_000)), Disc(5, path, lit_us=(500_000 + dark_us, 9_000_000))]
        batch = scene(discs, 0, 2_000_000, WIDTH, HEIGHT)
        hidden = range(500_000, 500_000 + dark_us)
        told = []
        for t in range(0, 2_000_000, 100_000):
            row = tracks(t, [("a-0", discs[0], 0)])
            # Unseen: the tracker carries it on, and is no surer than half a second of turning allows.
            told.append((t + 20_000, unseen(row, 500_000) if t in hidden else row))
        out = run(core(), batch, told, 2_000_000)
        assert [change for _, change in changes(out)] == expected
        if len(expected) == 3:
            again = [one for one in states(out) if one.change == "accepted"][1]
            assert again.t_us <= 500_000 + dark_us + 3 * FRAME_US
            assert again.frames_used > 40


def unseen(row: Tracks, since_us: int) -> Tracks:
    n = len(row.track)
    return msgspec.structs.replace(row, seen_us=[since_us] * n, x_var_px2=[60.0] * n, y_var_px2=[60.0] * n)


def test_of_two_tracks_on_one_light_one_alone_holds_its_identity() -> None:
    # The second name lies on the first one's spot; both go on being told of.
    disc = Disc(5, straight(60, 120, 60, 0), radius_px=6.0)
    beside = Disc(5, straight(65, 120, 60, 0), radius_px=6.0)
    batch = scene([disc], 0, 1_500_000, WIDTH, HEIGHT)
    rows = [("a-0", disc, 0), ("a-1", beside, 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, 1_500_000, 100_000)]
    out = run(core(), batch, told, 1_500_000)
    statuses = [one for one in out if isinstance(one, Status) and one.as_of_us >= 300_000]
    assert statuses
    assert all(sum(token is not None for token in one.identity) == 1 for one in statuses)


def test_a_name_that_reads_no_more_yields_to_the_one_that_reads_its_payload_elsewhere() -> None:
    path = still(60, 60)
    first = Disc(5, path, lit_us=(0, 500_000))
    second = Disc(5, still(200, 160), lit_us=(700_000, 9_000_000))
    batch = scene([first, second], 0, 1_500_000, WIDTH, HEIGHT)
    rows = [("a-0", first, 0), ("a-1", second, 0)]
    told = [(t + 20_000, tracks(t, rows)) for t in range(0, 1_500_000, 100_000)]
    out = run(core(), batch, told, 1_500_000)
    assert changes(out) == [("a-0", "accepted"), ("a-0", "lost"), ("a-1", "accepted")]


@pytest.mark.parametrize("period_us", [1_000, 100_000])
def test_a_turning_beacon_is_read_however_often_the_tracker_speaks(period_us: int) -> None:
    # 1,000 px/s on a circle of 60 px: 17,000 px/s2, and 1,000 messages a second of an honest tracker.
    def curve(s: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return 160 + 60 * np.cos(s / 0.06), 120 + 60 * np.sin(s / 0.06)

    disc = Disc(5, curve)
    batch = scene([disc], 0, 1_000_000, WIDTH, HEIGHT)
    decoder = core(window_us=1_000, tracker_period_us=period_us)
    told = [(t, tracks(t, [("a-0", disc, 0)], period_us)) for t in range(0, 1_000_000, period_us)]
    out = run(decoder, batch, told, 1_000_000)
    frames = [row for one in out if isinstance(one, Frames) for row in zip(one.t_us, one.x_px, one.y_px, strict=True)]
    assert len(frames) >= 0.95 * 1_000_000 / FRAME_US
    off = [np.hypot(x_px - curve(np.array(t / 1e6))[0], y_px - curve(np.array(t / 1e6))[1]) for t, x_px, y_px in frames]
    assert np.percentile(off, 95) < 2.0


def test_an_identity_is_not_told_with_the_place_of_a_light_that_does_not_read_as_it() -> None:
    # From half a second on the light at the place is another's (one that no frame fits), or there is none.
    for after, told_on in ((17, False), (None, True)):
        first = Disc(5, still(60, 60), lit_us=(0, 500_000))
        others = [] if after is None else [Disc(after, still(60, 60), lit_us=(500_000, 9_000_000))]
        batch = scene([first, *others], 0, 850_000, WIDTH, HEIGHT)
        told = [(t + 20_000, tracks(t, [("a-0", first, 0)])) for t in range(0, 850_000, 100_000)]
        decoder = core()
        out = states(run(decoder, batch, told, 850_000))
        late = [one.t_us for one in out if one.change == "refreshed" and one.t_us > 540_000]
        assert late == ([600_000, 700_000, 800_000] if told_on else [])
        assert decoder.counters["refreshments_withheld"] == (0 if told_on else 3)


def test_a_name_that_moves_tells_where_its_light_is_now() -> None:
    disc = Disc(5, straight(60, 120, 400, 0))
    batch = scene([disc], 0, 500_000, WIDTH, HEIGHT)
    # The tracker has restarted: its new name takes effect between two refreshments.
    told = [(t + 20_000, tracks(t, [("a-0" if t < 350_000 else "b-0", disc, 0)])) for t in range(0, 450_000, 50_000)]
    out = states(run(core(), batch, told, 500_000))
    (moved,) = [one for one in out if one.track == "b-0" and one.change == "accepted"]
    assert moved.t_us % 100_000 != 0
    assert moved.x_px == pytest.approx(60 + 400e-6 * moved.t_us, abs=2.0)
