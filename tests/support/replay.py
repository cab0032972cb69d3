"""A recording in lockstep: through real processes, and through the same cores in one."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from support.processes import Collector, Host, collecting

SERVICES = ["tracker", "decoder", "metrics_sink", "event_source"]
WANTED = ["frames", "ids", "messages", "progress"]


def site(port: int, source: str, decoder: str, beacons: str = "") -> str:
    """Return a lockstep site file; `source` and `decoder` are lines of their services' settings."""
    return f"""
site = "replay"
lockstep = true
[bus]
connect = ["tcp/127.0.0.1:{port}"]
[router]
listen = ["tcp/127.0.0.1:{port}"]
[[service]]
kind = "event_source"
{source}
window_us = 10000
wait_for = ["tracker", "decoder"]
[[service]]
kind = "tracker"
[[service]]
kind = "decoder"
{decoder}
[[service]]
kind = "metrics_sink"
file = "metrics-{port}.sqlite"
{beacons}
"""


def recording(file: Path) -> str:
    """Return the settings of a source that plays a file."""
    return f'backend = "recording"\nfile = "{file}"'


def through_processes(
    folder: Path,
    text: str,
    port: int,
    order: list[str],
    beside: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
) -> dict[str, list[bytes]]:
    """Return what the processes publish, by schema and track; `beside` goes on meanwhile."""
    host = Host(folder, f"site{port}", text, [])
    try:
        with collecting(port, "replay", WANTED) as heard, beside():
            for kind in order:
                host.start(kind)
            heard.until(decoder_is_done, "the decoder to finish", 110)
            assert host.wait("event_source") == 0, host.log("event_source")
        statuses = host.close()
        assert statuses == dict.fromkeys(statuses, 0), "\n".join(host.log(kind) for kind in statuses)
        return heard.bodies("frames", "ids", "messages")
    finally:
        host.close()


def decoder_is_done(heard: Collector) -> bool:
    """Return whether all that the decoder has to say has arrived."""
    done = [m for m in heard.messages["progress"] if getattr(m, "service", "") == "decoder" and getattr(m, "done", 0)]
    # What the decoder published before its last word may still be on the way: it has another priority.
    return bool(done) and any(getattr(m, "lost", False) for m in heard.messages["ids"])


def in_one_process(config_site: Path) -> dict[str, list[bytes]]:
    """Return what the pipeline publishes for a site's recording, by schema and track."""
    script = """
import sys, json
from heliograph_services.cli.decode import build, parser
from heliograph.wire import pack_body
from heliograph.shell.site import load_site
site = load_site(sys.argv[1])
file = next(e.settings["file"] for e in site.service if e.kind == "event_source")
stream, pipeline, cores = build(parser().parse_args([file, "--site", sys.argv[1]]))
found = {}
for step in stream:
    for message in pipeline.feed(step.messages):
        if message.SCHEMA in ("frames", "ids", "messages"):
            track = getattr(message, "track", "")
            name = f"{message.SCHEMA}/{track if isinstance(track, str) else ''}"
            found.setdefault(name, []).append(pack_body(message).hex())
print(json.dumps(found))
"""
    command = [sys.executable, "-c", script, str(config_site)]
    out = subprocess.run(command, check=True, capture_output=True, text=True, timeout=110).stdout
    return {name: [bytes.fromhex(body) for body in bodies] for name, bodies in json.loads(out).items()}
