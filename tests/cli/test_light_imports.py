"""What the default system does not import: seen in fresh processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("torch", "sklearn", "filterpy")
# A whole decode and the start of every service, in a process that then says what it has imported.
WHOLE = """
import sys
from heliograph.core import Context
from heliograph_services.cli.__main__ import main
from heliograph_services.decoder.__main__ import SERVICE as decoder
from heliograph_services.tracker.__main__ import SERVICE as tracker
from heliograph_services.metrics_sink.__main__ import SERVICE as metrics_sink
from heliograph_services.event_source.__main__ import SOURCE as event_source
import heliograph.shell.loop, heliograph.shell.router, heliograph_services.cli.demo, heliograph_services.cli.ids
file = sys.argv[1]
assert main(["simulate", "five", "-o", file, "--duration", "0.5"]) == 0
assert main(["decode", file, "--protocol", "auto", "--bit-rate", "1000"]) == 0
context = Context("i", "b", False)
for service in (decoder, tracker):
    service.make(service.config(), context)
event_source.make(event_source.config(backend="simulated"), context)
print("IMPORTED", *sorted({name.split(".")[0] for name in sys.modules}))
"""


def imported(script: str, *arguments: str) -> set[str]:
    command = [sys.executable, "-c", script, *arguments]
    out = subprocess.run(command, check=True, capture_output=True, text=True, timeout=110).stdout
    return set(out.splitlines()[-1].split()[1:])


def test_the_default_system_imports_no_torch_scikit_learn_or_filterpy(tmp_path: Path) -> None:
    names = imported(WHOLE, str(tmp_path / "five.npz"))
    assert {"numpy", "numba", "heliograph"} <= names
    assert not names & set(HEAVY)


@pytest.mark.parametrize("kind", ["tracker", "decoder", "event_source", "metrics_sink"])
def test_help_of_a_service_imports_neither_numpy_nor_numba_nor_zenoh(kind: str) -> None:
    script = f"""
import sys
from heliograph.shell.run import parser_for
from heliograph_services.{kind} import __main__ as module
service = getattr(module, "SERVICE", None) or module.SOURCE
parser_for(service.kind, service.about, service.config).format_help()
print("IMPORTED", *sys.modules)
"""
    assert not imported(script) & {"zenoh", "numba", "scipy", "faery", "torch"}
