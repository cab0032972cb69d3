"""The scenes of the link's study: one beacon that moves or stands, and scenes of the built-in scenarios in short.

A beacon that moves is a shuttle at 2 m/s with turns of 0.2 s, seen from straight above in office light (2 W/m2), as in
the scenarios `lab_moving` and `lab_moving_16mm`; its way fills the image as far as 5 m allow. Every run draws, from
its seed: which end the beacon starts from, the phase of its bits, how much its clock is off (real beacons: 300 to
400 ppm), and what it sends: a new payload for every frame, or a text without repetition.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from heliograph_services.event_source.simulation.world import load

SPEED_M_S: Final = 2.0
TURN_S: Final = 0.2
# The scenarios' f-numbers: f/2.0 of the camera's own lens, f/1.4 assumed for the other.
F_NUMBERS: Final = {3.6: 2.0, 16.0: 1.4}
SENSOR_WIDTH_MM: Final = 640 * 9e-3
# Of the image's width to each side of its middle; the rest keeps the beacon in view at its turns.
SPAN: Final = 0.42
HALF_WAY_MAX_M: Final = 2.5
CLOCK_PPM: Final = 400.0
TEXT_LETTERS: Final = "abcdefghijklmnopqrstuvwxyz 0123456789.,;:!?ABCDEFGHIJKLMNOPQRSTUVWXYZ"
# The paper's, and those of `construction_site_nrp`.
PAYLOADS: Final = (42, 21, 51, 11, 37, 19, 26, 53)
PLACES: Final = {
    "sun": "construction_site_sun",
    "handheld": "handheld",
    "nrp": "construction_site_nrp",
}
# In 1.6 s across the site at 10 m/s, as the scenario does after 20 s of hovering.
SUN_FLIGHT: Final = "points = [[0, -8, 0, 28], [2, -8, 0, 28], [3.6, 8, 0, 28], [6, 8, 0, 28], [7.6, -8, 0, 28]]\n"


@dataclass(frozen=True, slots=True)
class Condition:
    """What is run.

    Args:
        name: of the row.
        group: of the table.
        protocol: seed11 or uart.
        bit_rate: bits a second.
        distance_m: of one beacon; 0 for a built-in place.
        focal_mm: of the lens.
        place: a name of PLACES, or moving, or static.
        seconds: of a run.
    """

    name: str
    group: str
    protocol: Literal["seed11", "uart"]
    bit_rate: float
    distance_m: float = 0.0
    focal_mm: float = 3.6
    place: str = "moving"
    seconds: float = 8.0


def scenario(condition: Condition, seed: int, *, repeats: bool = False) -> str:
    """Return the text of the scenario that a run of the condition shows.

    Args:
        condition: what is run.
        seed: of the run.
        repeats: every beacon repeats one payload, as the paper's do, instead of drawing a new one for every frame.
    """
    if condition.place in PLACES:
        return _built_in(condition, repeats=repeats)
    rng = np.random.Generator(np.random.Philox(seed))
    bit_us = 1e6 / condition.bit_rate
    start_us = rng.uniform(0.0, 11.0) * bit_us
    ppm = rng.uniform(-CLOCK_PPM, CLOCK_PPM)
    side = 1.0 if rng.random() < 0.5 else -1.0
    half_m = min(HALF_WAY_MAX_M, SPAN * SENSOR_WIDTH_MM / condition.focal_mm * condition.distance_m)
    if condition.place == "static":
        # Anywhere on a pixel: what a still image shows depends on it.
        x_m, y_m = rng.uniform(-0.02, 0.02, 2)
        path = f'path = {{ kind = "still", at_m = [{x_m:.5f}, {y_m:.5f}, 0] }}'
    else:
        ends = [f"[{s * half_m:.4f}, {s * 0.16 * half_m:.4f}, 0]" for s in (-side, side)]
        path = (
            f'path = {{ kind = "shuttle", from_m = {ends[0]}, to_m = {ends[1]}, speed_m_s = {SPEED_M_S},'
            f" turn_s = {TURN_S} }}"
        )
    says = f"payload = {PAYLOADS[0]}" if repeats else "fresh = true"
    if condition.protocol == "uart":
        length = int(condition.bit_rate / 10 * condition.seconds) + 100
        letters = "".join(TEXT_LETTERS[i] for i in rng.integers(0, len(TEXT_LETTERS), min(length, 9000)))
        says = f'text = "{letters}"'
    return f"""about = "{condition.name}"
irradiance_w_m2 = 2.0
[camera]
sensor = "dvxplorer_mini"
path = {{ kind = "still", at_m = [0, 0, {condition.distance_m}] }}
lens = {{ focal_mm = {condition.focal_mm}, f_number = {F_NUMBERS[condition.focal_mm]} }}
[[beacon]]
name = "beacon"
protocol = "{condition.protocol}"
{says}
bit_rate = {condition.bit_rate}
start_us = {start_us:.1f}
clock_ppm = {ppm:.1f}
intensity_w_sr = 0.4
diameter_m = 0.02
{path}
"""


def _built_in(condition: Condition, *, repeats: bool) -> str:
    """Return a built-in scenario in which every beacon sends seed11."""
    text = (Path(load.__file__).parent / "scenarios" / f"{PLACES[condition.place]}.toml").read_text(encoding="utf-8")
    if condition.place == "sun":
        text = re.sub(r"^points = \[.*?^\]\n", SUN_FLIGHT, text, count=1, flags=re.DOTALL | re.MULTILINE)
    head, *beacons = text.split("[[beacon]]")
    last, *after = beacons[-1].split("[[clutter]]")
    beacons[-1] = last
    said = re.compile(r"(protocol|options|payload|text|gap_bits|fresh|bit_rate) *=")
    for i, beacon in enumerate(beacons):
        kept = [line for line in beacon.splitlines() if not said.match(line)]
        says = f"payload = {PAYLOADS[i]}" if repeats else "fresh = true"
        beacons[i] = "\n".join([*kept, f'protocol = "seed11"\nbit_rate = {condition.bit_rate:g}\n{says}\n'])
    return "".join([head, *("[[beacon]]" + one for one in beacons), *("[[clutter]]" + one for one in after)])


def _conditions() -> tuple[Condition, ...]:
    rows = [
        Condition(f"{d:g} m, {f:g} mm", "2 m/s, seed11 at 2 kbit/s", "seed11", 2000.0, d, f)
        for d in (5.0, 16.0)
        for f in (3.6, 16.0)
    ]
    still = "standing still, seed11, 16 mm"
    rows += [
        Condition("11.5 m, 1 kbit/s", still, "seed11", 1000.0, 11.5, 16.0, "static", 6.0),
        Condition("16 m, 100 bit/s", still, "seed11", 100.0, 16.0, 16.0, "static", 12.0),
    ]
    rows += [
        Condition(f"{rate:g} bit/s, {d:g} m, {f:g} mm", "2 m/s, text (uart)", "uart", rate, d, f)
        for d, f in ((5.0, 3.6), (16.0, 16.0))
        for rate in (504.0, 1000.0, 2000.0, 3125.0)
    ]
    moving = "other scenes, seed11 at 1 kbit/s"
    rows += [
        Condition("sun: eight beacons from 28 m, 500 W/m2", moving, "seed11", 1000.0, place="sun", seconds=6.0),
        Condition("handheld: four beacons at 4 to 12 m", moving, "seed11", 1000.0, place="handheld", seconds=6.0),
    ]
    nrp = "images compared (the paper's simulated camera), seed11 at 50 bit/s"
    rows.append(Condition("construction_site_nrp", nrp, "seed11", 50.0, place="nrp", seconds=20.0))
    return tuple(rows)


CONDITIONS: Final = _conditions()
