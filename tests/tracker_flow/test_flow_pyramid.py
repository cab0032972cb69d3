"""What the pyramid says of scenes whose motion is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from heliograph.errors import ConfigError
from heliograph.streams import Onsets
from heliograph_services.tracker.flow.network import paper_network
from heliograph_services.tracker.flow.pyramid import FlowPyramid, FlowSamples, fitted, warm
from heliograph_services.tracker.flow.settings import FlowSettings, Scale
from support.flow_scenes import FlowScene

Floats = npt.NDArray[np.float64]


def pyramid(scene: FlowScene, settings: FlowSettings | None = None) -> FlowPyramid:
    return FlowPyramid(settings or FlowSettings(), width=scene.width, height=scene.height, tick_us=scene.tick_us)


def asked(scene: FlowScene, duration_s: float, settings: FlowSettings | None = None) -> Floats:
    """Return rows (confidence, endpoint error as a share of the speed) of places every 20 ms of the second half."""
    flow, rows = pyramid(scene, settings), []
    for onsets in scene.onsets(duration_s):
        flow.feed(onsets)
        if onsets.t1_us < duration_s * 5e5 or onsets.t1_us % 20_000:
            continue
        if scene.kind == "discs":
            places, radius = scene.centres(onsets.t1_us * 1e-6), scene.radius_px + 4
            inside = ((places > 12) & (places < (scene.width - 12, scene.height - 12))).all(axis=1)
            places = places[inside]
        else:
            places, radius = np.array([(x, y) for x in (40, 80, 120) for y in (40, 80)], np.float64), 20.0
        for x, y in places:
            vx, vy, confidence = flow.at(x, y, radius)
            tx, ty = scene.flow(x, y)
            rows.append((confidence, np.hypot(vx - tx, vy - ty) / np.hypot(tx, ty)))
    return np.array(rows)


@pytest.mark.parametrize(
    ("kind", "speed_px_s", "noise_hz", "error"),
    [
        ("discs", 40.0, 0.0, 0.12),
        ("discs", 200.0, 0.0, 0.12),
        ("discs", 200.0, 5e6, 0.25),
        ("discs", 900.0, 1e6, 0.20),
        ("texture", 200.0, 0.0, 0.15),
        ("texture", 200.0, 5e6, 0.15),
        ("edges", 60.0, 1e6, 0.06),
        ("edges", 300.0, 1e6, 0.10),
    ],
)
def test_the_motion_of_a_place_is_told(kind: str, speed_px_s: float, noise_hz: float, error: float) -> None:
    rows = asked(FlowScene(kind, speed_px_s, 63.0, noise_hz=noise_hz, seed=11), min(1.0, max(0.3, 40 / speed_px_s)))
    assert len(rows) >= 10
    assert np.median(rows[:, 1]) < error
    assert np.median(rows[:, 0]) > 0.4


@pytest.mark.parametrize("noise_hz", [1e5, 1e6, 1e7])
def test_noise_alone_moves_nowhere(noise_hz: float) -> None:
    scene = FlowScene("discs", 1.0, noise_hz=noise_hz, discs=0)
    flow = pyramid(scene)
    answers, views = [], []
    for onsets in scene.onsets(0.5):
        flow.feed(onsets)
        motion = flow.surroundings()
        views.append(0.0 if motion is None else motion.confidence)
        answers += [flow.at(x, y, 8.0)[2] for x in (40, 80, 120) for y in (40, 80)]
    assert np.quantile(answers, 0.99) < 0.25
    assert np.quantile(views, 0.99) < 0.25


def test_no_event_is_no_motion_and_no_answer() -> None:
    scene = FlowScene("discs", 1.0, discs=0)
    flow = pyramid(scene)
    assert flow.at(1.0, 1.0, 100.0) == (0.0, 0.0, 0.0)
    assert flow.surroundings() is None
    for onsets in scene.onsets(0.05):
        assert flow.feed(onsets) == []
    assert flow.at(1.0, 1.0, 100.0) == (0.0, 0.0, 0.0)
    assert flow.surroundings() is None


@pytest.mark.parametrize(("speed_px_s", "omega"), [(150.0, 0.0), (120.0, 1.0), (0.0, -2.0)])
def test_the_surroundings_are_fitted_with_their_roll_past_beacons_of_their_own_motion(
    speed_px_s: float, omega: float
) -> None:
    scene = FlowScene("texture", speed_px_s, 200.0, omega_rad_s=omega, noise_hz=5e5, seed=12)
    beacons = FlowScene("discs", 300.0, 20.0, seed=13)
    flow = pyramid(scene)
    x, y = (column.ravel() for column in np.meshgrid((20.0, 80.0, 140.0), (20.0, 60.0, 100.0)))
    true = np.stack(scene.flow(x, y))
    errors = []
    for ground, lights in zip(scene.onsets(0.6), beacons.onsets(0.6), strict=True):
        flow.feed(merged(ground, lights))
        motion = flow.surroundings() if ground.t1_us >= 300_000 and ground.t1_us % 50_000 == 0 else None
        # Below .3 is no answer: this view is small, and of few patches.
        if motion is not None and motion.confidence >= 0.3:
            assert motion.at(20.0, 100.0) == pytest.approx(np.ravel(motion.along(np.array([20.0]), np.array([100.0]))))
            errors.append(np.hypot(*(np.stack(motion.along(x, y)) - true)).mean() / np.hypot(*true).mean())
    assert len(errors) >= 5
    assert np.median(errors) < 0.12


def merged(a: Onsets, b: Onsets) -> Onsets:
    """Return both streams' ticks (one tick a message)."""
    pixel = np.concatenate([o.y_px.astype(np.int64) * a.width + o.x_px for o in (a, b)])
    cells, place = np.unique(pixel, return_inverse=True)
    on, off = (
        np.minimum(np.bincount(place, np.concatenate([getattr(a, n), getattr(b, n)]), len(cells)), 255).astype(np.uint8)
        for n in ("on_count", "off_count")
    )
    return replaced(
        a,
        tick=np.zeros(len(cells), np.uint16),
        x_px=(cells % a.width).astype(np.uint16),
        y_px=(cells // a.width).astype(np.uint16),
        on_count=on,
        off_count=off,
    )


def replaced(onsets: Onsets, **changes: object) -> Onsets:
    fields = {name: getattr(onsets, name) for name in onsets.__struct_fields__}
    return Onsets(**(fields | changes))


def joined(parts: list[Onsets]) -> Onsets:
    first = parts[0]
    shift = [(part.t0_us - first.t0_us) // first.tick_us for part in parts]
    columns = {n: np.concatenate([getattr(p, n) for p in parts]) for n in ("x_px", "y_px", "on_count", "off_count")}
    tick = np.concatenate([part.tick + s for part, s in zip(parts, shift, strict=True)]).astype(np.uint16)
    return replaced(first, t1_us=parts[-1].t1_us, tick=tick, **columns)


def flat(samples: list[FlowSamples]) -> list[tuple[object, ...]]:
    return [
        (s.t_us, s.scale, *(c.tobytes() for c in (s.x_px, s.y_px, s.vx_px_s, s.vy_px_s, s.weight))) for s in samples
    ]


def test_nothing_depends_on_how_the_stream_is_cut() -> None:
    ticks = list(FlowScene("discs", 300.0, 40.0, noise_hz=2e6, seed=14).onsets(0.3))
    scene = FlowScene("discs", 300.0)
    one, other = pyramid(scene), pyramid(scene)
    samples_one: list[FlowSamples] = []
    answers = {}
    for onsets in ticks:
        samples_one += one.feed(onsets)
        answers[onsets.t1_us] = (one.at(80.0, 60.0, 60.0), one.surroundings())
    rng = np.random.default_rng(15)
    samples_other: list[FlowSamples] = []
    while ticks:
        n = int(rng.integers(1, 12))
        part, ticks = joined(ticks[:n]), ticks[n:]
        samples_other += other.feed(part)
        for t_us in range(part.t0_us + part.tick_us, part.t1_us + 1, part.tick_us):
            assert (other.at(80.0, 60.0, 60.0, t_us), other.surroundings(t_us)) == answers[t_us]
    assert len(samples_one) > 20
    assert flat(samples_one) == flat(samples_other)
    assert one.counters == other.counters


def test_a_gap_in_the_stream_is_silence() -> None:
    scene = FlowScene("discs", 300.0, 40.0, seed=16)
    ticks = list(scene.onsets(0.5))
    silent = [
        replaced(o, **{n: getattr(o, n)[:0] for n in ("tick", "x_px", "y_px", "on_count", "off_count")}) for o in ticks
    ]
    whole, gapped = pyramid(scene), pyramid(scene)
    a = [whole.feed(o) for o in ticks[:30] + silent[30:70] + ticks[70:]]
    b = [gapped.feed(o) for o in ticks[:30] + ticks[70:]]
    assert flat([s for part in a for s in part]) == flat([s for part in b for s in part])


def test_a_flash_is_skipped_and_counted() -> None:
    scene = FlowScene("discs", 300.0, seed=17)
    flow = pyramid(scene, FlowSettings(limit_pixels=1_000, noise_share=1.0))
    y, x = np.divmod(np.arange(scene.width * scene.height), scene.width)
    ones = np.ones(len(x), np.uint8)
    for k, onsets in enumerate(scene.onsets(0.1)):
        if k == 9:
            onsets = replaced(  # noqa: PLW2901
                onsets, tick=np.zeros(len(x), np.uint16), x_px=x.astype(np.uint16), y_px=y.astype(np.uint16),
                on_count=ones, off_count=ones,
            )  # fmt: skip
        flow.feed(onsets)
    assert flow.counters["flashes"] == 3


def test_the_literal_paper_can_be_run() -> None:
    """10 executions at 10 Hz see 4 to 20 px/s, with memory, from every active pixel."""
    scene = FlowScene("edges", 10.0, seed=18)
    rows = asked(scene, 1.4, FlowSettings.literal(l_tau=0.5))
    assert (rows[:, 0] > 0).mean() > 0.5
    fast = asked(replace(scene, speed_px_s=300.0), 0.6, FlowSettings.literal(l_tau=0.5))
    assert np.median(fast[:, 1]) > 0.5


def test_a_network_of_ones_own_runs_at_every_scale() -> None:
    scene = FlowScene("edges", 200.0, seed=19)
    flow = FlowPyramid(FlowSettings(), width=160, height=120, tick_us=5_000, network=paper_network(0.0, 26.0))
    for onsets in scene.onsets(0.2):
        assert flow.feed(onsets) == []


@pytest.mark.parametrize(
    ("scale", "tick_us", "pool_px", "expected"),
    [
        (Scale(10_000, 2), 5_000, 1, Scale(10_000, 2)),
        (Scale(25_000, 1, 3), 5_000, 2, Scale(50_000, 2, 3)),
        (Scale(5_000, 3), 2_000, 1, Scale(4_000, 3)),
        (Scale(5_000, 3), 10_000, 1, Scale(10_000, 6)),
        (Scale(5_000, 3), 5_000, 4, Scale(5_000, 4)),
    ],
)
def test_scales_are_fitted_to_coarser_streams_and_keep_their_speeds(
    scale: Scale, tick_us: int, pool_px: int, expected: Scale
) -> None:
    out = fitted(scale, tick_us, pool_px)
    assert out == expected
    assert out.pool_px / out.step_us == pytest.approx(scale.pool_px / scale.step_us, rel=0.4)


@pytest.mark.parametrize(
    "change",
    [
        {"scales": ()}, {"l_tau": 1.0}, {"v_th": 0.0}, {"noise_share": 0.0}, {"readout": "best"},
        {"hold_ticks": 0}, {"limit_pixels": 0},
    ],
)  # fmt: skip
def test_a_setting_out_of_range_is_an_operators_error(change: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        FlowSettings(**change)  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(ConfigError, match="pool_px"):
        Scale(1, 0)
    with pytest.raises(ConfigError, match="silence_ticks"):
        Scale(1, 1, -1)


def test_warming_asks_for_nothing() -> None:
    warm()
