"""The demo's second act: text given to `heliograph beacon send` goes through the beacon's own code to the decoder.

::

    heliograph beacon send -> beacon_controller -> pty -> firmware (its posix port) -> edges -> simulated camera
                                                                     text <- decoder <- tracker <-'

The scene and the site are those of `firmware/loop`. It takes a C compiler and the project's `firmware` folder; where
they are absent, it is skipped and says so.
"""

from __future__ import annotations

import os
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from heliograph.beacons import BeaconState
from heliograph.errors import HeliographError
from heliograph.messages import Data, Message, Tracks
from heliograph.shell.bus import Bus, connected
from heliograph.shell.links import client_config
from heliograph.shell.process import Stop
from heliograph.shell.site import load_site
from heliograph.wire import SCHEMAS
from heliograph_services.cli.plan import Program, plan_of
from heliograph_services.cli.supervision import Supervised

FIRMWARE: Final = Path(__file__).resolve().parents[3] / "firmware"
NAME: Final = "gate"
TEXT: Final = "the gate is open. "
# Sent so often: the receiver holds back what it reads until ten characters of a light are good.
_TIMES: Final = 4
_UID: Final = "00000000000000a1"
_WAIT_S: Final = 0.05
# Five processes with warm kernels take 5 s on two idle cores; each command a second of Python.
_PATIENCE_S: Final = 100.0
# The compiler needs 2 s.
_BUILD_S: Final = 60.0
_MISSING: Final = 2


def firmware_in_the_loop(folder: Path, stop: Stop, tell: Callable[[str], None]) -> dict[str, Any]:
    """Send a text through the firmware, and read it back.

    Args:
        folder: for all that it makes.
        stop: ends it early.
        tell: takes lines for people.

    Returns:
        `{"skipped": why}`, or `{"sent": text, "heard": whether it came back, "seconds": in all}`.
    """
    begin = time.monotonic()
    program, why = _built(folder)
    if why:
        tell(f"the firmware in the loop is skipped: {why}")
        return {"skipped": why}
    try:
        heard = _talk(_site(folder), program, folder, stop, tell)
    except HeliographError as error:
        tell(f"the firmware in the loop: {error}")
        heard = False
    return {"sent": TEXT, "heard": heard, "seconds": round(time.monotonic() - begin, 1)}


def _built(folder: Path) -> tuple[Path, str]:
    """Build the virtual beacon; return its program, and why there is none."""
    build = folder / "build"
    maker = FIRMWARE / "tools" / "make.py"
    if not maker.is_file():
        return build, "its folder is not part of this installation"
    done = subprocess.run(  # noqa: S603 - the project's own
        [sys.executable, str(maker), "posix", "--build", str(build)],
        capture_output=True,
        text=True,
        check=False,
        timeout=_BUILD_S,
    )
    return build / "beacon-posix", done.stderr.strip() if done.returncode else ""


def _site(folder: Path) -> Path:
    """Write the loop's scene and site for a folder and a free port; return the site file."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    fifo = folder / "gate.edges"
    os.mkfifo(fifo)
    scene, site = folder / "loop-scene.toml", folder / "loop.toml"
    loop = FIRMWARE / "loop"
    scene.write_text((loop / "scene.toml").read_text("utf-8").replace("run/gate.edges", str(fifo)), "utf-8")
    text = (loop / "site.toml").read_text("utf-8").replace("127.0.0.1:7444", f"127.0.0.1:{port}")
    text = text.replace("firmware/loop/scene.toml", str(scene)).replace("run/gate.tty", str(folder / "gate.tty"))
    site.write_text(text, "utf-8")
    return site


def _talk(path: Path, program: Path, folder: Path, stop: Stop, tell: Callable[[str], None]) -> bool:
    site = load_site(path)
    plan = plan_of(site, folder)
    arguments = ("--pty", str(folder / "gate.tty"), "--edges", str(folder / "gate.edges"), "--uid", _UID)
    # Among the services, so that it ends with them, however the demo ends.
    beacon = Program("beacon", "beacon", "beacon", (str(program), *arguments))
    supervised = Supervised(replace(plan, programs=(*plan.programs, beacon)))
    supervised.start(follow_parent=True)
    with supervised, connected(client_config(site.bus), site.site, f"client/{os.getpid()}", stop) as bus:
        if bus is None:
            return False
        ears = _Ears(bus, stop)
        if not ears.until(lambda: ears.obeys and ears.looks):
            return False
        if not _typed(path, tell, "arm", "--lease", "60") or not _typed(
            path, tell, "send", TEXT, "--times", str(_TIMES)
        ):
            return False
        heard = ears.until(lambda: TEXT in ears.text)
        if heard:
            tell(f"{NAME} says {TEXT!r} through its own firmware, a simulated light, the tracker and the decoder")
        return heard


def _typed(path: Path, tell: Callable[[str], None], action: str, *arguments: str) -> bool:
    """Run `heliograph beacon ACTION`, show it, and return whether the beacon has done it."""
    done = subprocess.run(  # noqa: S603 - our own command line
        [sys.executable, "-m", "heliograph_services.cli", "beacon", action, str(path), NAME, *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=_PATIENCE_S,
    )
    said = (done.stdout or done.stderr).strip()
    tell(f"$ {shlex.join(['heliograph', 'beacon', action, path.name, NAME, *arguments])}\n{said}")
    return done.returncode == 0


class _Ears:
    """What the bus says of the beacon."""

    def __init__(self, bus: Bus, stop: Stop) -> None:
        self.text = ""
        self.obeys = self.looks = False
        self._bus = bus
        self._stop = stop
        names = ("messages", "beacon", "tracks")
        self._inbox = bus.subscribe({name: SCHEMAS[name] for name in names})

    def until(self, is_true: Callable[[], bool]) -> bool:
        """Listen until something is true; False where patience ends before."""
        deadline = time.monotonic() + _PATIENCE_S
        while not is_true():
            if self._stop or time.monotonic() > deadline:
                return False
            sample = self._inbox.get(_WAIT_S)
            opened = self._bus.open(sample) if sample is not None else None
            if opened is not None:
                self._take(opened[1])
        return True

    def _take(self, message: Message) -> None:
        if isinstance(message, Data):
            self.text += message.text or ""
        elif isinstance(message, Tracks):
            self.looks = True
        elif isinstance(message, BeaconState):
            self.obeys = (
                message.link == "ready" and message.reported is not None and message.reported.protocol == "uart"
            )
