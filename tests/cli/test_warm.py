"""Warming leaves nothing to compile: a kernel that compiles at first use stalls a live decoder, which then drops."""

from __future__ import annotations

import json
import subprocess
import sys

SCRIPT = """
import gc, json
from numba.core.dispatcher import Dispatcher
from heliograph_services.cli import warm
from heliograph_services.cli.pipeline import ONE_PROCESS, Pipeline
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.decoder.core import make_core as make_decoder
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.event_source.simulation.world.load import load_scenario, site_beacons
from heliograph_services.event_source.stream import open_stream
from heliograph_services.tracker.config import TrackerConfig
from heliograph_services.tracker.core import make_core as make_tracker

def kernels():
    found = (each for each in gc.get_objects() if isinstance(each, Dispatcher))
    return {f"{each.py_func.__module__}.{each.py_func.__name__}": len(each.signatures) for each in found}

warm.main()
warmed = kernels()
beacons = tuple(site_beacons(load_scenario("five")))
pipeline = Pipeline(
    make_tracker(TrackerConfig(), ONE_PROCESS), make_decoder(DecoderConfig(beacons=beacons), ONE_PROCESS)
)
published = []
for scenario, seconds in (("five", 1.5), ("construction_site", 0.1), ("night", 0.1), ("crowd", 0.1)):
    settings = EventSourceConfig(backend="simulated", scenario=scenario, duration_s=seconds, image_hz=20.0)
    for step in open_stream(settings, ONE_PROCESS):
        # As between processes: arrays off the wire are read-only, for which numba would compile a kernel of its own.
        sent = [type(message).from_body(message.to_body()) for message in step.messages]
        published += pipeline.feed(sent)
used = kernels()
late = sorted(name for name in used if used[name] != warmed.get(name))
print(json.dumps([sorted({m.beacon for m in published if m.SCHEMA == "ids"}), late, len(warmed)]))
"""


def test_a_scene_of_every_protocol_compiles_nothing_after_warming() -> None:
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=110)
    identified, compiled_late, known = json.loads(run.stdout.splitlines()[-1])
    assert identified == ["crane", "gate", "lift", "mixer", "truck"]
    assert compiled_late == []
    assert known > 10


AGAIN = """
import json
from numba.core import event
from heliograph_services.cli import warm

compiled = []

class Noted(event.Listener):
    def on_start(self, told):
        compiled.append(told.data["dispatcher"].py_func)

    def on_end(self, told):
        pass

event.register("numba:compile", Noted())
warm.main()
print(json.dumps([f"{f.__module__}.{f.__name__}" for f in compiled if f.__module__.startswith("heliograph")]))
"""


def test_a_second_start_compiles_nothing() -> None:
    # Kernels that Python calls are kept on disk, whatever they call in turn is within them: one that is not is compiled
    # by every process that starts (ten seconds of a core, once).
    first, second = (
        subprocess.run([sys.executable, "-c", AGAIN], capture_output=True, text=True, check=True, timeout=110)
        for _ in range(2)
    )
    assert json.loads(second.stdout.splitlines()[-1]) == [], first.stdout
