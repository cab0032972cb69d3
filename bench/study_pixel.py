"""The pixels, the scan and the optics of the simulation against their formulas, as pictures.

    python bench/study_pixel.py [-o bench/results/pixel_laws.json] [--plot docs/plots/pixel_laws.png]

(a) events of a step D at    tau ln(D / (D - k th)), k = 1 .. floor(D / th)
(b) first event              tau ln(D / (D - th)),   tau = max(tau_min, tau_ref I_ref / I), presets without noise
(c) shot noise               intervals of single pixels, exponential at the stated rate
(d) thresholds               ln I rises by 2 within 2 s: 2 / events of a pixel (less what is left), normal
(e) scan length              T_ED + 640 E max(NEXT_SEL, 5 + B) 20 ns, B binomial of 60 groups, 1 - (1 - share)^8 each
(f) contrast                 ln(1 + P_px / (P_bg + dark)), P_px = I_e / d^2 pi D^2 / 4 T / p^2 share of the middle pixel

Lines are the formulas, worked out here again; points are simulated: the pixels' array, the read-out, or (f) a whole
scene's events. What tests pin is not measured here a second time, it is shown. Evidence: simulated.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from heliograph_services.event_source.simulation.contract import (
    CHUNK_US,
    NODES,
    LightChunk,
    PixelEvents,
    PixelNumbers,
    View,
)
from heliograph_services.event_source.simulation.pixel.array import PixelArray
from heliograph_services.event_source.simulation.readout.numbers import ScanNumbers
from heliograph_services.event_source.simulation.readout.presets import load_preset
from heliograph_services.event_source.simulation.readout.scan import ScanReadout
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.load import parse_scenario

Floats = npt.NDArray[np.float64]
NAME = "pixel_laws/1"
SIZE = 48
LIGHTS = {"indoors, 2 W/m2": 2.0, "overcast, 100 W/m2": 100.0, "sun, 500 W/m2": 500.0}
LENSES = {"3.6 mm f/2.0": (3.6, 2.0), "16 mm f/1.4": (16.0, 1.4)}
DISTANCES_M = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
INTENSITY_W_SR, DIAMETER_M, REFLECTANCE, TRANSMISSION, PSF_PX = 0.4, 0.02, 0.25, 0.9, 0.7
FINE_THRESHOLD = 0.02  # what (f) reads contrasts to
SCENARIO = """
irradiance_w_m2 = {irradiance}
[ground]
reflectance = {reflectance}
[camera]
sensor = "ideal"
path = {{ kind = "still", at_m = [0.0, 0.0, {distance}] }}
lens = {{ focal_mm = {focal}, f_number = {f_number} }}
[camera.override]
"pixel.threshold_on" = {threshold}
"pixel.threshold_off" = {threshold}
"readout.queue_events" = 16000000
[[beacon]]
name = "a"
protocol = "seed11"
payload = 42
bit_rate = 1000
intensity_w_sr = {intensity}
diameter_m = {diameter}
path = {{ kind = "still", at_m = [{x}, {y}, 0.0] }}
"""


def plain(law: PixelNumbers) -> PixelNumbers:
    """Return the law without mismatch, noise, delay and dead time."""
    return replace(
        law, threshold_sd=0.0, refractory_us=0.0, leak_hz=0.0, shot_noise_hz=0.0, hot_pixels=0.0, latency_us=0.0,
        latency_off_extra_us=0.0, jitter_us=0.0,
    )  # fmt: skip


def view_of(irradiance: float, size: int = SIZE) -> View:
    return np.full((size, size), np.log(irradiance), np.float32)


def lit(t0_us: int, flux: float, edge_us: float) -> LightChunk:
    """Return a lamp so wide that the middle pixels share its light evenly, switched on at edge_us."""
    here = np.full((1, NODES + 1), SIZE / 2.0)
    within = t0_us <= edge_us < t0_us + CHUNK_US
    count = int(within)
    sigma = 12.0
    return LightChunk(
        t0_us, here, here.copy(), np.full_like(here, sigma), np.full_like(here, flux),
        np.array([float(t0_us > edge_us)]),
        np.array([0, count]), np.full(count, edge_us), np.ones(count),
    )  # fmt: skip


def middle_share() -> float:
    """Return the share of `lit`'s light in the pixel (24, 24), on which it is centred."""
    return math.erf(0.5 / (12.0 * math.sqrt(2.0))) ** 2


def step_times_us(law: PixelNumbers, ground: float, size: float, until_us: int = 20_000) -> list[float]:
    """Return when the middle pixel fires after its light has risen by a step of ln."""
    view = view_of(ground)
    flux = ground * math.expm1(size) / middle_share()
    pixels = PixelArray(law, SIZE, SIZE, 1, view)
    times: list[float] = []
    for t0_us in range(0, until_us, CHUNK_US):
        events = pixels.interval(t0_us, t0_us + CHUNK_US, view, view, lit(t0_us, flux, 1000.0))
        mine = (events.pixel == (SIZE // 2) * SIZE + SIZE // 2) & events.on
        times += (events.t_us[mine] - 1000.0).tolist()
    return times


def steps() -> list[dict[str, Any]]:
    rows = []
    law = replace(plain(load_preset("davis346").pixel), tau_ref_us=100.0, irradiance_ref_w_m2=1.0, tau_min_us=100.0)
    for size in (0.5, 1.0, 2.0, 4.0):
        k = np.arange(1, math.floor(size / law.threshold_on + 1e-9) + 1)
        k = k[size - k * law.threshold_on > 1e-3]
        seen = step_times_us(law, 1.0, size)[: len(k)]
        stated = 100.0 * np.log(size / (size - k * law.threshold_on))
        rows.append({"size": size, "seen_us": seen, "stated_us": stated.tolist()})
    return rows


def latencies() -> list[dict[str, Any]]:
    rows = []
    for name in ("davis346", "imx636", "dvxplorer_mini"):
        law = plain(load_preset(name).pixel)
        light = np.geomspace(0.003, 30.0, 13)
        size = 1.0
        seen = [step_times_us(law, float(total / math.exp(size)), size, 100_000)[0] for total in light]
        # A view holds light and dark together.
        tau = np.maximum(law.tau_min_us, law.tau_ref_us * law.irradiance_ref_w_m2 / light)
        stated = tau * math.log(size / (size - law.threshold_on))
        rows.append({"preset": name, "light_w_m2": light.tolist(), "seen_us": seen, "stated_us": stated.tolist()})
    return rows


def unlit(t0_us: int) -> LightChunk:
    none = np.empty((0, NODES + 1))
    return LightChunk(t0_us, none, none, none, none, np.empty(0), np.zeros(1, np.int64), np.empty(0), np.empty(0))


def noise() -> dict[str, Any]:
    rate_hz, seconds, size = 5.0, 40, 64
    law = replace(plain(load_preset("davis346").pixel), shot_noise_hz=rate_hz)
    view = view_of(0.05, size)
    pixels = PixelArray(law, size, size, 3, view)
    parts = [pixels.interval(t, t + CHUNK_US, view, view, unlit(t)) for t in range(0, seconds * 1_000_000, CHUNK_US)]
    t_us, pixel = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_us", "pixel"))
    order = np.lexsort((t_us, pixel))
    gaps_s = np.diff(t_us[order])[np.diff(pixel[order]) == 0] * 1e-6
    # Intervals of one pixel each: together they would favour the short ones, since the run ends.
    p = [stats.kstest(np.diff(t_us[pixel == k]), "expon", args=(0, 1e6 / rate_hz)).pvalue for k in range(0, 4096, 41)]
    counts, ends = np.histogram(gaps_s, bins=np.linspace(0.0, 1.6, 41))
    return {
        "rate_hz": rate_hz,
        "rate_seen_hz": len(t_us) / (seconds * size * size),
        "bin_s": float(ends[1]),
        "density": (counts / len(gaps_s) / ends[1]).tolist(),
        "pixels_tested": len(p),
        "share_of_p_below_.01": float(np.mean(np.array(p) < 0.01)),
    }


def ramp() -> dict[str, Any]:
    size, rise = 64, 2.0
    law = replace(plain(load_preset("davis346").pixel), threshold_sd=0.03, tau_ref_us=0.0)
    first = view_of(0.05, size)
    pixels = PixelArray(law, size, size, 7, first)
    now, parts = first, []
    for t in range(0, 2_000_000, 5_000):
        then = first + np.float32(rise * (t + 5_000) / 2e6)
        parts.append(pixels.interval(t, t + 5_000, now, then, unlit(t - t % CHUNK_US)))
        now = then
    t_us, pixel = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_us", "pixel"))
    order = np.lexsort((t_us, pixel))
    count = np.bincount(pixel, minlength=size * size)
    last = np.cumsum(count) - 1
    seen = (t_us[order][last] - t_us[order][last - count + 1]) / (count - 1) * rise / 2e6
    counts, ends = np.histogram(seen, bins=np.linspace(0.08, 0.32, 49))
    return {
        "stated": [law.threshold_on, law.threshold_sd],
        "seen": [round(float(seen.mean()), 5), round(float(seen.std()), 5)],
        "ends": ends.tolist(),
        "density": (counts / len(seen) / (ends[1] - ends[0])).tolist(),
        "error_max": float(np.abs(seen - pixels.thresholds()[0].reshape(-1)).max()),
    }


def scans() -> list[dict[str, Any]]:
    shares = [0.0, *np.geomspace(1e-4, 1.0, 17).tolist()]
    rows = []
    for mode in ("VARIABLE_2000", "VARIABLE_5000", "VARIABLE_10000", "VARIABLE_15000"):
        numbers = load_preset("dvxplorer_mini", mode).readout
        assert isinstance(numbers, ScanNumbers)
        seen, stated = [], []
        for i, share in enumerate(shares):
            active = np.flatnonzero(np.random.default_rng(i).random(640 * 480) < share)
            zeros = np.zeros(len(active))
            crossings = PixelEvents(zeros, active, np.ones(len(active), np.bool_), zeros.astype(np.int16))
            readout = ScanReadout(numbers, 640, 480)
            readout.feed(crossings, 1.0)
            # Until the first scan is over and no second one.
            until_us = 1.0
            while readout.counters["scans"] == 0:
                until_us += 1.0
                readout.feed(PixelEvents(zeros[:0], active[:0], np.ones(0, np.bool_), np.zeros(0, np.int16)), until_us)
            seen.append(readout.until_us)
            groups = np.arange(61)
            chance = stats.binom.pmf(groups, 60, 1.0 - (1.0 - share) ** 8)
            cycles = float((chance * np.maximum(numbers.next_sel_cycles, 5 + groups)).sum())
            stated.append(numbers.detect_us + 640 * cycles * 0.02)
        rows.append({"mode": mode, "active": shares, "seen_us": seen, "stated_us": stated})
    return rows


def contrast_stated(focal_mm: float, f_number: float, irradiance: float, distance_m: float) -> float:
    """Return the law of (f), for a sensor of 9 um and the dark current of the preset `ideal`."""
    pitch_m, focal_m = 9e-6, focal_mm * 1e-3
    caught_w = INTENSITY_W_SR / distance_m**2 * math.pi / 4 * (focal_m / f_number) ** 2 * TRANSMISSION
    sigma = math.hypot(PSF_PX, DIAMETER_M * focal_m / (4 * pitch_m * distance_m))
    share = math.erf(0.5 / (sigma * math.sqrt(2))) ** 2
    ground = REFLECTANCE * irradiance / math.pi * math.pi / (4 * f_number**2) * TRANSMISSION
    return math.log1p(caught_w / pitch_m**2 * share / (ground + load_preset("ideal").pixel.dark_w_m2))


def contrast_seen(focal_mm: float, f_number: float, irradiance: float, distance_m: float) -> float:
    """Return by how much the middle pixel's events go up and down in a scene, to FINE_THRESHOLD."""
    half_px_m = 0.5 * distance_m / (focal_mm * 1e3 / 9.0)
    text = SCENARIO.format(
        irradiance=irradiance, reflectance=REFLECTANCE, distance=distance_m, focal=focal_mm, f_number=f_number,
        threshold=FINE_THRESHOLD, intensity=INTENSITY_W_SR, diameter=DIAMETER_M, x=half_px_m, y=-half_px_m,
    )  # fmt: skip
    ups = []
    for piece in SceneStream(parse_scenario(text, "scenario"), 1):
        mine = (piece.batch.x_px == 320) & (piece.batch.y_px == 240)
        ups.append(np.where(piece.batch.on[mine], 1, -1))
        if piece.until_us >= 40_000:
            break
    level = np.cumsum(np.concatenate(ups))
    return FINE_THRESHOLD * float(np.ptp(level)) if len(level) else 0.0


def contrasts() -> list[dict[str, Any]]:
    return [
        {
            "lens": lens,
            "light": light,
            "distance_m": list(DISTANCES_M),
            "seen": [contrast_seen(*numbers, irradiance, d) for d in DISTANCES_M],
            "stated": [contrast_stated(*numbers, irradiance, d) for d in DISTANCES_M],
        }
        for lens, numbers in LENSES.items()
        for light, irradiance in LIGHTS.items()
    ]


def told(result: dict[str, Any]) -> dict[str, float]:
    """Return the largest differences between points and lines."""

    def worst(rows: list[dict[str, Any]], kind: str) -> float:
        seen, stated = (np.concatenate([np.array(row[f"{w}{kind}"]) for row in rows]) for w in ("seen", "stated"))
        return float(np.abs(seen - stated).max())

    return {
        "a_us": worst(result["steps"], "_us"),
        "b_us": worst(result["latencies"], "_us"),
        "c_rate": result["noise"]["rate_seen_hz"] / result["noise"]["rate_hz"] - 1.0,
        "d_threshold": result["thresholds"]["error_max"],
        "e_us": worst(result["scans"], "_us"),
        "f_ln": worst(result["contrasts"], ""),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    result: dict[str, Any] = {"study": NAME, "evidence": "simulated", "steps": steps(), "latencies": latencies()}
    result |= {"noise": noise(), "thresholds": ramp(), "scans": scans(), "contrasts": contrasts()}
    result["largest_differences"] = told(result)
    print(json.dumps(result["largest_differences"], indent=1))
    if arguments.o is not None:
        arguments.o.write_text(json.dumps(result) + "\n")
    if arguments.plot is not None:
        plot(result, arguments.plot)


def plot(result: dict[str, Any], path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415 - not needed without a plot

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(2, 3, figsize=(16, 9))
    (a, b, c), (d, e, f) = axes

    def pairs(axis: Any, x: list[float], row: dict[str, Any], kind: str, label: str) -> None:
        (line,) = axis.plot(x, row[f"stated{kind}"], "-", lw=1, label=label)
        axis.plot(x, row[f"seen{kind}"], "o", ms=4, color=line.get_color())

    for row in result["steps"]:
        pairs(a, list(range(1, len(row["seen_us"]) + 1)), row, "_us", f"step of {row['size']}")
    a.set(title="a  events of a step, tau 100 us, th .2", xlabel="k", ylabel="time after the edge (us)")
    for row in result["latencies"]:
        pairs(b, row["light_w_m2"], row, "_us", row["preset"])
    b.set(title="b  first event of a step of 1, constant latency apart", xscale="log", yscale="log")
    b.set(xlabel="light on the pixel (W/m2)", ylabel="us")
    n = result["noise"]
    at_s = (np.arange(len(n["density"])) + 0.5) * n["bin_s"]
    c.plot(
        at_s, n["rate_hz"] * np.exp(-n["rate_hz"] * at_s), "-", lw=1, label=f"exponential, {n['rate_hz']:g} a second"
    )
    c.plot(at_s, n["density"], "o", ms=4, label=f"seen: {n['rate_seen_hz']:.3f} a second and pixel")
    c.set(title="c  shot noise: intervals of single pixels", xlabel="s", ylabel="density", yscale="log")
    t = result["thresholds"]
    middle = (np.array(t["ends"][1:]) + t["ends"][:-1]) / 2
    d.plot(middle, stats.norm.pdf(middle, *t["stated"]), "-", lw=1, label="normal, .2 +/- .03")
    d.plot(middle, t["density"], "o", ms=4, label=f"seen: {t['seen'][0]:.4f} +/- {t['seen'][1]:.4f}")
    d.set(title="d  thresholds from a slow ramp", xlabel="ln I", ylabel="density")
    for row in result["scans"]:
        pairs(e, [max(x, 5e-5) for x in row["active"]], row, "_us", row["mode"])
    e.set(title="e  a scan of the DVXplorer Mini", xscale="log", xlabel="share of pixels with an event (left: none)")
    e.set(ylabel="us", ylim=(0, 1200))
    for row in result["contrasts"]:
        pairs(f, row["distance_m"], row, "", f"{row['lens']}, {row['light']}")
    f.axhline(0.25, color="0.6", lw=0.8)
    f.set(title="f  contrast of a beacon of .4 W/sr, 20 mm, in a scene", xscale="log", yscale="log", ylim=(0.01, 12))
    f.set(xlabel="distance (m)", ylabel="step of ln(light) in the middle pixel")
    for axis in axes.flat:
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7)
    figure.suptitle("Simulated pixels, scan and optics (points) and their formulas (lines)")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
