"""Study 5: LED wavelength and half angle over range and solar irradiance, with two responsivities.

The paper chose 850 nm, by experiment: range over wavelength and half angle, against the sun (AM1.5G). Here the range is
the largest distance at which an LED of 1 W, on its axis, has a contrast above .25 before sunlit ground (`sunlight`): by
arithmetic, and an upper bound. Cells of the kind `seen` then put that light into the simulator and read it: what MAR
there is about such a range, for 850 and 940 nm, whose order the responsivity decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np

from heliograph_services.cli.studies import contest
from heliograph_services.cli.studies.contest import Scene
from heliograph_services.cli.studies.study import (
    Cell,
    Counts,
    Curve,
    Done,
    Figure,
    Panel,
    Parameters,
    Row,
    Size,
    Study,
    Table,
)
from heliograph_services.cli.studies.sunlight import (
    FULL_SUN_W_M2,
    RESPONSIVITIES,
    intensity_w_sr,
    range_m,
    responsivity,
    sun_in_band_w_m2,
)

LEDS_NM: Final = (660.0, 780.0, 850.0, 880.0, 940.0, 950.0, 1050.0)
HALF_ANGLES_DEG: Final = (5.0, 10.0, 20.0, 40.0, 60.0)
SUNS_W_M2: Final = (FULL_SUN_W_M2, 100.0)
POWER_W: Final = 1.0
CONTRAST: Final = 0.25
FOCAL_MM: Final = 16.0
# The scenario's lens: its point spread is larger than the LED's image.
SIGMA_PX: Final = 0.7
SEEN_NM: Final = (850.0, 940.0)
# Of the range by arithmetic: from where all is read to where nothing is left. A contrast of .25 is one threshold in the
# brightest pixel; a target of the tracker has four pixels, which takes several times that.
SHARES: Final = (0.15, 0.3, 0.5, 0.75, 1.0)
SEEN_HALF_ANGLE_DEG: Final = 20.0
BIT_RATE: Final = 1000.0
RUNS: Final = 3
SECONDS_S: Final = 2.5


def cells(size: Size) -> list[Parameters]:
    """Return all cells: by arithmetic, and seen."""
    out: list[Parameters] = [
        {"kind": "range", "curve": curve, "filter": filtered, "sun_w_m2": sun, "led_nm": nm}
        for curve, filtered, sun, nm in product(RESPONSIVITIES, (False, True), SUNS_W_M2, LEDS_NM)
    ]
    if size == "quick":
        return out[:7]
    return out + [
        {"kind": "seen", "arms": ["ours", *contest.EARS], "curve": curve, "led_nm": nm, "share": share, "run": run}
        for curve, nm, share, run in product(RESPONSIVITIES, SEEN_NM, SHARES, range(RUNS))
    ]


def run(cell: Cell) -> Counts:
    """Run a cell."""
    one = cell.parameters
    if one["kind"] == "range":
        ranges = [reach_m(one, half_angle) for half_angle in HALF_ANGLES_DEG]
        return {"range_m": [round(value, 3) for value in ranges]}
    told = {"curve": one["curve"], "filter": False, "sun_w_m2": FULL_SUN_W_M2, "led_nm": one["led_nm"]}
    distance_m = one["share"] * reach_m(told, SEEN_HALF_ANGLE_DEG)
    led, band = light(told, SEEN_HALF_ANGLE_DEG)
    rng = np.random.default_rng(cell.seed)
    x_m, y_m = rng.uniform(-0.02, 0.02, 2)
    text = (
        f'about = "an LED of {one["led_nm"]:g} nm in the sun"\nirradiance_w_m2 = {band:.4f}\n'
        f'[camera]\nsensor = "dvxplorer_mini"\npath = {{ kind = "still", at_m = [0, 0, {distance_m:.3f}] }}\n'
        f"lens = {{ focal_mm = {FOCAL_MM}, f_number = 1.4 }}\n"
        f'[[beacon]]\nname = "a"\nprotocol = "seed11"\nfresh = true\nbit_rate = {BIT_RATE}\n'
        f"intensity_w_sr = {led:.6f}\ndiameter_m = 0.005\nclock_ppm = {rng.uniform(-100.0, 100.0):.1f}\n"
        f"start_us = {rng.uniform(0.0, 11e6 / BIT_RATE):.1f}\n"
        f'path = {{ kind = "still", at_m = [{x_m:.5f}, {y_m:.5f}, 0] }}\n'
    )
    seen = contest.watch(Scene(text, SECONDS_S, "seed11", BIT_RATE), cell.seed, one["arms"])
    return contest.counts(seen) | {"distance_m": round(distance_m, 2)}


def light(one: Parameters, half_angle_deg: float) -> tuple[float, float]:
    """Return an LED's intensity (W/sr) and the sun's irradiance (W/m2), both in the camera's band."""
    nm = one["led_nm"]
    led = intensity_w_sr(POWER_W, half_angle_deg) * float(responsivity(one["curve"], np.array([nm]))[0])
    return led, sun_in_band_w_m2(one["curve"], one["sun_w_m2"], nm if one["filter"] else None)


def reach_m(one: Parameters, half_angle_deg: float) -> float:
    """Return the range of an LED, by arithmetic."""
    led, band = light(one, half_angle_deg)
    return range_m(led, band, FOCAL_MM, SIGMA_PX, CONTRAST) if band > 0.0 else 0.0


COLUMNS: Final = {"ours": "ours", "genie": "genie"}


def tables(done: Sequence[Done]) -> list[Table]:
    """Return ranges, and what is read about them."""
    names = tuple(f"{half_angle:g} degrees" for half_angle in HALF_ANGLES_DEG)
    rows = []
    for one in done:
        if one["kind"] == "range":
            filtered = "filter of 50 nm" if one["filter"] else "no filter"
            what = f"{one['curve']}, {filtered}, {one['sun_w_m2']:g} W/m2, {one['led_nm']:g} nm"
            reach = {
                name: Figure(round(value, 1), unit="m")
                for name, value in zip(names, one.counts["range_m"], strict=True)
            }
            quoted = "its choice" if one["led_nm"] == 850.0 else "-"
            rows.append(Row(what, quoted, reach, "", "arithmetic"))
    seen = [one for one in done if one["kind"] == "seen"]
    columns = COLUMNS
    read = [
        contest.row(f"{curve}, {nm:g} nm, {share:g} of its range, {some[0].counts['distance_m']:g} m", some, columns)
        for (curve, nm, share), some in contest.grouped(seen, "curve", "led_nm", "share").items()
    ]
    return [
        Table(
            "Range (contrast above .25) on the axis, by half angle",
            names,
            rows,
            f"An LED of {POWER_W:g} W, 16 mm lens.",
        ),
        Table("MAR_sent about the range: no filter, full sun, half angle 20 degrees, 1 kbit/s", tuple(columns), read),
    ]


def panels(done: Sequence[Done]) -> list[Panel]:
    """Return range over wavelength in full sun, a panel a responsivity."""
    out = []
    for curve in RESPONSIVITIES:
        curves = []
        for filtered, half_angle in product((False, True), (10.0, 40.0)):
            at = HALF_ANGLES_DEG.index(half_angle)
            mine = [
                one
                for one in done
                if one["kind"] == "range" and one["curve"] == curve and one["filter"] == filtered
                if one["sun_w_m2"] == FULL_SUN_W_M2
            ]
            name = f"{half_angle:g} degrees, {'50 nm filter' if filtered else 'no filter'}"
            curves.append(Curve(name, [one["led_nm"] for one in mine], [one.counts["range_m"][at] for one in mine]))
        out.append(Panel(f"{curve}, full sun", "nm", "range, m", curves))
    return out


STUDY: Final = Study(
    name="wavelength",
    version=2,
    title="Wavelength and half angle of the LED, in the sun",
    about=(
        "Range of an LED of 1 W on its axis before ground lit by the sun (AM1.5G, ASTM G173-03), for two responsivities"
        " whose shapes are assumed: a silicon cell's, and that of a thin CMOS pixel. Which of 850 and 940 nm reaches"
        " farther turns on it, and on a filter; the paper chose 850 nm, by experiment, and gives no numbers."
        " These ranges are upper bounds, by arithmetic: clear air, an image of .7 px, one threshold in one pixel. What"
        " is read of the simulated light about them stands below."
    ),
    preset="dvxplorer_mini (VARIABLE_5000), 16 mm f/1.4",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
)
