"""Scenes for optical flow: blinking discs and textured ground that move as one, as onsets of ideal pixels, with noise.

A scene's motion is v(x, t) = (vx, vy) + omega x (p - centre), constant in time: translation and roll of the camera. A
pixel of the ground remembers the logarithm of what it saw and fires once for each `contrast` that it differs by.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from heliograph.streams import Onsets

US: Final = 1e-6
Floats = npt.NDArray[np.float64]
# Discs blink at 1 kbit/s with payload 42 (even parity): the paper's example.
WORD: Final = np.array([1, 1, 1, 0, 1, 0, 1, 0, 1, 0, 1], np.bool_)
BIT_US: Final = 1_000


@dataclass(frozen=True)
class FlowScene:
    """What a camera of width x height pixels sees.

    Args:
        kind: "discs" (blinking beacons), "texture" (ground with structure in all directions) or "edges" (dark and
            bright stripes across the motion).
        speed_px_s: of the translation.
        angle_deg: its direction, from +x towards +y.
        gated: the source's gate is active: an entry has two events in the 3 x 3 of its tick.
        omega_rad_s: roll about the image's centre.
        noise_hz: events a second of uniform noise on a sensor of 640 x 480, of which this is a cut-out.
    """

    kind: str
    speed_px_s: float
    angle_deg: float = 0.0
    omega_rad_s: float = 0.0
    noise_hz: float = 0.0
    width: int = 160
    height: int = 120
    tick_us: int = 5_000
    seed: int = 0
    discs: int = 4
    radius_px: float = 4.0
    contrast: float = 0.25
    gated: bool = False

    @property
    def velocity(self) -> tuple[float, float]:
        """The translation, px/s."""
        turn = np.deg2rad(self.angle_deg)
        return float(self.speed_px_s * np.cos(turn)), float(self.speed_px_s * np.sin(turn))

    def flow(self, x_px: npt.ArrayLike, y_px: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Return the true motion at places, px/s."""
        vx, vy = self.velocity
        dx, dy = np.asarray(x_px) - (self.width - 1) / 2, np.asarray(y_px) - (self.height - 1) / 2
        return vx - self.omega_rad_s * dy, vy + self.omega_rad_s * dx

    def centres(self, t_s: float) -> Floats:
        """Return the (discs, 2) centres; they leave at one side and come again at the other, without roll."""
        rng = np.random.default_rng([self.seed, 1])
        start = rng.random((self.discs, 2)) * (self.width, self.height)
        margin = 2 * self.radius_px
        size = np.array([self.width, self.height]) + 2 * margin
        return (start + np.array(self.velocity) * t_s + margin) % size - margin

    def onsets(self, duration_s: float) -> Iterator[Onsets]:
        """Yield one message a tick."""
        rng = np.random.default_rng([self.seed, 2])
        step_us = int(min(500, max(50, 0.4e6 / max(1.0, self.speed_px_s))))
        while self.tick_us % step_us:
            step_us -= 1
        see = self._ground(rng) if self.kind in ("texture", "edges") else None
        state = np.zeros((self.height, self.width)) if see is None else see(0.0)
        pixels = self.width * self.height
        for k in range(round(duration_s / US / self.tick_us)):
            on, off = np.zeros((2, self.height, self.width), np.int64)
            for t_us in range(k * self.tick_us, (k + 1) * self.tick_us, step_us):
                if see is None:
                    now = self._lit(t_us)
                    on += now > state
                    off += now < state
                    state = now
                else:
                    fired = np.trunc((see(t_us * US) - state) / self.contrast)
                    state = state + fired * self.contrast
                    on += np.maximum(fired, 0).astype(np.int64)
                    off += np.maximum(-fired, 0).astype(np.int64)
            mean = self.noise_hz * self.tick_us * US * pixels / (640 * 480) / 2
            noise = [np.bincount(rng.integers(0, pixels, rng.poisson(mean)), minlength=pixels) for _ in range(2)]
            yield self._message(k, on + noise[0].reshape(on.shape), off + noise[1].reshape(on.shape))

    def _lit(self, t_us: int) -> Floats:
        image = np.zeros((self.height, self.width))
        yy, xx = np.mgrid[: self.height, : self.width]
        for i, (cx, cy) in enumerate(self.centres(t_us * US)):
            if WORD[(t_us // BIT_US + 3 * i) % len(WORD)]:
                image[(xx - cx) ** 2 + (yy - cy) ** 2 <= self.radius_px**2] = 1.0
        return image

    def _ground(self, rng: np.random.Generator):  # type: ignore[no-untyped-def]  # a closure
        """Return what the sensor sees of the ground at a time: bilinear samples of a periodic image."""
        side = 512
        noise = rng.standard_normal((side, side))
        if self.kind == "texture":
            image = ndimage.gaussian_filter(noise, 4.0, mode="wrap")
            image *= 0.35 / image.std()
        else:
            turn = np.deg2rad(self.angle_deg)
            yy, xx = np.mgrid[:side, :side]
            along = xx * np.cos(turn) + yy * np.sin(turn)
            image = ndimage.gaussian_filter(np.sign(np.sin(2 * np.pi * along / 32.0)), 0.7, mode="nearest")
        vx, vy = self.velocity
        cx, cy = (self.width - 1) / 2, (self.height - 1) / 2
        yy, xx = np.mgrid[: self.height, : self.width]

        def see(t_s: float) -> Floats:
            if self.omega_rad_s == 0:
                gx, gy = xx - vx * t_s, yy - vy * t_s
            else:
                # Where the ground that is here now was at the beginning: turned about the place that stands still.
                sx, sy = cx - vy / self.omega_rad_s, cy + vx / self.omega_rad_s
                cos, sin = np.cos(-self.omega_rad_s * t_s), np.sin(-self.omega_rad_s * t_s)
                gx = cos * (xx - sx) - sin * (yy - sy) + sx
                gy = sin * (xx - sx) + cos * (yy - sy) + sy
            if self.kind == "edges":
                a, b = np.cos(np.deg2rad(self.angle_deg)), np.sin(np.deg2rad(self.angle_deg))
                return np.asarray(0.6 * np.tanh(8 * np.sin(2 * np.pi * (gx * a + gy * b) / 32.0)))
            return np.asarray(ndimage.map_coordinates(image, [gy, gx], order=1, mode="grid-wrap"))

        return see

    def _message(self, k: int, on: npt.NDArray[np.int64], off: npt.NDArray[np.int64]) -> Onsets:
        count = on + off
        if self.gated:
            count = np.where(ndimage.convolve(count, np.ones((3, 3), np.int64), mode="constant") >= 2, count, 0)
        y, x = np.nonzero(count)
        return Onsets(
            camera="cam0",
            stream="flow",
            width=self.width,
            height=self.height,
            t0_us=k * self.tick_us,
            t1_us=(k + 1) * self.tick_us,
            tick_us=self.tick_us,
            pool_px=1,
            tick=np.zeros(len(x), np.uint16),
            x_px=x.astype(np.uint16),
            y_px=y.astype(np.uint16),
            on_count=np.minimum(on[y, x], 255).astype(np.uint8),
            off_count=np.minimum(off[y, x], 255).astype(np.uint8),
        )
