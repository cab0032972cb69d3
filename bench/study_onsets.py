"""The compact input: what the gate leaves of 1 Mev/s, what that costs on a link, and whether tracking misses the rest.

    python bench/study_onsets.py [rates] [bytes] [link] [cost] [mar] [--seeds N] [--first 1000] [--seconds 2]

Scenes (`bench/scenes/onsets_*.toml`, DVXplorer Mini in VARIABLE_15000 and IMX636): 20 moving beacons of 1 to 5 kbit/s,
at least .35 Mev/s of noise and as much of moving texture. Evidence: simulated.

    rates   events/s by origin: each simulated alone, and all together
    bytes   entries and bytes of columns, by origin, gate open and active, without and with the limit of the rate
    link    the onsets of one run at real time over a TCP link of Zenoh, shared memory off, bytes counted by a proxy
            both ways: the worst second, for messages of 5, 10 and 20 ms; limited
    cost    processor time of gating beside the open gate, in the same run: noise of 1 and 5 Mev/s and the scenes
    mar     MAR_sent (visible, K = 1) with the gate open, and active and limited, on the same events: paired difference
            per block of beacon x second x run. The beacons' payloads are fixed, since a site of four bit rates
            attributes a frame only once an identity is accepted; both arms have the same decoder.

The limit of the rate is that of deploy/sites/onboard.toml.

Results are added to bench/results/onsets.json, part by part.
"""

from __future__ import annotations

import argparse
import json
import re
import sqlite3
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from heliograph.events import EventBatch
from heliograph.messages import Message
from heliograph.onsets import OnsetCounter, OnsetSettings
from heliograph.onsets import warm as warm_onsets
from heliograph.shares import difference, share
from heliograph.shell.bus import connected
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.site import BusLinks, load_site
from heliograph.streams import Onsets
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.cli.studies.radio import Proxy
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.cameras import open_camera
from heliograph_services.event_source.cameras.contract import Window
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.core import CameraInfo, SourceCore
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.service import MetricsSink
from heliograph_services.tracker.config import TrackerConfig
from support.processes import Host, free_port

RESULT: Final = Path(__file__).parent / "results" / "onsets.json"
SCENES: Final = ("onsets_dvxplorer_mini", "onsets_imx636")
PARTS: Final = ("rates", "bytes", "link", "cost", "mar")
WINDOW_US: Final = 10_000
SAMPLE_S: Final = 0.02
# What the site with a radio gives them.
ONBOARD: Final = Path(__file__).parents[1] / "deploy" / "sites" / "onboard.toml"
_SOURCE: Final = load_site(ONBOARD).entry("event_source", "event_source").settings
TICK: Final = {"tick_us": _SOURCE["tick_us"]}
BUDGET: Final = {"onsets_bit_rate_max": _SOURCE["onsets_bit_rate_max"]}


def scene(name: str) -> str:
    """Return the text of a scene."""
    return (Path(__file__).parent / "scenes" / f"{name}.toml").read_text(encoding="utf-8")


def origins(text: str) -> dict[str, str]:
    """Return the scene, and what each of its origins makes alone."""
    silence = '{ "pixel.shot_noise_hz" = 0.0, "pixel.leak_hz" = 0.0, "pixel.hot_pixels" = 0.0 }'
    quiet = re.sub(r"override = \{.*?\}", f"override = {silence}", text)

    def plain(scenario: str) -> str:
        return re.sub(r'texture = "\w+"', 'texture = "plain"', scenario)

    def dark(scenario: str) -> str:
        return scenario.split("[[crowd]]", maxsplit=1)[0]

    return {"all": text, "noise": plain(dark(text)), "texture": dark(quiet), "beacons": plain(quiet)}


def windows(text: str, seed: int, seconds: float) -> Iterator[tuple[CameraInfo, Window]]:
    """Yield the windows of a scene."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text, encoding="utf-8")
        config = EventSourceConfig(
            backend="simulated", scenario=str(path), seed=seed, duration_s=seconds, fidelity="live", window_us=WINDOW_US
        )
        camera = open_camera(config, ONE_PROCESS)
        try:
            for window in camera.windows():
                yield CameraInfo(camera.width, camera.height), window
        finally:
            camera.close()


def source(info: CameraInfo, **settings: Any) -> SourceCore:
    """Return the source's core; a window of any number of events is one record."""
    return SourceCore(EventSourceConfig(max_events=1_000_000, window_us=WINDOW_US, **TICK, **settings), info)


def worst_second(sizes: list[int], message_us: int) -> int:
    """Return the most bytes of any second of messages."""
    n = 1_000_000 // message_us
    total = np.concatenate([[0], np.cumsum(sizes)])
    return int((total[n:] - total[:-n]).max()) if len(sizes) >= n else int(total[-1])


# ---- the parts -------------------------------------------------------------------------------------------------------


def rates(name: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return events/s by origin."""
    return {
        origin: round(sum(len(window.batch) for _, window in windows(text, seed, seconds)) / seconds)
        for origin, text in origins(scene(name)).items()
    }


def sizes_of(name: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return entries and bytes by origin and gate."""
    arms: dict[str, dict[str, Any]] = {
        "open": {"gate": "open"},
        "two events": {"onsets_noise_hz": 0.0},
        "active": {},
        "limited": BUDGET,
    }
    rows: dict[str, Any] = {}
    for origin, text in origins(scene(name)).items():
        cores: dict[str, SourceCore] = {}
        sizes: dict[str, list[int]] = {arm: [] for arm in arms}
        for info, window in windows(text, seed, seconds):
            for arm, settings in arms.items():
                core = cores.setdefault(arm, source(info, **settings))
                made = [m for m in core.feed(window) if isinstance(m, Onsets)]
                sizes[arm] += [len(m.to_body()["columns"]) for m in made]
        for arm, core in cores.items():
            rows[f"{origin}, {arm}"] = {
                "entries_s": round(core.counters["onsets"] / seconds),
                "columns_bytes_s": round(sum(sizes[arm]) / seconds),
                "columns_bytes_worst_s": worst_second(sizes[arm], 10_000),
                "thinned_edges_s": round(core.counters["onsets_thinned_edges"] / seconds),
                "thinned_lights_s": round(core.counters["onsets_thinned_lights"] / seconds),
            }
    return rows


def link(name: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return bytes/s of the link, by the length of a message."""
    rows: dict[str, Any] = {}
    cores: dict[int, SourceCore] = {}
    made: dict[int, list[Onsets]] = {5_000: [], 10_000: [], 20_000: []}
    for info, window in windows(scene(name), seed, seconds):
        for message_us, messages in made.items():
            core = cores.setdefault(message_us, source(info, onsets_us=message_us, **BUDGET))
            messages += [m for m in core.feed(window) if isinstance(m, Onsets)]
    for message_us, messages in made.items():
        columns = [len(m.zipped[1]) if m.zipped else 0 for m in messages]
        rows[f"{message_us // 1000} ms"] = carried(messages) | {
            "columns_bytes_worst_s": worst_second(columns, message_us),
            "thinned_edges_s": round(cores[message_us].counters["onsets_thinned_edges"] / seconds),
            "thinned_lights_s": round(cores[message_us].counters["onsets_thinned_lights"] / seconds),
            "entries_s": round(cores[message_us].counters["onsets"] / seconds),
        }
    return rows


def carried(messages: list[Onsets]) -> dict[str, Any]:
    """Publish the messages at real time through a router and a counting proxy; return what crossed."""
    with tempfile.TemporaryDirectory() as folder:
        port = free_port()
        text = f'[router]\nlisten = ["tcp/127.0.0.1:{port}"]\n'
        text = f'site = "s"\n[bus]\nconnect = ["tcp/127.0.0.1:{port}"]\nshared_memory = false\n{text}'
        router, proxy = Host(Path(folder), "host", text, []), Proxy(port)
        links = [BusLinks(connect=(f"tcp/127.0.0.1:{p}",), shared_memory=False) for p in (proxy.port, port)]
        try:
            with (
                connected(client_config(links[0]), "s", "event_source/0", Stop()) as sender,
                connected(client_config(links[1]), "s", "tracker/0", Stop()) as reader,
            ):
                assert sender is not None
                assert reader is not None
                inbox = reader.subscribe({"onsets": Onsets})
                time.sleep(1.0)
                return played(messages, sender, proxy) | {"received": received(inbox, len(messages))}
        finally:
            router.close()
            proxy.close()


def played(messages: list[Onsets], sender: Any, proxy: Proxy) -> dict[str, Any]:
    """Publish in time; return the bytes of all and of the worst second."""
    samples: list[tuple[float, int]] = []
    done = threading.Event()

    def sample() -> None:
        while not done.wait(SAMPLE_S):
            samples.append((time.monotonic(), proxy.bytes_passed))

    sampler = threading.Thread(target=sample)
    sampler.start()
    begin_s, begin_us, before = time.monotonic(), messages[0].t0_us, proxy.bytes_passed
    late_s = 0.0
    for message in messages:
        due_s = begin_s + (message.t1_us - begin_us) / 1e6
        late_s = max(late_s, time.monotonic() - due_s)
        time.sleep(max(0.0, due_s - time.monotonic()))
        sender.publish(message)
    time.sleep(0.5)
    done.set()
    sampler.join()
    seconds = (messages[-1].t1_us - begin_us) / 1e6
    times, passed = (np.array(column, float) for column in zip(*samples, strict=True))
    after = np.interp(times + 1.0, times, passed)
    return {
        "link_bytes_s": round((proxy.bytes_passed - before) / seconds),
        "link_bytes_worst_s": round(float((after - passed)[times + 1.0 <= times[-1]].max())),
        "messages": len(messages),
        "late_ms": round(1e3 * late_s, 1),
    }


def received(inbox: Any, wanted: int) -> int:
    """Return how many messages came."""
    n = 0
    while n < wanted and inbox.get(1.0) is not None:
        n += 1
    return n


def noise(width: int, height: int, rate_hz: float, seed: int) -> EventBatch:
    """Return a second of noise."""
    rng = np.random.default_rng(seed)
    n = int(rate_hz)
    t_us, on = np.sort(rng.integers(0, 1_000_000, n)), rng.random(n) < 0.5
    x_px, y_px = rng.integers(0, width, n), rng.integers(0, height, n)
    return EventBatch(t_us, x_px.astype(np.uint16), y_px.astype(np.uint16), on)


def cost(name: str, seed: int, runs: int = 5) -> dict[str, Any]:
    """Return shares of a core: the median of some runs, arms in turns."""
    seen = list(windows(scene(name), seed, 1.0))
    info = seen[0][0]
    cut = {name: [window.batch for _, window in seen]}
    for rate_hz in (1e6, 5e6):
        whole = noise(info.width, info.height, rate_hz, seed)
        edges = np.searchsorted(whole.t_us, np.arange(0, 1_000_001, WINDOW_US)).tolist()
        cut[f"noise {rate_hz / 1e6:g} Mev/s"] = [whole.part(a, b) for a, b in pairwise(edges)]
    arms: dict[str, dict[str, Any]] = {"open": {"gate": "open"}, "active": {}}
    rows: dict[str, Any] = {}
    for what, parts in cut.items():
        took: dict[str, list[float]] = {arm: [] for arm in (*arms, "source")}
        for _ in range(runs):
            for arm, settings in arms.items():
                counter = OnsetCounter(OnsetSettings(info.width, info.height, 5_000, **settings))
                start = time.thread_time()
                for i, part in enumerate(parts):
                    counter.count(part, i * WINDOW_US, (i + 1) * WINDOW_US)
                took[arm].append(time.thread_time() - start)
            took["source"].append(whole_source(info, parts))
        names = {"open": "open_core", "active": "active_core", "source": "active_with_limit_and_zlib_core"}
        rows[what] = {names[arm]: round(float(np.median(values)), 3) for arm, values in took.items()}
        rows[what]["events"] = sum(map(len, parts))
    return rows


def whole_source(info: CameraInfo, parts: list[EventBatch]) -> float:
    """Return the processor time of all that a source does for onsets: gate, limit, zlib."""
    core = source(info, **BUDGET)
    start = time.thread_time()
    for i, part in enumerate(parts):
        core.feed(Window(i * WINDOW_US, (i + 1) * WINDOW_US, part, "bench"))
    return time.thread_time() - start


KINDS: Final = ("right", "wrong", "insertions")


class Arm:
    """One gate: a source, a tracker, a decoder, a sink."""

    def __init__(self, gate: str, info: CameraInfo, decoder: dict[str, Any], folder: Path) -> None:
        from heliograph_services.decoder.__main__ import SERVICE as DECODER  # noqa: PLC0415 - compiles on import
        from heliograph_services.tracker.core import make_core  # noqa: PLC0415

        self._file = folder / f"{gate}.sqlite"
        self._source = source(info, gate=gate, **(BUDGET if gate == "active" else {}))
        config = msgspec.convert(decoder, DecoderConfig, strict=False)
        self._pipeline = Pipeline(make_core(TrackerConfig(), ONE_PROCESS), DECODER.make(config, ONE_PROCESS))
        self._sink = MetricsSink(MetricsSinkConfig(file=str(self._file)), ONE_PROCESS)

    def feed(self, window: Window) -> None:
        """Take a window."""
        messages = self._source.feed(window)
        truths: list[Message] = [window.truth] if window.truth is not None else []
        for message in [*truths, *self._pipeline.feed(messages)]:
            self._sink.feed(message)

    def counts(self) -> dict[tuple[str, int], int]:
        """Return the sink's counts by name and second."""
        self._sink.close()
        with sqlite3.connect(self._file) as connection:
            rows = connection.execute("SELECT text, second, n FROM count JOIN name ON name.id = count.name").fetchall()
        connection.close()
        return {(name, second): n for name, second, n in rows}


def paired(name: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return the blocks of one run: beacon, second, sent, right with the gate open, right with it active."""
    arms: dict[str, Arm] = {}
    with tempfile.TemporaryDirectory() as folder:
        listed = site_beacons(load_scenario(str(Path(__file__).parent / "scenes" / f"{name}.toml")))
        decoder = {"beacons": msgspec.to_builtins(listed)}
        for info, window in windows(scene(name), seed, seconds):
            for gate in ("open", "active"):
                if gate not in arms:
                    arms[gate] = Arm(gate, info, decoder, Path(folder))
                arms[gate].feed(window)
        counts = {gate: arm.counts() for gate, arm in arms.items()}
    sent = {key: n for key, n in counts["open"].items() if key[0].startswith("sent_visible/")}
    blocks = []
    for (text, second), n in sorted(sent.items()):
        beacon = text.partition("/")[2]
        right = [counts[gate].get((f"right_visible/{beacon}", second), 0) for gate in ("open", "active")]
        blocks.append([beacon, second, n, *right])
    wrong = {
        gate: {kind: sum(n for (text, _), n in found.items() if text.partition("/")[0] == kind) for kind in KINDS}
        for gate, found in counts.items()
    }
    return {"seed": seed, "blocks": blocks, "published": wrong}


def judged(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return MAR of both arms and their paired difference over all runs."""
    blocks = np.array([block[2:] for run in runs for block in run["blocks"]], float)
    sent, opened, active = blocks.T
    told = {kind: {g: sum(run["published"][g][kind] for run in runs) for g in ("open", "active")} for kind in KINDS}
    return {
        "seeds": [run["seed"] for run in runs],
        "blocks": len(blocks),
        "open": share(opened, sent).row(),
        "active": share(active, sent).row(),
        "active_minus_open": difference(active, opened, sent).row(),
        "published": told,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=PARTS)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("-o", type=Path, default=RESULT)
    arguments = parser.parse_args()
    warm_onsets()
    alone = {"rates": rates, "bytes": sizes_of, "link": link}
    for part in arguments.parts:
        for name in arguments.scenes:
            if part == "mar":
                runs = []
                for seed in range(arguments.first, arguments.first + arguments.seeds):
                    runs.append(paired(name, seed, arguments.seconds))
                    keep(arguments.o, part, name, judged(runs) | {"seconds": arguments.seconds})
            elif part == "cost":
                keep(arguments.o, part, name, cost(name, arguments.first))
            else:
                row = alone[part](name, arguments.first, arguments.seconds)
                keep(arguments.o, part, name, {"seed": arguments.first, "seconds": arguments.seconds, **row})


def keep(path: Path, part: str, name: str, row: dict[str, Any]) -> None:
    """Print a row and add it to the results."""
    print(part, name, json.dumps(row), flush=True)
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    found.setdefault("evidence", "simulated")
    found.setdefault(part, {})[name] = row
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
