"""The demo: all services as separate processes on this machine, and a client that prints who is there.

``deploy/demo`` sets everything up and runs this. What it makes lies in a temporary folder and goes with it. The last
line on stdout is one JSON object; exit status 0 only if every expected identification arrived, and the text that a
virtual beacon was given (`demo_firmware`; skipped where there is no C compiler).
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from heliograph.errors import BusError, HeliographError
from heliograph.keys import parse
from heliograph.messages import Data, Frames, Identification
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.site import Site, load_site
from heliograph.site import Beacon
from heliograph.units import US_PER_S
from heliograph.wire import SCHEMAS
from heliograph_services.cli.demo_view import Lines, Table, View
from heliograph_services.cli.plan import holding, plan_of
from heliograph_services.cli.supervision import ProcessState, Supervised, SupervisionError

_SCENARIO: Final = "construction_site"
_NOT_ALL: Final = 1
_WRONG: Final = 2
_WAIT_S: Final = 0.05
_LOOK_S: Final = 0.25
# Starting five processes with warm kernels takes 5 s on two idle cores; compiling first, on a loaded machine, a minute.
_GRACE_S: Final = 100.0
_AWAITED: Final = frozenset({"tracker", "decoder", "metrics_sink"})
# After the source has ended: the decoder's last window, its last refresh, and the metrics sink's last commit.
_DRAIN_S: Final = 1.0
# A beacon that is visible for so long at a stretch must be identified: ten characters of a text at 1 kbit/s take .11 s,
# and whoever comes first waits for two periods of the tracker.
_SEEN_S: Final = 2.0
_LOOK_AT_S: Final = 0.02
# When the tracker is killed: everybody is identified by then, and enough is left to see it come back.
_KILL_AT: Final = 0.5


@dataclass
class Tally:
    """What the demo has seen."""

    identified: set[str] = field(default_factory=set)
    frames: int = 0
    most_processes: int = 0
    restarts: int = 0
    refreshed: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True)
class Scene:
    """What there is to see: the beacons, those that can be seen for long enough to be read, and the camera's sensor."""

    beacons: list[str]
    long_enough: list[str]
    sensor: str


@dataclass
class Kill:
    """The tracker's death and return."""

    pid: int
    at: float
    refreshed_before: Counter[str]
    back_s: float | None = None
    refreshed: Counter[str] = field(default_factory=Counter)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; return its exit status."""
    arguments = _parser().parse_args(argv)
    stop = Stop()
    stop.install()
    try:
        with tempfile.TemporaryDirectory(prefix="heliograph-demo-") as folder:
            return _run(arguments, Path(folder), stop)
    except HeliographError as error:
        print(f"demo: {error}", file=sys.stderr)
        return _WRONG


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="deploy/demo", description="The whole system on this machine, as processes.")
    parser.add_argument("--headless", action="store_true", help="plain lines, also on a terminal")
    parser.add_argument("--duration", type=_duration, default=10.0, metavar="S", help="seconds of the scene (10)")
    parser.add_argument(
        "--scenario", default=_SCENARIO, metavar="NAME", help=f"built-in scenario, or a scenario file ({_SCENARIO})"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all that is random in it (0)")
    parser.add_argument(
        "--fidelity", choices=("full", "live"), default="live", help="how finely the surroundings are rendered (live)"
    )
    parser.add_argument(
        "--no-firmware", action="store_true", help="leave out the beacon's own firmware, which takes a C compiler"
    )
    parser.add_argument("--kill-tracker", action="store_true", help="kill the tracker midway with signal 9")
    return parser


def _duration(text: str) -> float:
    value = float(text)
    # Acceptance of a text beacon takes a second, and the processes start within the first ones.
    if not 3.0 <= value <= 3600.0:
        raise argparse.ArgumentTypeError(f"must be 3 to 3600 s, not {text}")
    return value


def _run(arguments: argparse.Namespace, folder: Path, stop: Stop) -> int:
    site = _site(arguments, folder)
    scene = _scene(arguments)
    expected = scene.long_enough
    view: View = Table() if sys.stdout.isatty() and not arguments.headless else Lines()
    tally = Tally()
    kill: Kill | None = None
    start = time.monotonic()
    # The camera comes last: what nobody is ready to see would be lost, and counted as unread.
    supervised = Supervised(holding(plan_of(site, folder), "event_source"))
    supervised.start(follow_parent=True)
    with supervised, view:
        with connected(client_config(site.bus), site.site, f"client/{os.getpid()}", stop) as bus:
            if bus is not None:
                kill = _follow(bus, supervised, view, tally, arguments, stop)
        if not stop:
            supervised.stop()
    firmware = None if arguments.no_firmware or stop else _firmware(folder, stop)
    if stop:
        return 128 + signal.SIGINT
    result = {
        "identified": sorted(tally.identified),
        "expected": expected,
        "missing": sorted(set(expected) - tally.identified),
        "not_in_view_long_enough": sorted(set(scene.beacons) - set(expected)),
        "unexpected": sorted(tally.identified - set(scene.beacons)),
        "processes": tally.most_processes,
        "frames": tally.frames,
        "mar": _mar(folder / "metrics.sqlite"),
        "scenario": arguments.scenario,
        "sensor": scene.sensor,
        "fidelity": arguments.fidelity,
        "duration_s": round(time.monotonic() - start, 1),
        "restarts": tally.restarts,
    }
    if firmware is not None:
        result["firmware"] = firmware
    if kill is not None:
        result["tracker_back_s"] = None if kill.back_s is None else round(kill.back_s, 2)
        result["refreshed_meanwhile"] = dict(sorted(kill.refreshed.items()))
    print(json.dumps(result), flush=True)
    is_deaf = firmware is not None and firmware.get("heard") is False
    return _NOT_ALL if result["missing"] or is_deaf else 0


def _firmware(folder: Path, stop: Stop) -> dict[str, Any]:
    """Let the beacon's own firmware speak, where it can be compiled."""
    from heliograph_services.cli.demo_firmware import firmware_in_the_loop  # noqa: PLC0415 - needed here alone

    return firmware_in_the_loop(folder, stop, lambda line: print(line, flush=True))


def _follow(
    bus: Bus, supervised: Supervised, view: View, tally: Tally, arguments: argparse.Namespace, stop: Stop
) -> Kill | None:
    """Show what arrives until the scene has ended."""
    inbox = bus.subscribe({name: SCHEMAS[name] for name in ("ids", "messages", "frames")})
    warm: set[str] = set()
    bus.watch("live", lambda text, present: _note_live(warm, text, present=present))
    kill: Kill | None = None
    begin = looked = time.monotonic()
    released: float | None = None
    until = deadline = begin + arguments.duration + _GRACE_S
    while not stop and (now := time.monotonic()) < until:
        sample = inbox.get(_WAIT_S)
        opened = bus.open(sample) if sample else None
        if opened is not None:
            _take(opened[1], view, tally, round(arguments.duration * US_PER_S))
        if now - looked < _LOOK_S:
            continue
        looked = now
        states = {state.name: state for state in supervised.states()}
        _judge(states, supervised, tally, allow_restarts=kill is not None)
        if released is None:
            if warm >= _AWAITED:
                supervised.release()
                released = now
            continue
        if states["event_source"].ended_well and until == deadline:
            until = min(deadline, now + _DRAIN_S)
        if kill is None:
            if arguments.kill_tracker and tally.identified and now - released > arguments.duration * _KILL_AT:
                kill = _kill_tracker(states["tracker"], view, tally)
        elif kill.back_s is None:
            _look_for_tracker(kill, states["tracker"], view, tally)
    if not stop and until == deadline:
        raise BusError(f"the scene did not end within {deadline - begin:g} s; is this machine overloaded?")
    return kill


def _note_live(warm: set[str], text: str, *, present: bool) -> None:
    found = parse(text)
    if found is not None and present:
        warm.add(found.parts[0])


def _take(message: object, view: View, tally: Tally, end_us: int) -> None:
    if isinstance(message, Identification):
        # That all beacons go when the scene ends is no loss to show.
        if not message.lost or message.t_us < end_us:
            view.state(message)
        if not message.lost:
            tally.identified.add(message.beacon)
            tally.refreshed[message.beacon] += 1
    elif isinstance(message, Data):
        view.text(message)
    elif isinstance(message, Frames):
        tally.frames += len(message.t_us)


def _judge(states: dict[str, ProcessState], supervised: Supervised, tally: Tally, *, allow_restarts: bool) -> None:
    """Count processes and restarts.

    Raises:
        SupervisionError: a process failed that nobody killed.
    """
    if not states:
        raise SupervisionError("the supervisor ended")
    tally.most_processes = max(
        tally.most_processes, sum(state.state in {"starting", "running"} for state in states.values())
    )
    tally.restarts = sum(state.restarts for state in states.values())
    for state in states.values():
        failed = state.state in {"backoff", "fatal", "exited"} and not state.ended_well
        if (failed or state.restarts) and not (allow_restarts and state.name == "tracker"):
            said = supervised.last_line(state.name) or "it wrote nothing"
            raise SupervisionError(f"{state.name} failed ({state.state}): {said}")


def _kill_tracker(tracker: ProcessState, view: View, tally: Tally) -> Kill | None:
    if not tracker.pid:
        return None
    os.kill(tracker.pid, signal.SIGKILL)
    view.note(f"killed the tracker (pid {tracker.pid}) with signal 9")
    return Kill(tracker.pid, time.monotonic(), Counter(tally.refreshed))


def _look_for_tracker(kill: Kill, tracker: ProcessState, view: View, tally: Tally) -> None:
    """Take note of the tracker's return; until then identifications must go on being refreshed."""
    kill.refreshed = tally.refreshed - kill.refreshed_before
    if tracker.state == "running" and tracker.pid not in {0, kill.pid}:
        kill.back_s = time.monotonic() - kill.at
        told = ", ".join(f"{name} {n}" for name, n in sorted(kill.refreshed.items()))
        view.note(f"the tracker is back after {kill.back_s:.1f} s (pid {tracker.pid}); refreshed meanwhile: {told}")


def _mar(path: Path) -> float | None:
    """Return MAR_sent (visible) as the metrics sink counted it, or None where it had no truth."""
    from heliograph_services.metrics_sink.summary import summarise  # noqa: PLC0415 - after the run alone

    try:
        accuracy = summarise(path).accuracy
    except HeliographError:
        return None
    value = accuracy.mar_visible.value if accuracy else None
    return None if value is None else round(value, 4)


def _scene(arguments: argparse.Namespace) -> Scene:
    """Return what a scenario shows within the demo's time."""
    import numpy as np  # noqa: PLC0415 - wanted here alone

    from heliograph_services.event_source.simulation.readout.presets import load_preset  # noqa: PLC0415
    from heliograph_services.event_source.simulation.world.load import load_scenario  # noqa: PLC0415
    from heliograph_services.event_source.simulation.world.world import World  # noqa: PLC0415

    scenario = load_scenario(arguments.scenario)
    camera = scenario.camera
    sensor = load_preset(camera.sensor, camera.mode, camera.override)
    world = World(scenario, sensor.width, sensor.height, sensor.pitch_um, arguments.seed)
    visible = world.seen_all(np.arange(0.0, arguments.duration, _LOOK_AT_S) * US_PER_S).visible
    need = round(_SEEN_S / _LOOK_AT_S)
    runs = [max((len(run) for run in "".join("01"[v] for v in row).split("0")), default=0) for row in visible.tolist()]
    names = [beacon.name for beacon in world.beacons]
    return Scene(names, sorted(name for name, run in zip(names, runs, strict=True) if run >= need), sensor.name)


def _site(arguments: argparse.Namespace, folder: Path) -> Site:
    """Write the demo's site file, and return it as the processes read it."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{s.getsockname()[1]}"
    path = folder / "demo.toml"
    source = {"scenario": arguments.scenario, "seed": arguments.seed, "fidelity": arguments.fidelity}
    text = site_text(source | {"duration_s": arguments.duration}, endpoint, folder)
    path.write_text(text, encoding="utf-8")
    return load_site(path)


def site_text(source: dict[str, Any], endpoint: str, folder: Path) -> str:
    """Return a site file for a scenario: all services, and the scenario's beacons by name.

    Args:
        source: settings of the source: scenario, duration_s ...
        endpoint: of the router.
        folder: where the metrics go.
    """
    services: list[dict[str, Any]] = [
        {"kind": "event_source", "backend": "simulated", **source},
        {"kind": "tracker"},
        {"kind": "decoder"},
        {"kind": "metrics_sink", "file": str(folder / "metrics.sqlite")},
    ]
    lines = [
        'site = "demo"',
        'host = "demo"',
        "[bus]",
        f'connect = ["{endpoint}"]',
        "[router]",
        f'listen = ["{endpoint}"]',
    ]
    for service in services:
        lines += ["[[service]]", *(f"{name} = {json.dumps(value)}" for name, value in service.items())]
    for beacon in _beacons(source["scenario"]):
        lines += ["[[beacon]]", *_beacon_lines(beacon)]
    return "\n".join(lines) + "\n"


def _beacons(scenario: str) -> list[Beacon]:
    from heliograph_services.event_source.simulation.world.load import (  # noqa: PLC0415 - wanted here alone
        load_scenario,
        site_beacons,
    )

    return site_beacons(load_scenario(scenario))


def _beacon_lines(beacon: Beacon) -> list[str]:
    lines = [f"name = {json.dumps(beacon.name)}", f"protocol = {json.dumps(beacon.protocol)}"]
    lines.append(f"bit_rate = {beacon.bit_rate}")
    if beacon.payload is not None:
        lines.append(f"payload = {beacon.payload}")
    if beacon.options:
        pairs = ", ".join(f"{name} = {json.dumps(value)}" for name, value in beacon.options.items())
        lines.append(f"options = {{ {pairs} }}")
    return lines


if __name__ == "__main__":
    sys.exit(main())
