"""What of an LED's light and of the sun's a sensor sees, by wavelength: responsivity, AM1.5G, filters, contrast.

An LED of radiant power P shines ``I(theta) = P (m + 1) / (2 pi) cos^m theta``, m = ln .5 / ln cos(half angle). Through
a lens of f-number N its image, a Gaussian of sigma, has the peak irradiance (d: distance, D = f / N)::

    S = I r(lambda) tau pi (D / 2)^2 / d^2 / (2 pi (sigma pitch)^2)

before ground of reflectance rho in the sun, E(lambda) W/m2/nm::

    B = rho tau / (4 N^2) integral E(lambda) r(lambda) F(lambda) dlambda

r is the responsivity and F a filter. The contrast is S / B. In units of the responsivity's peak both are irradiance "in
the camera's band", which is what a scenario has.

Sources: E, ASTM G173-03 (global, 1000 W/m2 in all), means over 25 nm. Responsivities, relative to peaks, are shapes
that are *assumed*: `photovoltaic`, a crystalline silicon cell (deep, red and infrared count most); `cmos`, a thin pixel
that falls to .35 of its peak at 850 nm and .1 at 940 nm. Which of them a sensor follows decides between 850 and 940 nm;
the makers of event sensors publish no table.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

FIRST_NM: Final = 350.0
STEP_NM: Final = 25.0
AM15G_W_M2_NM: Final = (
    0.503, 0.658, 0.949, 1.194, 1.473, 1.558, 1.554, 1.516, 1.527, 1.502, 1.457, 1.429, 1.397, 1.384, 1.272, 1.136,
    1.125, 1.067, 1.084, 0.917, 0.980, 0.941, 0.758, 0.549, 0.355, 0.627, 0.733, 0.695, 0.653, 0.603, 0.495, 0.155,
)  # fmt: skip
# (nm, relative to the peak), straight lines between them.
RESPONSIVITIES: Final = {
    "photovoltaic": (
        (350.0, 0.15), (400.0, 0.38), (500.0, 0.58), (600.0, 0.70), (700.0, 0.82), (800.0, 0.91), (900.0, 0.98),
        (950.0, 1.0), (1000.0, 0.94), (1050.0, 0.6), (1100.0, 0.18), (1150.0, 0.0),
    ),
    "cmos": (
        (350.0, 0.3), (450.0, 0.75), (550.0, 1.0), (650.0, 0.9), (750.0, 0.65), (850.0, 0.35), (940.0, 0.1),
        (1000.0, 0.04), (1050.0, 0.01), (1100.0, 0.0),
    ),
}  # fmt: skip
# A bandpass about the LED; none: whatever the sensor sees.
FILTER_NM: Final = 50.0
FULL_SUN_W_M2: Final = 1000.0


def wavelengths_nm() -> Floats:
    """Return the (32,) wavelengths of the spectrum."""
    return FIRST_NM + STEP_NM * np.arange(len(AM15G_W_M2_NM), dtype=np.float64)


def responsivity(curve: str, nm: Floats) -> Floats:
    """Return the responsivity at wavelengths, relative to its peak."""
    points = np.array(RESPONSIVITIES[curve])
    out: Floats = np.interp(nm, points[:, 0], points[:, 1], left=0.0, right=0.0)
    return out


def sun_in_band_w_m2(curve: str, sun_w_m2: float, led_nm: float | None) -> float:
    """Return what a sensor makes of the sun: of all of it, or of FILTER_NM about an LED."""
    nm = np.arange(FIRST_NM, wavelengths_nm()[-1] + 1.0)
    light = np.interp(nm, wavelengths_nm(), AM15G_W_M2_NM) * responsivity(curve, nm)
    if led_nm is not None:
        light = light * (np.abs(nm - led_nm) <= FILTER_NM / 2.0)
    return float(light.sum() * sun_w_m2 / FULL_SUN_W_M2)


def intensity_w_sr(power_w: float, half_angle_deg: float) -> float:
    """Return the radiant intensity of an LED on its axis."""
    m = math.log(0.5) / math.log(math.cos(math.radians(half_angle_deg)))
    return power_w * (m + 1.0) / (2.0 * math.pi)


def contrast(led_w_sr: float, band_w_m2: float, distance_m: float, focal_mm: float, sigma_px: float) -> float:
    """Return S / B of an LED, in light of the camera's band; the f-number and the lens' transmission cancel.

    Args:
        led_w_sr: its intensity times the responsivity.
        band_w_m2: of the ground, likewise.
        distance_m: to it.
        focal_mm: of the lens.
        sigma_px: of its image.
    """
    pitch_mm, reflectance = 9e-3, 0.25
    spot_mm2 = 2.0 * math.pi * (sigma_px * pitch_mm) ** 2
    return led_w_sr * math.pi * focal_mm**2 / (distance_m**2 * spot_mm2 * reflectance * band_w_m2)


def range_m(led_w_sr: float, band_w_m2: float, focal_mm: float, sigma_px: float, least: float) -> float:
    """Return the distance at which the contrast has fallen to a value."""
    return math.sqrt(contrast(led_w_sr, band_w_m2, 1.0, focal_mm, sigma_px) / least)
