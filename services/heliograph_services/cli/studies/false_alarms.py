"""Study 7: who is named where nobody is, and who is named for another: false alarms and confusions.

Parts; each is one or more cells:

- `scene`: the recorded flicker of a room without a beacon (HELIOGRAPH_SCENE_DATA names its folder), through source,
  tracker and every reader's decoder; and, as the tracker finds no candidate there, squares of 32 and 96 px of it, each
  as though it were a track.
- `clutter`: the scenario of that name, pixel by pixel: what the decoder hears of each track (`heard`), read by every
  reader; at most 20,000 bits of each track.
- `lights`: lights of the same kinds at the level of a track's events (`false_lights`), fresh parameters each. A camera
  has 32; HOURS of it for each protocol, shared over its bit rates so that each hears as many bits.
- `clocked`: random bits at each reader's own clock.
- `strangers`: beacons of every protocol, read by all other protocols at their bit rate and those about it, and by
  `auto`, which must say nothing but what is sent.
- `repeaters`: lights that repeat themselves in step with a word of the cyclic codes (`repeaters`).
- `crowd`: a hundred beacons, through the whole system, named right or not; and what tracks of a crowd say to the
  readers of other protocols.

A reader is a protocol at a bit rate, or `auto` for one or both, as a site without listed beacons has it; `frequency`,
which is read only where listed, listens for one frequency. Lamps within 1 % of that are left out there: by the nature
of the protocol they are that beacon. Told are identities and texts. Nothing is tuned on these runs. The hours are what
a full run's time allows: nothing found in T bounds a rate at 3 / T with 95 %, and every row says its T.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from heliograph.link.bitrate import likely_bit_rates
from heliograph_services.cli.studies.false_alarm_tables import panels, tables
from heliograph_services.cli.studies.false_lights import CAMERA, LIGHTS, Seen, beacon, light, watched
from heliograph_services.cli.studies.false_scenes import (
    clutter,
    crowd,
    crowd_heard,
    is_recorded,
    scene_regions,
    scene_whole,
)
from heliograph_services.cli.studies.heard import Signal, listen
from heliograph_services.cli.studies.repeaters import repeaters_row
from heliograph_services.cli.studies.study import Cell, Counts, Parameters, Size, Study
from heliograph_services.decoder.config import AUTO, DecoderConfig
from heliograph_services.decoder.link_plan import LinkPlan
from heliograph_services.decoder.routing import HEART_OF

# Camera-hours a protocol: of a long run they bound a rate at one an hour. Then, of both: minutes a protocol and bit
# rate; camera seconds and chunks of the other parts.
HOURS = {"full": 0.1, "long": 3.0}
MINUTES = 1.0
CLUTTER_CHUNKS = 1
STRANGERS_CHUNKS = 1
CROWD_S = 30.0
RATES: tuple[float, ...] = (50, 100, 250, 500, 1000, 2000, 2500, 3125, 5000, 10_000, 20_000)
# 130 Hz to 10 kHz, twice; none near the mains' harmonics.
BLINK_RATES: tuple[float, ...] = (260, 500, 900, 2500, 3000, 5000, 10_000, 16_400, 20_000)
REPEATED_RATES: tuple[float, ...] = (100, 500, 1000, 2000, 2500, 5000, 10_000)
FAST: dict[str, tuple[float, ...]] = {"ook_fast": (30_000, 60_000), "event_interval": (30_000, 100_000)}
PROTOCOLS = ("seed11", "code", "uart", "pulse_interval", "frequency", "event_interval", "packet", "ook_fast")
BITS_MOST = 20_000
LAMP_SHARE = 0.01
Reader = tuple[str, float | str]


def rates_of(protocol: str) -> tuple[float, ...]:
    """Return the bit rates at which a protocol is tried."""
    return BLINK_RATES if protocol == "frequency" else RATES + FAST.get(protocol, ())


def readers() -> list[Reader]:
    """Return all readers: each protocol at each rate and with its rate measured, and `auto` likewise."""
    named: list[Reader] = [(protocol, rate) for protocol in PROTOCOLS for rate in rates_of(protocol)]
    measured: list[Reader] = [(protocol, AUTO) for protocol in PROTOCOLS if protocol != "frequency"]
    return [*named, *measured, *((AUTO, rate) for rate in (500.0, 1000.0, 5000.0)), (AUTO, AUTO)]


def config(reader: Reader) -> DecoderConfig:
    """Return the decoder's settings of a reader."""
    protocol, rate = reader
    return DecoderConfig(protocol=protocol, bit_rate=rate)  # type: ignore[arg-type]  # a number or "auto"


def plan(reader: Reader) -> LinkPlan:
    """Return the links of a reader."""
    return LinkPlan(config(reader), measure=likely_bit_rates if reader[1] == AUTO else None)


def name_of(reader: Reader) -> str:
    """Return PROTOCOL@RATE."""
    return f"{reader[0]}@{reader[1] if isinstance(reader[1], str) else f'{reader[1]:g}'}"


def signal_of(seen: Seen) -> Signal:
    """Return a light's events as a track's signal, all in the heart of its image."""
    depth = np.full(len(seen.t_us), HEART_OF, np.uint8)
    return Signal(seen.t_us, seen.on, depth, 0, seen.until_us)


def is_listed_lamp(label: str, reader: Reader) -> bool:
    """Return whether a lamp or a beacon blinks at the frequency that `frequency` listens for."""
    if reader[0] != "frequency" or isinstance(reader[1], str):
        return False
    numbers = [float(word.rstrip(",")) for word in label.split() if word.rstrip(",").replace(".", "").isdigit()]
    return any(abs(number - reader[1] / 2.0) <= LAMP_SHARE * number for number in numbers if number >= 50.0)


def told_by(reader: Reader, signals: list[tuple[str, Signal]]) -> dict[str, Any]:
    """Return the seconds that a reader heard, and what it told of whom."""
    links = plan(reader)
    heard_s, told, frames = 0.0, [], 0
    for label, signal in signals:
        if is_listed_lamp(label, reader):
            continue
        said = listen(links, signal)
        heard_s += signal.seconds
        frames += said.frames
        if said.identities or said.text:
            told.append({"light": label, "identities": said.identities, "text": said.text[:80]})
    return {"heard_s": round(heard_s, 3), "candidates": len(signals), "frames": frames, "told": told}


def cut(signal: Signal, reader: Reader) -> Signal:
    """Return as much of a signal's beginning as holds BITS_MOST bits."""
    rate = reader[1]
    until_us = signal.until_us if isinstance(rate, str) else signal.from_us + int(BITS_MOST / rate * 1e6)
    if until_us >= signal.until_us:
        return signal
    n = int(np.searchsorted(signal.t_us, until_us))
    return Signal(signal.t_us[:n], signal.on[:n], signal.depth[:n], signal.from_us, until_us)


def by_reader(signals: list[tuple[str, Signal]], who: list[Reader]) -> dict[str, Any]:
    """Return what each reader told of the signals."""
    rows = {}
    for reader in who:
        began = time.process_time()
        row = told_by(reader, [(label, cut(signal, reader)) for label, signal in signals])
        rows[name_of(reader)] = row | {"cpu_s": round(time.process_time() - began, 2)}
    return rows


def lights_row(cell: dict[str, Any], seed: int) -> dict[str, Any]:
    """One camera's lights, heard by one reader."""
    reader: Reader = (cell["protocol"], cell["rate"])
    rng = np.random.default_rng(seed)
    rate = 1000.0 if isinstance(reader[1], str) else float(reader[1])
    kinds = ["bits"] * CAMERA if cell["part"] == "clocked" else [kind for kind, n in LIGHTS.items() for _ in range(n)]
    if cell["part"] == "clocked":
        seen = [_clocked(rate, cell["seconds"], rng)]
    else:
        seen = [light(kind, rate, cell["seconds"], rng) for kind in kinds]
    return told_by(reader, [(one.label, signal_of(one)) for one in seen])


def _clocked(rate: float, seconds: float, rng: np.random.Generator) -> Seen:
    from heliograph.link.contract import edges_of  # noqa: PLC0415

    clock = rate * rng.uniform(0.998, 1.002)
    bits = (rng.random(int(seconds * clock)) < rng.choice([0.3, 0.5, 0.5, 0.7])).astype(np.int64)
    return watched("bits at the listener's rate", edges_of(bits, 0.0, 1e6 / clock), seconds, rng)


def strangers_row(cell: dict[str, Any], seed: int) -> dict[str, Any]:
    """A beacon of one protocol, read by all others at its bit rate and those about it, and by auto."""
    speaker, rate = cell["speaker"], float(cell["rate"])
    rng = np.random.default_rng(seed)
    signals = []
    for _ in range(cell["beacons"]):
        label, edges = beacon(speaker, rate, cell["seconds"], rng)
        signals.append((label, signal_of(watched(label, edges, cell["seconds"], rng))))
    who: list[Reader] = []
    for protocol in PROTOCOLS:
        near = {r for r in rates_of(protocol) if rate / 5.0 <= r <= rate * 5.0}
        near |= {rate * share for share in (0.5, 1.0, 2.0)} if protocol != "frequency" else set()
        who += [(protocol, r) for r in sorted(near) if protocol != speaker and r <= 100_000.0]
    if speaker == "frequency":
        return by_reader(signals, who)
    rows = by_reader(signals, [*who, (AUTO, rate), (AUTO, AUTO)])
    for name in (f"auto@{rate:g}", "auto@auto"):
        right = [one for one in rows[name]["told"] if _only(one, speaker)]
        rows[name]["right"] = len(right)
        rows[name]["told"] = [one for one in rows[name]["told"] if one not in right]
    return rows


def _only(told: dict[str, Any], speaker: str) -> bool:
    """Return whether all that was told is the beacon's own protocol and, where it has one, its payload."""
    payload = told["light"].split()[1] if " " in told["light"] else None
    wanted = [f"{speaker}:{payload}"] if payload else [f"{speaker}:"]
    return all(any(one.startswith(want) for want in wanted) for one in told["identities"])


def cells(size: Size) -> list[Parameters]:
    """Return all cells; those of the recorded scene where it is at hand."""
    if size == "quick":
        return [
            {"part": "strangers", "speaker": "code", "rate": 1000, "seconds": 1.0, "beacons": 1, "chunk": 0},
            {"part": "lights", "protocol": "seed11", "rate": 1000, "seconds": 2.0, "chunk": 0},
        ]
    hours = HOURS[size]
    return [cell for part in PARTS if part != "scene" or is_recorded() for cell in cells_of(part, hours)]


PARTS = ("scene", "clutter", "lights", "clocked", "strangers", "repeaters", "crowd")


def cells_of(part: str, hours: float) -> Iterator[Parameters]:
    """Yield the cells of a part; of `lights`, so many camera-hours a protocol."""
    if part == "scene":
        yield {"part": part}
        yield from ({"part": part, "side_px": side} for side in (32, 96))
    elif part == "clutter":
        yield from ({"part": part, "chunk": i, "seconds": 3.0} for i in range(CLUTTER_CHUNKS))
    elif part == "lights":
        for protocol in [*PROTOCOLS, AUTO]:
            yield from _shared(part, protocol, hours if protocol != AUTO else hours / 100.0)
    elif part == "clocked":
        yield from _clocked_cells(part, MINUTES * 60.0)
    elif part == "strangers":
        spoken = dict.fromkeys(PROTOCOLS, (250, 1000, 5000)) | {"frequency": BLINK_RATES[1::3]}
        for i, (speaker, rates) in product(range(STRANGERS_CHUNKS), spoken.items()):
            for rate in rates:
                yield {"part": part, "speaker": speaker, "rate": rate, "seconds": 2.0, "beacons": 3, "chunk": i}
    elif part == "repeaters":
        repeated: tuple[float | str, ...] = (*REPEATED_RATES, AUTO)
        for protocol, read_at in product(("seed11", "code"), repeated):
            yield {"part": part, "protocol": protocol, "rate": read_at, "lights": 250, "chunk": 0}
    elif part == "crowd":
        yield {"part": part, "chunk": 0, "seconds": CROWD_S}
        yield {"part": "crowd heard", "chunk": 0, "seconds": 1.0}


def _clocked_cells(part: str, wanted_s: float) -> Iterator[Parameters]:
    for protocol in PROTOCOLS:
        for rate in rates_of(protocol):
            seconds = min(60.0, 120_000.0 / rate, wanted_s)
            for i in range(int(np.ceil(wanted_s / seconds - 1e-9))):
                yield {"part": part, "protocol": protocol, "rate": rate, "seconds": seconds, "chunk": i}


def _shared(part: str, protocol: str, hours: float) -> Iterator[Parameters]:
    """Share the hours of a camera over the rates, as many bits each."""
    rates: tuple[float | str, ...] = rates_of(protocol) if protocol != AUTO else (1000.0, AUTO)
    weights = np.array([1.0 / rate if not isinstance(rate, str) else 1e-3 for rate in rates])
    for rate, weight in zip(rates, weights / weights.sum(), strict=True):
        seconds = 6.0 if isinstance(rate, str) else float(np.clip(6000.0 / rate, 5.0, 60.0))
        for i in range(int(np.ceil(hours * 3600.0 * weight / seconds))):
            yield {"part": part, "protocol": protocol, "rate": rate, "seconds": seconds, "chunk": i}


def run(one: Cell) -> Counts:
    """Run a cell."""
    cell, seed = one.parameters, one.seed
    part = cell["part"]
    if part == "scene":
        if "side_px" not in cell:
            return scene_whole({name_of(reader): config(reader) for reader in readers()})
        return {"readers": by_reader(scene_regions(cell["side_px"]), readers())}
    if part == "clutter":
        return {"readers": by_reader(clutter(cell["seconds"], seed), readers())}
    if part == "crowd":
        return crowd(cell["seconds"], seed)
    if part == "crowd heard":
        near: list[Reader] = [reader for reader in readers() if reader[0] not in {"code", AUTO}]
        return {"readers": by_reader(crowd_heard(cell["seconds"], seed), near)}
    if part == "strangers":
        return {"readers": strangers_row(cell, seed)}
    if part == "repeaters":
        rate = None if cell["rate"] == AUTO else cell["rate"]
        return repeaters_row(plan((cell["protocol"], cell["rate"])), cell["protocol"], rate, cell["lights"], seed)
    return lights_row(cell, seed)


STUDY = Study(
    name="false_alarms",
    version=2,
    title="False alarms and confusions",
    about=(
        "Everything that blinks and is no beacon: a recorded room, clutter pixel by pixel and at the level of tracks,"
        " random bits at the reader's own clock; beacons of other protocols; a crowd. Told are identities and texts. A"
        " bound is what nothing found excludes with 95 %: 3 / T."
    ),
    preset="dvxplorer_mini (VARIABLE_5000); lights of tracks: scans of 65 and 199 us and none",
    evidence="simulated",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
)
