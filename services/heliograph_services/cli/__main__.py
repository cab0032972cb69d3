"""`heliograph`: one command, a table of subcommands, each imported only when it is asked for.

stdout is data, stderr is logs. A mistake of the operator is one line on stderr and exit status 2.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Final

from heliograph import __version__
from heliograph.errors import HeliographError
from heliograph.shell.process import keep_kernels

COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "decode": ("heliograph_services.cli.decode", "read a recording, in one process"),
    "simulate": ("heliograph_services.cli.simulate", "make a recording of a scene, with its truth"),
    "ids": ("heliograph_services.cli.ids", "follow the identifications of a running site"),
    "beacon": ("heliograph_services.cli.beacon", "list beacons, set them, let them shine, send messages"),
    "up": ("heliograph_services.cli.supervise", "start the processes of a site file"),
    "down": ("heliograph_services.cli.supervise", "stop them"),
    "status": ("heliograph_services.cli.supervise", "show them"),
    "config": ("heliograph_services.cli.config", "show or check settings, with the origin of each"),
    "metrics": ("heliograph_services.cli.metrics", "show what the metrics sink has kept"),
    "codebook": ("heliograph_services.cli.codebook", "list, show and generate codebooks"),
    "doctor": ("heliograph_services.cli.doctor", "check this machine, and a site file"),
    "bench": ("heliograph_services.cli.bench", "measure this machine on a stated corpus"),
    "evaluate": ("heliograph_services.cli.evaluate", "make the paper's figures and tables, beside ours"),
}
# These subcommands share a module and are told apart by their own name.
_SHARED: Final = ("up", "down", "status")
EXIT_USAGE: Final = 2


def usage() -> str:
    """Return the overview, at most 80 columns wide."""
    lines = [f"heliograph {__version__}: who blinks, where, and what it says", "", "usage: heliograph COMMAND ...", ""]
    lines += [f"  {name:<10}{about}" for name, (_, about) in COMMANDS.items()]
    return "\n".join([*lines, "", "heliograph COMMAND --help tells more."])


def main(argv: Sequence[str] | None = None) -> int:
    """Run a subcommand; return its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in {"-h", "--help"}:
        print(usage())
        return 0 if arguments else EXIT_USAGE
    if arguments[0] == "--version":
        print(__version__)
        return 0
    command = arguments[0]
    if command not in COMMANDS:
        print(f"heliograph: no command {command!r}; there are: {', '.join(COMMANDS)}", file=sys.stderr)
        return EXIT_USAGE
    keep_kernels()
    try:
        run = import_module(COMMANDS[command][0]).run
        status: int = run(arguments if command in _SHARED else arguments[1:])
    except HeliographError as error:
        print(f"heliograph {command}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except BrokenPipeError:  # the reader of our output has gone: not our fault, and no traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    return status


if __name__ == "__main__":
    sys.exit(main())
