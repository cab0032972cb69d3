"""The flow network moves tracks: by either backend to the byte, however the stream is cut, as the camera turns."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from heliograph.core import Context
from heliograph.errors import ConfigError
from heliograph.flow import Flow
from heliograph.messages import Message, Tracks
from heliograph.streams import Onsets
from heliograph.wire import pack_body
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core
from heliograph_services.tracker.motion import Motion, NoMotion, Steering
from heliograph_services.tracker.tracks import TrackTable
from support.flow_scenes import BIT_US, WORD, FlowScene
from support.tracker_runs import cut

TICK_US = 5_000
TURN_US, DARK_US, END_US = 500_000, 400_000, 800_000
SPEED_PX_S = 150.0
START_PX = np.array([30.0, 60.0])
# Around the beacon's path the ground is bare: no target there is taken for it.
BARE = slice(14, 107)
FLOW = {"flow": "numba", "prediction": "both"}


def beacon_px(t_us: int) -> npt.NDArray[np.float64]:
    """Return where the beacon is: it stands on the ground, and the camera turns round at TURN_US."""
    along = SPEED_PX_S * (min(t_us, TURN_US) - max(0, t_us - TURN_US)) * 1e-6
    return np.array([START_PX[0] + along, START_PX[1]])


@cache
def turning() -> list[Onsets]:
    """Return textured ground that goes right, then left, and a beacon on it that is dark from DARK_US on."""
    ground = FlowScene("texture", SPEED_PX_S, noise_hz=1e5, seed=3)
    first = list(ground.onsets(TURN_US * 1e-6))
    second = replace(ground, angle_deg=180.0).onsets((END_US - TURN_US) * 1e-6)
    scene = first + [msgspec.structs.replace(m, t0_us=m.t0_us + TURN_US, t1_us=m.t1_us + TURN_US) for m in second]
    lit = np.zeros((ground.height, ground.width), np.bool_)
    out = []
    for message in scene:
        on, off = (image_of(message, count) for count in (message.on_count, message.off_count))
        on[BARE], off[BARE] = 0, 0
        for t_us in range(message.t0_us, message.t1_us, 500):
            now = (
                disc(beacon_px(t_us), lit.shape) if t_us < DARK_US and WORD[t_us // BIT_US % len(WORD)] else lit & False
            )
            on += now & ~lit
            off += lit & ~now
            lit = now
        out.append(message_of(message, on, off))
    return out


def disc(at_px: npt.NDArray[np.float64], shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    yy, xx = np.mgrid[: shape[0], : shape[1]]
    inside: npt.NDArray[np.bool_] = (xx - at_px[0]) ** 2 + (yy - at_px[1]) ** 2 <= 9.0
    return inside


def image_of(message: Onsets, count: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    image = np.zeros((message.height, message.width), np.int64)
    image[message.y_px, message.x_px] = count
    return image


def message_of(like: Onsets, on: npt.NDArray[np.int64], off: npt.NDArray[np.int64]) -> Onsets:
    y, x = np.nonzero(on + off)
    return msgspec.structs.replace(
        like, tick=np.zeros(len(x), np.uint16), x_px=x.astype(np.uint16), y_px=y.astype(np.uint16),
        on_count=on[y, x].astype(np.uint8), off_count=off[y, x].astype(np.uint8),
    )  # fmt: skip


def run(onsets: Iterable[Onsets], **settings: object) -> list[Message]:
    core = make_core(msgspec.convert(settings, TrackerConfig), Context("0", "b00t", False))
    return [out for message in onsets for out in core.feed(message)]


def packed(messages: Iterable[Message], kind: type[Message]) -> list[bytes]:
    return [pack_body(message) for message in messages if isinstance(message, kind)]


def off_px(messages: Iterable[Message]) -> float:
    """Return how far the track that the beacon had when it went dark is from it at the end."""
    tracks = {m.as_of_us: m for m in messages if isinstance(m, Tracks)}
    then, last = tracks[DARK_US], tracks[END_US]
    away = np.hypot(*(np.stack([then.x_px, then.y_px], axis=1) - beacon_px(DARK_US)).T)
    assert away.min() < 2.0
    i = last.track.index(then.track[int(away.argmin())])
    return float(np.hypot(*(np.array([last.x_px[i], last.y_px[i]]) - beacon_px(END_US))))


def test_a_dark_beacon_is_carried_by_the_ground_when_the_camera_turns_round() -> None:
    kept = {"coast_new_us": 2_000_000}
    assert off_px(run(turning(), **FLOW, **kept)) < 20.0
    # 300 px/s off for .3 s.
    assert off_px(run(turning(), **kept)) > 60.0


@pytest.mark.parametrize("prediction", ["flow", "both"])
def test_nothing_depends_on_how_the_stream_is_cut(prediction: str) -> None:
    settings = {"flow": "numba", "prediction": prediction, "flow_samples": 20}
    whole, pieces = run(turning(), **settings), run(cut(turning(), [7, 1, 30]), **settings)
    for kind in (Tracks, Flow):
        assert len(packed(whole, kind)) >= 8
        assert packed(whole, kind) == packed(pieces, kind)


@pytest.mark.parametrize("reading", ["scales", "paper"])
def test_the_torch_network_gives_the_same_tracks_and_flow_to_the_byte(reading: str) -> None:
    pytest.importorskip("torch", reason="the torch network needs torch")
    onsets = turning()[60:130]
    ours, torchs = (
        run(onsets, flow=flow, prediction="both", flow_samples=50, flow_reading=reading) for flow in ("numba", "torch")
    )
    for kind in (Tracks, Flow):
        assert len(packed(ours, kind)) >= 3
        assert packed(ours, kind) == packed(torchs, kind)


def test_the_record_says_how_the_ground_moves_and_takes_5_kb_a_second() -> None:
    records = [m for m in run(turning(), **FLOW, flow_samples=30) if isinstance(m, Flow)]
    assert [m.as_of_us for m in records] == list(range(100_000, END_US + 1, 100_000))
    before, after = records[3], records[-1]
    for record, speed_px_s in ((before, SPEED_PX_S), (after, -SPEED_PX_S)):
        assert record.confidence > 0.3
        assert abs(record.vx_px_s - speed_px_s) < 0.15 * SPEED_PX_S
        assert abs(record.vy_px_s) < 0.15 * SPEED_PX_S
        assert 0 < len(record.x_px) <= 30
    assert sum(len(pack_body(m)) for m in records) < 5_000


def test_without_samples_there_are_no_records() -> None:
    assert not packed(run(turning()[:60], **FLOW), Flow)


@pytest.mark.parametrize("prediction", ["flow", "both"])
def test_a_prediction_by_flow_without_a_network_is_refused(prediction: str) -> None:
    with pytest.raises(ConfigError, match=f"prediction = '{prediction}' needs flow = 'numba' or 'torch'"):
        TrackerConfig(prediction=prediction)  # type: ignore[arg-type]


def test_without_torch_the_torch_network_is_refused_in_one_line_that_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("heliograph_services.tracker.reference.flow", "heliograph_services.tracker.flow.torch_net"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ConfigError, match=r"flow = 'torch' needs .* pip install 'heliograph\[reference\]'") as refused:
        make_core(TrackerConfig(flow="torch", prediction="both"), Context("0", "b00t", False))
    assert "\n" not in str(refused.value)


class Known(NoMotion):
    """A motion that is told."""

    def __init__(self, velocity: tuple[float, float], variance: float) -> None:
        self._velocity, self._variance = velocity, variance

    def velocities(
        self, x_px: npt.NDArray[np.float64], y_px: npt.NDArray[np.float64], radius_px: object, t_us: int
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        return np.tile(self._velocity, (len(x_px), 1)), np.full(len(x_px), self._variance)


def births(seen_us: int, count: int = 2) -> TrackTable:
    table = TrackTable()
    table.append(
        xy_px=np.tile([50.0, 60.0], (count, 1)), var_px2=np.full(count, 0.1), radius_px=np.full(count, 3.0),
        size_px=np.full(count, 20.0), polarity=np.zeros(count), blinks=np.ones(count, np.bool_),
        sign=np.zeros(count, np.int64), born_us=0, seen_us=seen_us, speed_var=1e4,
    )  # fmt: skip
    table.cov[:, [1, 4]] = 5.0
    return table


def steered(motion: Motion, prediction: str, seen_us: int = 20_000) -> TrackTable:
    table = births(seen_us)
    steering = Steering(motion, prediction, 100.0)  # type: ignore[arg-type]
    steering.apply(TrackTable(), 15_000)
    steering.apply(table, 20_000)
    return table


def test_the_flow_of_a_birth_is_a_measurement_of_its_velocity_as_filterpy_makes_it() -> None:
    filters = pytest.importorskip("filterpy.kalman", reason="the oracle is filterpy")
    before, after = births(20_000), steered(Known((300.0, -40.0), 900.0), "both")
    for axis, velocity in enumerate((300.0, -40.0)):
        xx, xv, vv = before.cov[0, 3 * axis : 3 * axis + 3]
        state, cov = filters.update(
            before.state[0, [axis, 2 + axis]], np.array([[xx, xv], [xv, vv]]), velocity, 900.0, H=np.array([[0.0, 1.0]])
        )
        np.testing.assert_allclose(after.state[0, [axis, 2 + axis]], state, rtol=1e-9)
        np.testing.assert_allclose(after.cov[0, 3 * axis : 3 * axis + 3], cov[[0, 0, 1], [0, 1, 1]], rtol=1e-9)


def test_flow_alone_is_the_flow_s_velocity_and_none_is_no_velocity() -> None:
    moving = births(20_000)
    moving.state[:, 2:] = 70.0
    flow = steered(Known((300.0, -40.0), 900.0), "flow")
    np.testing.assert_array_equal(flow.state[:, 2:], [[300.0, -40.0]] * 2)
    Steering(NoMotion(), "none", 100.0).apply(moving, 20_000)
    assert not moving.state[:, 2:].any()
    assert (moving.cov[:, [2, 5]] == 1e4).all()


def test_what_the_flow_does_not_know_changes_no_birth() -> None:
    table = steered(Known((300.0, -40.0), np.inf), "both")
    assert not table.state[:, 2:].any()
