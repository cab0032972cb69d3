"""What reaches the sensor of a light and of the ground: the link budget. All light is within the camera's band.

A light of I_e W/sr (on its axis) at the distance d, seen through a lens of aperture D = f / N and transmission T::

    Phi        = I_e L / d^2  pi D^2 / 4  T / v^3           W through the lens
    flux       = Phi / p^2                                  W/m2 of a pixel (pitch p) that would get all of it
    L          = cos^m b, m = ln .5 / ln cos b_half         lobe of the emitter, b off its axis (0 behind it)
    v          = Z / d                                      cosine off the camera's axis, Z the depth

The ground, a matt surface of reflectance rho in the irradiance E (radiance rho E / pi), evenly over the sensor::

    background = rho E / pi  pi / (4 N^2)  T                W/m2

Why v^3: a pixel off the axis sees v^3 of the solid angle. Where the ground's image is taken to be even, the lens has
made up for it by an aperture larger by 1 / v^3, and a light sees that aperture too. (On the axis, and for narrow
lenses, v = 1. A real lens that darkens towards its corners darkens light and ground alike: the contrast stays.)

The image of a light is a round Gaussian, variances added::

    sigma^2    = sigma_psf^2 + (w f / (4 p Z))^2 + (c / (4 p))^2
    c          = D f |Z - s| / (Z (s - f))                  blur disc of a thin lens in focus at s

for a uniform disc of diameter q has the standard deviation q / 4 on each axis (mean of x^2 over a disc of radius R is
R^2 / 4). The disc of diameter w is taken face on; several LEDs are several lights. Peak contrast of a centred image::

    share      = (2 Phi(1 / (2 sigma)) - 1)^2               of the flux in the middle pixel, Phi the normal distribution
    contrast   = ln(1 + flux share / (background + dark))

so contrast falls with d^2 while the image is the point spread, and not at all while its disc covers the pixel.
Sources: photometry of any textbook (Hecht, "Optics", 5.7 and 5.2); defaults of the numbers in `spec.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, cast

import numpy as np

from heliograph_services.event_source.simulation.contract import Floats
from heliograph_services.event_source.simulation.world.spec import Lens

# Full width at half maximum of a Gaussian over its standard deviation: 2 sqrt(2 ln 2).
FWHM_PER_SIGMA: Final = 2.3548200450309493
# Nearer than so many focal lengths a lens focused far away shows no image that these laws describe.
NEAREST_FOCAL_LENGTHS: Final = 5.0


@dataclass(frozen=True, slots=True)
class Optics:
    """A lens before pixels of one pitch.

    Args:
        lens: as the scenario gives it.
        pitch_um: of the pixels.
    """

    lens: Lens
    pitch_um: float

    @property
    def focal_m(self) -> float:
        """The focal length, m."""
        return self.lens.focal_mm * 1e-3

    @property
    def f_px(self) -> float:
        """The focal length in pixels."""
        return self.lens.focal_mm * 1e3 / self.pitch_um

    @property
    def aperture_m(self) -> float:
        """D, m."""
        return self.focal_m / self.lens.f_number

    @property
    def nearest_m(self) -> float:
        """The depth nearer than which nothing is shown."""
        return NEAREST_FOCAL_LENGTHS * self.focal_m

    def flux_w_m2(self, intensity_w_sr: Floats, distance_m: Floats, depth_m: Floats) -> Floats:
        """Return the flux of lights of an intensity towards the camera (lobe included)."""
        pitch_m = self.pitch_um * 1e-6
        area = math.pi / 4.0 * self.aperture_m**2 * self.lens.transmission / pitch_m**2
        # 1 / (d^2 v^3) = d / Z^3
        return intensity_w_sr * area * distance_m / depth_m**3

    def background_w_m2(self, reflectance: float, irradiance_w_m2: float) -> float:
        """Return the irradiance of a pixel that sees a matt surface."""
        return reflectance * irradiance_w_m2 * self.lens.transmission / (4.0 * self.lens.f_number**2)

    def sigma_px(self, diameter_m: Floats, depth_m: Floats) -> Floats:
        """Return the standard deviation of the image of discs that shine."""
        lens = self.lens
        variance = lens.psf_sigma_px**2 + (diameter_m * self.f_px / (4.0 * depth_m)) ** 2
        if lens.focus_m is not None:
            blur_m = self.aperture_m * self.focal_m * np.abs(depth_m - lens.focus_m)
            blur_m = blur_m / (depth_m * (lens.focus_m - self.focal_m))
            variance = variance + (blur_m / (4e-6 * self.pitch_um)) ** 2
        return cast("Floats", np.sqrt(variance))


def lobe(cosine: Floats, half_angle_deg: Floats) -> Floats:
    """Return cos^m, 0 behind the emitter; 1 everywhere where half_angle_deg is nan (no lobe)."""
    m = np.log(0.5) / np.log(np.cos(np.radians(half_angle_deg)))
    return cast("Floats", np.where(np.isnan(half_angle_deg), 1.0, np.maximum(cosine, 0.0) ** m))


def peak_share(sigma_px: float) -> float:
    """Return the share of an image's light that falls into the pixel on which it is centred."""
    return math.erf(0.5 / (sigma_px * math.sqrt(2.0))) ** 2


def contrast(flux_w_m2: float, sigma_px: float, background_w_m2: float, dark_w_m2: float = 0.0) -> float:
    """Return the step of ln(irradiance) in the middle pixel when the light goes on."""
    return math.log1p(flux_w_m2 * peak_share(sigma_px) / (background_w_m2 + dark_w_m2))
