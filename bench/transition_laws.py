"""What the laws of `simulation.pixel` make of a far bright beacon, for `study_transitions.py`: formulas, no simulation.

A pixel sees v(x) = D (1 - exp(-x / tau)) after a step of D in ln of its irradiance; tau is its photoreceptor's at the
light that it settles to. It fires each time that v has gone by its threshold since it last ended being dead.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.special import ndtr

from heliograph_services.event_source.simulation.contract import PixelNumbers
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.world.optics import Optics
from heliograph_services.event_source.simulation.world.spec import Lens

# Pixels of the recordings, along either side.
CROP_PX = 7
# Assumed of them, and not from the numbers to be compared.
INTENSITY_W_SR = 10.0
IRRADIANCE_W_M2 = 500.0
REFLECTANCE = 0.25
DIAMETER_M = 0.02
LENS = Lens(focal_mm=16.0, f_number=1.4)


def crossings_us(size: float, threshold: float, tau_us: float, refractory_us: float) -> list[float]:
    """Return when a pixel fires after a step v(x) = D (1 - exp(-x / tau)); its reference follows v while it is dead."""
    times, gone = [], 0.0
    while size * math.exp(-gone / tau_us) > threshold:
        times.append(-tau_us * math.log(math.exp(-gone / tau_us) - threshold / size))
        gone = times[-1] + refractory_us
    return times


def predictions(sensor_name: str, distance_m: float, override: dict[str, float]) -> dict[str, Any]:
    """Return events and their spread over 7 x 7 pixels, each step from rest; without mismatch, noise or bus."""
    sensor = load_preset(sensor_name, "", dict(override))
    law: PixelNumbers = sensor.pixel
    optics = Optics(LENS, sensor.pitch_um)
    where = np.array([distance_m])
    flux = float(optics.flux_w_m2(np.array([INTENSITY_W_SR]), where, where)[0])
    sigma = float(optics.sigma_px(np.array([DIAMETER_M]), where)[0])
    dark = optics.background_w_m2(REFLECTANCE, IRRADIANCE_W_M2) + law.dark_w_m2
    along = []
    for n in (sensor.width, sensor.height):
        offset = np.arange(CROP_PX) + round((n - 1) / 2) - CROP_PX // 2 - (n - 1) / 2
        along.append(ndtr((offset + 0.5) / sigma) - ndtr((offset - 0.5) / sigma))
    out: dict[str, Any] = {"flux_w_m2": round(flux, 1), "background_w_m2": round(dark, 2), "sigma_px": round(sigma, 3)}
    for name, threshold in (("on", law.threshold_on), ("off", law.threshold_off)):
        times: list[float] = []
        for share in np.outer(*along).ravel():
            bright = dark + flux * share
            tau_us = max(law.tau_min_us, law.tau_ref_us * law.irradiance_ref_w_m2 / (bright if name == "on" else dark))
            times += crossings_us(math.log(bright / dark), threshold, tau_us, law.refractory_us)
        spread = math.hypot(float(np.std(times)), law.jitter_us)
        out[name] = {
            "events": len(times),
            "sd_us": round(spread, 1),
            "width_10_90_us": round(max(float(np.ptp(np.percentile(times, (10, 90)))), 2.56 * law.jitter_us), 1),
        }
    return out
