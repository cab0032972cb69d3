"""What a change of an LED's light looks like in events: two recordings of Wang et al. (2022), and simulated beacons.

    python bench/study_transitions.py [FOLDER] [-o bench/results/transitions.json] [--plot docs/plots/transitions.png]

FOLDER holds `504hz_100m.mat` and `3125hz_30m.mat` (for academic use only, not part of this project; Z. Wang, Y. Ng,
J. Henderson, R. Mahony, "Smart visual beacons with asynchronous optical communications using event cameras", IROS
2022; github.com/ziweiWWANG/Event-Beacon-Communication). Where they are absent the simulated rows stand alone.

The same code measures all streams. Edges: our text receiver decides characters; their bits, at its bit clock, give the
edges of the light, shifted as a whole so that most events agree with the light's last change. A *transition* is the
time from one edge to the next (or to the character's end, where no character follows at once); its events are those
of its own polarity. Then

    events       how many it has: quartiles over the transitions
    width        time between the first and the last tenth of its events, median over transitions of 3 bits and more
    sd           sqrt(mean over transitions of the variance of its events' times), of 3 bits and more
    sd_first_bit the same of the events within the first bit, all transitions
    sd_clock     standard deviation of all events' times about the clock's edge, less the mean delay (all transitions)
    onset        the 5th percentile of its events' times after the edge, median; mean: their mean
    off later    mean and onset of OFF less those of ON

WHAT WAS KNOWN AND ASSUMED before the simulated rows were run. Of the recordings' making we have read the abstract and
the project's page: a bright LED, full sunlight, 100 m and 30 m, an event camera whose name we have not found; no lens,
no power. The files hold times and polarities only. In their time stamps at most 7 events share a time, bursts come at
49, and so the files look like 7 x 7 pixels, read by rows, all of which fire; within a transition bursts follow each
other by about 90 us (504 bit/s) and 110 us (3125 bit/s), so a pixel there seems dead for some 80 us after an event.
Assumed, therefore, and not from the numbers to be compared: 10 W/sr (a power LED of 3 W of light in a cone of 30
degrees), 20 mm, lens 16 mm f/1.4 in focus, ground of reflectance .25 in 500 W/m2, camera still, 7 x 7 pixels about the
image, presets davis346 and imx636 as they are; and both with a refractory time of 80 us, the one number that the
recordings' bursts suggest. `transition_laws` works out what the laws of `simulation.pixel` make of that (formulas
alone, no simulation).

PREDICTED: (1) both presets make far fewer events than the recordings, davis346 because its image is small (sigma .7 px
of 18.5 um: a third of the 49 pixels gets light), and both because their refractory time swallows crossings of a
photoreceptor that settles within 10 us in this sun; (2) spreads are tens of us at the most, against 285 and 72 us that
were measured of the recordings before: in this light the presets' photoreceptors are at their fastest; (3) a
refractory time of 80 us leaves about one event a pixel, so it does not explain the recordings either: there the light
as the pixels see it goes on changing for hundreds of us (photoreceptors slowed by their biases, an LED or its driver
that is slow, or a stretched read-out; the files cannot tell which); (4) OFF is no later than ON by more than the
difference of tau, a few us. Nothing is fitted to make the numbers meet.

SEEN. The recordings have 381 / 338 events ON / OFF (median) at 504 bit/s and 236 (mean; median 234) / 144 at 3125,
which agrees with what was measured before. Their spread depends on what one calls so: within the first bit after an
edge sd 455 / 485 us and 85 / 80 us; over whole transitions about 1000 and 255 us; the 285 and 72 us measured before
came without their definition, the second is near ours of the first bit, the first is not. At 504 bit/s the response is
a plateau of some 700 us (every pixel fires as often as it can), then an exponential of about 600 us; at 3125 bit/s the
plateau outlasts three bits. OFF's mean is 44 and 38 us later. (1) and (3) came as predicted: 12 to 61 events, the laws'
but for pixels that a step barely takes over their threshold (17 seen of 24: eight of them see a step of .202 at
thresholds of .2 +/- .03). (2) too: widths of 11 to 65 us (13 to 51 predicted); within the first bit of 504 bit/s sd is
up to 38 us, not 5, for a stray event of noise now and then. So the presets do not resemble these recordings: 4 to 32
times fewer events, 11 to 180 times narrower; what is simulated with them is easier in timing and harder in the number
of events than what that camera saw. (4) holds of the presets, not of the recordings. Nothing in the files tells
whether it is that camera's bandwidth, the LED, or the size of its image.
Evidence: recording (development data) and simulated.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from transition_laws import CROP_PX, DIAMETER_M, INTENSITY_W_SR, IRRADIANCE_W_M2, LENS, REFLECTANCE, predictions

from heliograph.events import Flags, Times
from heliograph.link.contract import LinkFrame
from heliograph.link.text_receiver import TextReceiver
from heliograph.link.uart_layout import CHARACTER_BITS, character_bits
from heliograph.units import bit_us
from heliograph_services.event_source.cameras.formats.contract import Size
from heliograph_services.event_source.cameras.formats.matlab import MatlabReader
from heliograph_services.event_source.simulation.stream import SceneStream
from heliograph_services.event_source.simulation.world.load import parse_scenario

Floats = npt.NDArray[np.float64]

NAME = "transitions/1"
CITATION = "Wang et al. 2022"
LINKS = {504.0: ("504hz_100m.mat", 100.0), 3125.0: ("3125hz_30m.mat", 30.0)}
PUBLISHED_BEFORE = {504.0: "379/340, 285 us", 3125.0: "236/147, 72 us"}
SECONDS_S = {504.0: 6.0, 3125.0: 2.0}
SENSORS = ("davis346", "imx636")
REFRACTORY_SEEN_US = 80.0
WHOLE_BITS = 3  # transitions of so many bits and more show the whole response
# Any English text does: the receiver wants news, the contexts of the bits should be mixed.
TEXT = "A beacon says who it is by blinking, and whoever looks may read it. Light needs no leave; it goes on its way."
SCENARIO = """
about = "a bright beacon far away in full sun"
irradiance_w_m2 = {irradiance}
[ground]
reflectance = {reflectance}
[camera]
sensor = "{sensor}"
path = {{ kind = "still", at_m = [0.0, 0.0, {distance}] }}
lens = {{ focal_mm = {focal}, f_number = {f_number} }}
override = {override}
[[beacon]]
name = "a"
protocol = "uart"
text = "{text}"
bit_rate = {rate}
gap_bits = 40
intensity_w_sr = {intensity}
diameter_m = {diameter}
path = {{ kind = "still", at_m = [0.0, 0.0, 0.0] }}
"""


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Events of a blob."""

    t_us: Times
    on: Flags


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Changes of the light: when, how far it is certain that it stayed so, and whether it went on; rising."""

    t_us: Floats
    until_us: Floats
    on: Flags


def recorded(file: Path) -> Stream:
    chunks = [chunk.batch for chunk in MatlabReader(file, Size(0, 0)).chunks()]
    return Stream(np.concatenate([c.t_us for c in chunks]), np.concatenate([c.on for c in chunks]))


def simulated(sensor: str, rate: float, distance_m: float, override: dict[str, float]) -> Stream:
    table = ", ".join(f'"{key}" = {value}' for key, value in override.items())
    text = SCENARIO.format(
        irradiance=IRRADIANCE_W_M2, reflectance=REFLECTANCE, sensor=sensor, distance=distance_m, text=TEXT, rate=rate,
        focal=LENS.focal_mm, f_number=LENS.f_number, override=f"{{ {table} }}", intensity=INTENSITY_W_SR,
        diameter=DIAMETER_M,
    )  # fmt: skip
    scene = SceneStream(parse_scenario(text, "scenario"), 1)
    left, top = (round((n - 1) / 2) - CROP_PX // 2 for n in (scene.sensor.width, scene.sensor.height))
    t_us, on = [], []
    for piece in scene:
        x, y = piece.batch.x_px.astype(int) - left, piece.batch.y_px.astype(int) - top
        mine = (x >= 0) & (x < CROP_PX) & (y >= 0) & (y < CROP_PX)
        t_us.append(piece.batch.t_us[mine])
        on.append(piece.batch.on[mine])
        if piece.until_us >= SECONDS_S[rate] * 1e6:
            break
    return Stream(np.concatenate(t_us), np.concatenate(on))


def decided(stream: Stream, rate: float) -> Edges:
    """Return the edges of the characters that the receiver decides."""
    receiver = TextReceiver(rate)
    frames: list[tuple[float, float, int]] = []
    step_us = int(20 * bit_us(rate))
    starts = np.arange(int(stream.t_us[0]), int(stream.t_us[-1]) + step_us, step_us)
    cuts = np.searchsorted(stream.t_us, starts)
    for a, b, end_us in zip(cuts[:-1], cuts[1:], starts[1:], strict=True):
        found = receiver.feed(stream.t_us[a:b], stream.on[a:b], int(end_us))
        if found:
            bit = bit_us(receiver.quality(int(end_us)).bit_rate)
            frames += [
                (f.t_us - CHARACTER_BITS * bit, bit, f.payload) for f in found if isinstance(f, LinkFrame)
            ]  # fmt: skip
    t_us, ends, on = [], [], []
    for i, (start_us, bit, code) in enumerate(frames):
        bits = (1, *character_bits(code))
        end_us = start_us + CHARACTER_BITS * bit
        follows = i + 1 < len(frames) and abs(frames[i + 1][0] - end_us) < bit / 2
        changes = [k for k in range(CHARACTER_BITS) if bits[k] != bits[k + 1]]
        t_us += [start_us + k * bit for k in changes]
        on += [bits[k + 1] == 1 for k in changes]
        last_us = frames[i + 1][0] if follows else end_us
        ends += [*(start_us + k * bit for k in changes[1:]), last_us]
    return Edges(np.array(t_us), np.array(ends), np.array(on, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class Delays:
    """Events that belong to a transition and agree with it.

    Args:
        index: (n,) of the transition.
        delay_us: (n,) after its edge.
        contrary: share of the events within transitions that do not agree.
        shift_us: by which all edges were moved.
    """

    index: npt.NDArray[np.int64]
    delay_us: Floats
    contrary: float
    shift_us: float


def delays(stream: Stream, edges: Edges, rate: float) -> Delays:
    def at(shift_us: float) -> tuple[npt.NDArray[np.int64], Flags, Flags]:
        index = np.searchsorted(edges.t_us + shift_us, stream.t_us, side="right") - 1
        within = (index >= 0) & (stream.t_us < edges.until_us[index] + shift_us)
        return index, within, within & (stream.on == edges.on[index])

    def agreement(shift_us: float) -> float:
        _, within, agree = at(shift_us)
        return float(agree.sum() / max(within.sum(), 1))

    shifts = np.arange(-64, 65) / 64 * bit_us(rate)
    scores = np.array([agreement(shift) for shift in shifts])
    # Where many shifts are as good (light that settles within a bit), the middle of them.
    shift_us = float(shifts[scores >= scores.max() - 1e-4].mean())
    index, within, agree = at(shift_us)
    delay_us = stream.t_us[agree] - edges.t_us[index[agree]]
    return Delays(index[agree], delay_us, 1.0 - float(agree.sum() / within.sum()), shift_us)


def statistics(stream: Stream, edges: Edges, rate: float) -> dict[str, Any]:
    """Return the figures of the module's docstring, and what the plot needs."""
    found = delays(stream, edges, rate)
    n = np.bincount(found.index, minlength=len(edges.t_us))
    run_bits = np.round((edges.until_us - edges.t_us) / bit_us(rate)).astype(int)
    first_us = found.shift_us
    reach_us = WHOLE_BITS * bit_us(rate)
    out: dict[str, Any] = {"transitions": len(n), "contrary": round(found.contrary, 4)}
    onset, mean = {}, {}
    for name, on in (("on", True), ("off", False)):
        mine = edges.on == on
        whole = np.flatnonzero(mine & (run_bits >= WHOLE_BITS) & (n >= 2))
        groups = _by_transition(found, whole, reach_us + first_us)
        all_us = found.delay_us[mine[found.index]]
        whole_us = np.concatenate(groups)
        onset[name] = float(np.median([np.percentile(g, 5) for g in groups]))
        mean[name] = float(np.mean([g.mean() for g in groups]))
        of_bit = _by_transition(found, np.flatnonzero(mine & (n >= 2)), bit_us(rate) + first_us)
        counts, _ = np.histogram(whole_us - first_us, bins=np.linspace(0.0, reach_us, 121))
        out[name] = {
            "transitions": int(mine.sum()),
            "events": [float(q) for q in np.percentile(n[mine], (25, 50, 75))],
            "events_mean": round(float(n[mine].mean()), 1),
            "events_one_bit": float(np.median(n[mine & (run_bits == 1)])),
            "events_whole": float(np.median(n[whole])),
            "width_10_90_us": round(float(np.median([np.ptp(np.percentile(g, (10, 90))) for g in groups])), 1),
            "sd_us": round(math.sqrt(float(np.mean([g.var() for g in groups]))), 1),
            "sd_first_bit_us": round(math.sqrt(float(np.mean([g.var() for g in of_bit]))), 1),
            "sd_clock_us": round(float(all_us.std()), 1),
            "histogram": np.bincount(np.minimum(n[mine], 1200) // 10, minlength=121).tolist(),
            "response_per_us": [float(f"{c:.4g}") for c in counts / len(groups) / (reach_us / 120)],
        }
    out["off_later_us"] = {key: round(d["off"] - d["on"], 1) for key, d in (("mean", mean), ("onset", onset))}
    out["response_bin_us"] = reach_us / 120
    # Where ON begins to be seen: zero of the plot, since the light's own edge is not known of a recording.
    out["response_zero_us"] = round(onset["on"] - first_us, 1)
    return out


def _by_transition(found: Delays, which: npt.NDArray[np.int64], until_us: float) -> list[Floats]:
    """Return each of these transitions' delays (they stand in order of time), as far as until_us."""
    begins = np.searchsorted(found.index, which)
    ends = np.searchsorted(found.index, which, side="right")
    cut = [found.delay_us[a:b] for a, b in zip(begins, ends, strict=True)]
    return [kept for d in cut if len(kept := d[d < until_us]) >= 2]


def rows_of() -> list[tuple[str, str, float, dict[str, float]]]:
    """Return label, sensor, bit rate and changes of the simulated rows."""
    seen = {"pixel.refractory_us": REFRACTORY_SEEN_US}
    return [
        (f"{sensor}{', refractory 80 us' if change else ''}", sensor, rate, change)
        for rate in LINKS
        for sensor in SENSORS
        for change in ({}, seen)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "beacon"
    parser.add_argument("folder", nargs="?", type=Path, default=beside)
    parser.add_argument("-o", type=Path)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--predict", action="store_true", help="only what the laws say")
    arguments = parser.parse_args()
    if arguments.predict:
        told = [
            {"label": label, "bit_rate": rate, **predictions(sensor, LINKS[rate][1], change)}
            for label, sensor, rate, change in rows_of()
        ]
        print(json.dumps(told, indent=1))
        return
    rows: list[dict[str, Any]] = []
    for rate, (file, distance_m) in LINKS.items():
        if (arguments.folder / file).exists():
            stream = recorded(arguments.folder / file)
            rows.append(_row(f"recording, {CITATION}", "recording", rate, distance_m, stream))
    for label, sensor, rate, change in rows_of():
        distance_m = LINKS[rate][1]
        stream = simulated(sensor, rate, distance_m, change)
        rows.append(_row(label, "simulated", rate, distance_m, stream))
        rows[-1]["predicted"] = predictions(sensor, distance_m, change)
    result = {"study": NAME, "citation": CITATION, "measured_before": PUBLISHED_BEFORE, "rows": rows}
    if arguments.o is not None:
        arguments.o.write_text(json.dumps(result) + "\n")
    if arguments.plot is not None:
        plot(result, arguments.plot)


def _row(label: str, evidence: str, rate: float, distance_m: float, stream: Stream) -> dict[str, Any]:
    edges = decided(stream, rate)
    head = {"label": label, "evidence": evidence, "bit_rate": rate, "distance_m": distance_m}
    row = {**head, **(statistics(stream, edges, rate) if len(edges.t_us) else {"transitions": 0})}
    for name in ("on", "off"):
        if name in row:
            told = {k: v for k, v in row[name].items() if k not in {"histogram", "response_per_us"}}
            print(f"{rate:g} bit/s, {label}, {name}: {told}")
    print(f"   contrary {row.get('contrary')}, OFF later by {row.get('off_later_us')}", flush=True)
    return row


def plot(result: dict[str, Any], path: Path) -> None:
    import matplotlib as mpl  # noqa: PLC0415 - not needed without a plot

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(2, 3, figsize=(15, 8), squeeze=False)
    for line, (rate, (_, distance_m)) in zip(axes, LINKS.items(), strict=True):
        for axis, name in zip(line[1:], ("on", "off"), strict=True):
            for row in (r for r in result["rows"] if r["bit_rate"] == rate and name in r):
                style = {"lw": 2.2, "color": "k"} if row["evidence"] == "recording" else {"lw": 1.0}
                bin_us = row["response_bin_us"]
                response = np.array(row[name]["response_per_us"])
                share = response / max(float(response.sum()) * bin_us, 1e-12)
                axis.plot(
                    (np.arange(len(share)) + 0.5) * bin_us - row["response_zero_us"], share, label=row["label"], **style
                )
                color = axis.lines[-1].get_color()
                counts = np.array(row[name]["histogram"], float)
                line[0].step(
                    np.arange(len(counts)) * 10 + 5, counts / counts.sum(), where="mid", color=color,
                    ls="-" if name == "on" else "--", lw=style["lw"], label=f"{row['label']}, {name.upper()}",
                )  # fmt: skip
            axis.set(title=f"{name.upper()}, {rate:g} bit/s, {distance_m:g} m", yscale="log", ylim=(1e-5, 1))
            axis.set(xlabel="time after a twentieth of ON's events (us)", ylabel="share of events a us")
            axis.axvline(1e6 / rate, color="0.7", lw=0.8)
            axis.legend(fontsize=7)
        line[0].set(
            title=f"events a transition, {rate:g} bit/s", xlabel="events (ON solid, OFF dashed)", xscale="log",
            xlim=(8, 1000), ylabel="share of transitions",
        )  # fmt: skip
        line[0].legend(fontsize=6)
    figure.suptitle(f"A change of an LED's light as events: recordings ({CITATION}), presets in an assumed scene")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
