"""Scenes for the tracker's studies, as texts of scenario files: many beacons, crossings, occlusions; drawn by seed.

The camera hangs HEIGHT_M above the ground and looks straight down, so a pixel is HEIGHT_M / f metres: speeds and
accelerations are chosen on the sensor. A beacon's image is a Gaussian of sigma 1.3 to 2.2 px with a contrast of 1 to 2
in its middle: with thresholds of .2 its edges make events up to 3 to 6 px from its centre.

Movers stay on the sensor at one speed v each. Half of them go round circles of radius R (acceleration v^2 / R), half
along straight lines, thrown back at the sensor's borders within turn_s (acceleration up to 2 v / turn_s); they set off
from rest. `MOVES` has the numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from heliograph_services.event_source.simulation.world.crowd import sendable
from heliograph_services.event_source.simulation.world.optics import Optics, peak_share
from heliograph_services.event_source.simulation.world.spec import Ground, Lens, Scenario

HEIGHT_M: Final = 1.0
# From a border of the sensor: an image and its halo.
MARGIN_PX: Final = 16.0
SIGMA_PX: Final = (1.3, 2.2)
CONTRAST: Final = (1.0, 2.0)
# Clocks of real beacons were .03 to .04 % off.
CLOCK_PPM: Final = 400.0
# Of the camera over the textured ground: 5 cm in 5 s are up to 25 px/s on the small sensor.
SWAY: Final = "path = { kind = 'sine', at_m = [0, 0, 1], amplitude_m = [0.05, 0.03, 0], period_s = [5.0, 3.7, 1.0] }"
TEXTURE: Final = "[ground]\ntexture = 'boards'\ncontrast = 1.5\ngrain_m = 0.15\n"

Point = tuple[float, float]
Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class View:
    """A sensor in a mode, seen from HEIGHT_M."""

    sensor: str
    mode: str
    width: int
    height: int
    pitch_um: float

    @property
    def f_px(self) -> float:
        """The focal length."""
        return Lens().focal_mm * 1e3 / self.pitch_um

    def metres(self, x_px: float, y_px: float, z_m: float = 0.0) -> Point:
        """Return the point of the plane z = z_m that is seen at a pixel; north is up."""
        scale = (HEIGHT_M - z_m) / self.f_px
        return (x_px - (self.width - 1) / 2.0) * scale, ((self.height - 1) / 2.0 - y_px) * scale


VIEWS: Final = {
    "mini": View("dvxplorer_mini", "VARIABLE_15000", 640, 480, 9.0),
    "imx636": View("imx636", "", 1280, 720, 4.86),
}


@dataclass(frozen=True, slots=True)
class Move:
    """How movers move: speeds (px/s, uniform), time of a turn, radii of circles (px, up to what fits)."""

    speed_px_s: Pair
    turn_s: float
    radius_px: float


# Slow: at most 4,000 px/s2. Fast: at most 40,000 px/s2 (100 m/s2 at 400 px/m) in a turn, 33,000 on a circle.
MOVES: Final = {"slow": Move((0.0, 400.0), 0.2, 40.0), "fast": Move((400.0, 2000.0), 0.1, 120.0)}


@dataclass(frozen=True, slots=True)
class Script:
    """A scene and what is to be watched in it.

    Args:
        text: of the scenario file.
        seconds: how long it is to be run.
        at_s: when it happens, one a pair or beacon.
        about: what was drawn.
    """

    text: str
    seconds: float
    at_s: tuple[float, ...] = ()
    about: dict[str, float] = field(default_factory=dict)


def moving(
    seed: int, sensor: str, move: str, bit_rate: float, seconds: float, *, n: int = 20, fresh: bool, texture: bool
) -> Script:
    """Return n beacons on paths of their own.

    Args:
        seed: of all that is drawn.
        sensor: one of VIEWS.
        move: one of MOVES.
        bit_rate: of all of them.
        seconds: of the run.
        n: at most 44 where payloads are fixed.
        fresh: payloads are drawn anew for every frame; else each has one of its own.
        texture: a textured ground under a swaying camera; else an even one under a still camera.
    """
    rng = np.random.default_rng([seed, 11])
    view, how = VIEWS[sensor], MOVES[move]
    payloads = rng.permutation(sendable("seed11", {}))[:n]
    lights = []
    for i in range(n):
        speed = float(rng.uniform(*how.speed_px_s))
        path = _circle(rng, view, how, speed) if i % 2 else _thrown(rng, view, how, speed, seconds)
        what = "fresh = true" if fresh else f"payload = {payloads[i]}"
        lights.append(_beacon(rng, view, f"b{i:02d}", what, bit_rate, path))
    return Script(_head(view, seconds, texture=texture) + "".join(lights), seconds)


def _head(view: View, seconds: float, *, texture: bool, camera: str = "") -> str:
    if not camera:
        camera = SWAY if texture else f"path = {{ kind = 'still', at_m = [0, 0, {HEIGHT_M}] }}"
    mode = f"mode = '{view.mode}'\n" if view.mode else ""
    return (
        f"duration_s = {seconds:.3f}\n[camera]\nsensor = '{view.sensor}'\n{mode}{camera}\n{TEXTURE if texture else ''}"
    )


def _beacon(rng: np.random.Generator, view: View, name: str, what: str, bit_rate: float, path: str) -> str:
    sigma, contrast = float(rng.uniform(*SIGMA_PX)), float(rng.uniform(*CONTRAST))
    lens = Lens()
    optics = Optics(lens, view.pitch_um)
    dark = optics.background_w_m2(Ground().reflectance, Scenario().irradiance_w_m2)
    flux = math.expm1(contrast) * dark / peak_share(sigma)
    at_one = float(optics.flux_w_m2(np.float64(1.0), np.float64(HEIGHT_M), np.float64(HEIGHT_M)))  # type: ignore[arg-type]
    diameter_m = 4.0 * HEIGHT_M / view.f_px * math.sqrt(sigma**2 - lens.psf_sigma_px**2)
    start_us = float(rng.uniform(0.0, 1e6 * 11.0 / bit_rate))
    return (
        f"\n[[beacon]]\nname = '{name}'\nprotocol = 'seed11'\n{what}\nbit_rate = {bit_rate}\n"
        f"start_us = {start_us:.1f}\nclock_ppm = {rng.uniform(-CLOCK_PPM, CLOCK_PPM):.1f}\n"
        f"intensity_w_sr = {flux / at_one:.4g}\ndiameter_m = {diameter_m:.4g}\npath = {path}\n"
    )


def _circle(rng: np.random.Generator, view: View, how: Move, speed_px_s: float) -> str:
    most = min(view.width, view.height) / 2.0 - MARGIN_PX - 24.0
    radius = float(rng.uniform(how.radius_px, most))
    low = radius + MARGIN_PX + 24.0
    x = float(rng.uniform(low, view.width - low)) if view.width > 2 * low else view.width / 2.0
    y = float(rng.uniform(low, view.height - low)) if view.height > 2 * low else view.height / 2.0
    (mx, my), r = view.metres(x, y), radius * HEIGHT_M / view.f_px
    period, phase = 2.0 * math.pi * radius / max(speed_px_s, 1.0), float(rng.uniform(0.0, 360.0))
    way = 90.0 if rng.integers(2) else -90.0
    return (
        f"{{ kind = 'sine', at_m = [{mx:.6f}, {my:.6f}, 0.0], amplitude_m = [{r:.6f}, {r:.6f}, 0.0],"
        f" period_s = [{period:.6f}, {period:.6f}, 1.0], phase_deg = [{phase:.3f}, {phase + way:.3f}, 0.0] }}"
    )


def _thrown(rng: np.random.Generator, view: View, how: Move, speed_px_s: float, seconds: float) -> str:
    """Return a line thrown back at the borders for longer than the run."""
    low = MARGIN_PX + 24.0
    side = np.array([view.width - 2.0 * low, view.height - 2.0 * low])
    at = rng.uniform(0.0, 1.0, 2) * side
    angle = float(rng.uniform(0.0, 2.0 * math.pi))
    v = max(speed_px_s, 1.0) * np.array([math.cos(angle), math.sin(angle)])
    t, points = 0.0, [(0.0, *(at + low))]
    while t < seconds + 1.0:
        walls = np.where(v > 0.0, side - at, -at) / np.where(v == 0.0, 1e-9, v)
        step = max(float(walls.min()), 2e-3)
        hit = int(np.argmin(walls))
        at, t = np.clip(at + v * step, 0.0, side), t + step
        v[hit] = -v[hit]
        points.append((t, *(at + low)))
    return _waypoints(view, points, how.turn_s)


def _waypoints(view: View, points: list[tuple[float, float, float]], smooth_s: float) -> str:
    """Return the path through points (s, px, px), and the same way back."""
    # A path begins anew without a jump; and the average over a turn, which looks back beyond 0, sees the way back
    # there, so that the thing sets off from rest.
    last_s = points[-1][0]
    back = [(2.0 * last_s - t, x, y) for t, x, y in reversed(points[:-1])]
    places = [(t, *view.metres(x, y)) for t, x, y in points + back]
    rows = ", ".join(f"[{t:.6f}, {x:.6f}, {y:.6f}, 0.0]" for t, x, y in places)
    return f"{{ kind = 'waypoints', smooth_s = {smooth_s}, points = [{rows}] }}"


# ---- crossings -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Kind:
    """What crossings are drawn from, uniformly."""

    angle_deg: Pair = (20.0, 180.0)
    speed_px_s: Pair = (50.0, 400.0)
    acceleration_px_s2: Pair = (0.0, 0.0)


KINDS: Final = {
    "straight": Kind(),
    "bent": Kind(acceleration_px_s2=(0.0, 300.0)),
    "small angle": Kind(angle_deg=(10.0, 20.0), speed_px_s=(50.0, 200.0)),
    "slow": Kind(speed_px_s=(10.0, 60.0)),
}
RATES: Final = (1000.0, 1500.0, 2000.0, 2500.0, 3500.0, 5000.0)
# Before the images touch and after: four frames at 1 kbit/s and three periods of a tracker at 10 Hz are 350 ms.
BEFORE_S: Final = 0.8
APART_PX: Final = 40.0
# Slower ones that hardly part would take minutes.
PART_PX_S: Final = 15.0


def crossing(seed: int, kind: str, bit_rate: float, sensor: str = "mini") -> Script:
    """Return two beacons whose images pass over each other, 0 to 2 px apart, half-way through the run."""
    rng = np.random.default_rng([seed, 12])
    view, ranges = VIEWS[sensor], KINDS[kind]
    while True:
        angle = float(rng.uniform(*ranges.angle_deg))
        speeds = rng.uniform(*ranges.speed_px_s, 2)
        heading = float(rng.uniform(0.0, 360.0))
        directions = np.deg2rad([heading, heading + angle])
        v = speeds[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=1)
        away = v[0] - v[1]
        parting = float(np.hypot(*away))
        half_s = BEFORE_S + APART_PX / max(parting, PART_PX_S)
        bend, whither = rng.uniform(*ranges.acceleration_px_s2, 2), rng.uniform(0.0, 2.0 * math.pi, 2)
        a = bend[:, None] * np.stack([np.cos(whither), np.sin(whither)], axis=1)
        miss = np.array([-away[1], away[0]]) / max(parting, 1e-9) * rng.uniform(0.0, 2.0) / 2.0
        t = np.arange(0.0, 2.0 * half_s + 0.05, 0.02)
        dt = (t - half_s)[:, None]
        middle = np.array([view.width / 2.0, view.height / 2.0])
        tracks = [middle + sign * miss + (v[k] + a[k] * dt / 2.0) * dt for k, sign in ((0, 1.0), (1, -1.0))]
        inside = all(
            (p > MARGIN_PX).all() and (p < np.array([view.width, view.height]) - MARGIN_PX).all() for p in tracks
        )
        if parting >= PART_PX_S and inside:
            break
    payloads = rng.permutation(sendable("seed11", {}))[:2]
    lights = [
        _beacon(
            rng, view, f"b{k}", f"payload = {payloads[k]}", bit_rate,
            _waypoints(view, [(float(s), float(x), float(y)) for s, (x, y) in zip(t, tracks[k], strict=True)], 0.0),
        )
        for k in (0, 1)
    ]  # fmt: skip
    about = {"angle_deg": angle, "faster_px_s": float(speeds.max()), "slower_px_s": float(speeds.min())}
    return Script(_head(view, 2.0 * half_s, texture=False) + "".join(lights), 2.0 * half_s, (half_s,), about)


# ---- occlusions ------------------------------------------------------------------------------------------------------

HIDDEN_S: Final = 0.5
_LEAD_S: Final = 0.9
_AFTER_S: Final = 0.7
_POST_Z_M: Final = 0.1
PAN_DEG_S: Final = 6.0  # 42 px/s on the small sensor


def occlusions(seed: int, *, turning: bool, panning: bool, bit_rate: float, sensor: str = "mini") -> Script:
    """Return beacons that each pass behind a post of their own for HIDDEN_S.

    Args:
        seed: of all that is drawn.
        turning: they turn by 20 to 70 degrees behind it, on a circle; else they go straight on at 50 to 250 px/s.
        panning: the camera turns over a textured ground; else it is still over an even one.
        bit_rate: of all of them.
        sensor: one of VIEWS.
    """
    rng = np.random.default_rng([seed, 13])
    view = VIEWS[sensor]
    seconds = _LEAD_S + HIDDEN_S + _AFTER_S + 0.3
    lights, posts, at = [], [], []
    payloads = rng.permutation(sendable("seed11", {}))
    # A pan moves images up and down by up to 8 degrees: the places keep off those borders.
    spare = view.f_px * math.tan(math.radians(PAN_DEG_S * seconds / 2.0)) if panning else 0.0
    places = _cells(view, 3, 2, spare) if turning else _cells(view, 1, 5, spare)
    for k, (x, y, wide, high) in enumerate(places):
        begin_s = _LEAD_S + float(rng.uniform(0.0, 0.3))
        cell = (x, y, wide, high)
        path, (px, py, a, b) = (
            _round_a_post(rng, view, cell, begin_s) if turning else _past_a_post(rng, view, cell, begin_s, seconds)
        )
        lights.append(_beacon(rng, view, f"b{k}", f"payload = {payloads[k]}", bit_rate, path))
        (mx, my), scale = view.metres(px, py, _POST_Z_M), (HEIGHT_M - _POST_Z_M) / view.f_px
        posts.append(
            f"\n[[asset]]\nname = 'post{k}'\nsize_m = [{a * scale:.6f}, {b * scale:.6f}]\n"
            f"path = {{ kind = 'still', at_m = [{mx:.6f}, {my:.6f}, {_POST_Z_M}] }}\n"
        )
        at.append(begin_s)
    camera = ""
    if panning:
        swing = PAN_DEG_S * seconds / 2.0
        camera = (
            f"path = {{ kind = 'still', at_m = [0, 0, {HEIGHT_M}] }}\n"
            f"attitude = {{ points = [[0.0, 0.0, {-90.0 - swing:.4f}, 0.0],"
            f" [{seconds + 0.1:.4f}, 0.0, {-90.0 + swing:.4f}, 0.0]] }}"
        )
    text = _head(view, seconds, texture=panning, camera=camera) + "".join(posts) + "".join(lights)
    return Script(text, seconds, tuple(at))


def _cells(view: View, columns: int, rows: int, spare_px: float) -> list[tuple[float, float, float, float]]:
    """Return centre and size of a grid's cells, off the upper and lower border by spare_px."""
    wide, high = view.width / columns, (view.height - 2.0 * spare_px) / rows
    return [((i + 0.5) * wide, spare_px + (j + 0.5) * high, wide, high) for j in range(rows) for i in range(columns)]


def _past_a_post(
    rng: np.random.Generator, view: View, cell: tuple[float, float, float, float], begin_s: float, seconds: float
) -> tuple[str, tuple[float, float, float, float]]:
    """Return a straight path along a cell, and the post (centre and size, px) that hides it from begin_s on."""
    x, y, wide, high = cell
    speed = float(rng.uniform(50.0, min(250.0, (wide - 4.0 * MARGIN_PX) / seconds)))
    way = 1.0 if rng.integers(2) else -1.0
    middle_s = begin_s + HIDDEN_S / 2.0
    # The path's middle (in time) anywhere that keeps it on the sensor.
    slack = (wide - 2.0 * MARGIN_PX - speed * seconds) / 2.0
    x0 = x + float(rng.uniform(-slack, slack)) - way * speed * seconds / 2.0
    points = [(0.0, x0, y), (seconds + 0.1, x0 + way * speed * (seconds + 0.1), y)]
    return _waypoints(view, points, 0.0), (x0 + way * speed * middle_s, y, speed * HIDDEN_S, min(high - 10.0, 40.0))


def _round_a_post(
    rng: np.random.Generator, view: View, cell: tuple[float, float, float, float], begin_s: float
) -> tuple[str, tuple[float, float, float, float]]:
    """Return a circle within a cell, and the post over its top that hides an arc of it from begin_s on."""
    x, y, wide, high = cell
    turn = math.radians(float(rng.uniform(20.0, 70.0)))
    most = min(wide, high) / 2.0 - MARGIN_PX - 6.0
    least_px_s, top_px_s = 50.0, min(250.0, most * turn / HIDDEN_S)
    speed = float(rng.uniform(min(least_px_s, top_px_s), top_px_s))
    rate = turn / HIDDEN_S
    radius = speed / rate
    way = 1.0 if rng.integers(2) else -1.0
    # In the middle of the occlusion at the top of the circle: sin(phase) = 0 for x, north at its most for y.
    middle_s, period_s = begin_s + HIDDEN_S / 2.0, 2.0 * math.pi / rate
    turned = math.degrees(rate * middle_s) % 360.0
    phases = ((0.0 if way > 0 else 180.0) - turned, 90.0 - turned)
    (mx, my), r = view.metres(x, y), radius * HEIGHT_M / view.f_px
    path = (
        f"{{ kind = 'sine', at_m = [{mx:.6f}, {my:.6f}, 0.0], amplitude_m = [{r:.6f}, {r:.6f}, 0.0],"
        f" period_s = [{period_s:.6f}, {period_s:.6f}, 1.0], phase_deg = [{phases[0]:.4f}, {phases[1]:.4f}, 0.0] }}"
    )
    low, top = radius * math.cos(turn / 2.0), radius + 12.0
    wide_px = 2.0 * radius * math.sin(turn / 2.0) + 24.0
    return path, (x, y - (low + top) / 2.0, wide_px, top - low)
