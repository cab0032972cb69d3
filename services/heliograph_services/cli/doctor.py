"""`heliograph doctor [SITE.toml]`: is this machine fit, is the site sound, and what to do where not."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections import Counter
from collections.abc import Sequence
from typing import Final

import msgspec

from heliograph_services.cli.checks import Check, everything

EXIT_FAIL: Final = 1
_WIDTH: Final = 80


def run(argv: Sequence[str]) -> int:
    """Run the subcommand; return its exit status (0: nothing failed, 1: something did)."""
    parser = argparse.ArgumentParser(prog="heliograph doctor", description=__doc__)
    parser.add_argument("site", nargs="?", metavar="SITE.toml")
    parser.add_argument("--json", action="store_true", help="one JSON object a check")
    arguments = parser.parse_args(argv)
    verdicts: Counter[str] = Counter()
    for check in everything(arguments.site):
        verdicts[check.verdict] += 1
        print(
            json.dumps({"type": "check", **msgspec.to_builtins(check)}) if arguments.json else line(check), flush=True
        )
    if not arguments.json:
        print(f"{verdicts['ok']} ok, {verdicts['warn']} to know of, {verdicts['fail']} to mend")
    return EXIT_FAIL if verdicts["fail"] else 0


def line(check: Check) -> str:
    """Return a check for people: verdict, what, finding; below it what to do."""
    head = f"{check.verdict:<5} {check.check:<24} "
    found = textwrap.wrap(check.detail, _WIDTH - len(head)) or [""]
    indent = " " * len(head)
    lines = [head + found[0], *(indent + more for more in found[1:])]
    lines += [indent + more for more in textwrap.wrap("-> " + check.advice, _WIDTH - len(head))] if check.advice else []
    return "\n".join(lines)
