"""Warming compiles all that a receiver of packets uses: one that compiles at first use stalls a live decoder."""

from __future__ import annotations

import json
import subprocess
import sys

SCRIPT = """
import gc, json, sys
sys.path.insert(0, "tests")
from numba.core.dispatcher import Dispatcher
from heliograph.link import packet_receiver
from heliograph.link.modulations.packet import Packet
from support.lights import Light, seen
from support.text_light import Watched, hear

def kernels():
    found = (each for each in gc.get_objects() if isinstance(each, Dispatcher))
    return {f"{each.py_func.__module__}.{each.py_func.__name__}": len(each.signatures) for each in found}

packet_receiver.warm()
warmed = kernels()
said = 0
for light in (Light(), Light(events=6.0), Light(tail_us=200.0, events=60.0), Light(noise_hz=5000.0)):
    for kind in (Packet(), Packet(block=8, rate="1/2")):
        what = seen(light, [*kind.message("hello, world", 3), *(0,) * 150, *kind.message("!", 3, 1), 0], 5000.0, 1)
        said += len(hear(kind.receiver(5000.0), Watched(what.t_us, what.on, what.until_us)))
used = kernels()
print(json.dumps([said, sorted(name for name in used if used[name] != warmed.get(name))]))
"""


def test_packets_of_every_kind_of_light_compile_nothing_after_warming() -> None:
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=110)
    said, compiled_late = json.loads(run.stdout.splitlines()[-1])
    assert said >= 30
    assert compiled_late == []
