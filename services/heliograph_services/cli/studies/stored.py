"""What a study leaves in a folder: its cells, a line each as they are done, and the result made of them.

`STUDY.jsonl` begins with a head (schema, study, version, size, release, digests of parameters and code), then has a
line for each time that cells were run (`look`) and one for each cell that is done::

    {"schema": 1, "study": "bit_rate", "version": 1, "size": "full", "release": "0.2.0", "parameters": .., "code": ..}
    {"look": {"commit": "1a2b3c4", "machine": {..}}}
    {"cell": {..parameters..}, "seed": 12, "counts": {..}, "cpu_s": 1.2}

A line is written at once and flushed; what a cut left of a last line is dropped. `STUDY.json` is the result: the same
head, seeds, n, CPU time and the tables, written beside and moved into place.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec

from heliograph.errors import ConfigError, FileError
from heliograph_services.cli.studies.study import Cell, Done, Size, Study
from heliograph_services.decoder.config import DecoderConfig
from heliograph_services.event_source.config import EventSourceConfig
from heliograph_services.tracker.config import TrackerConfig

SCHEMA: Final = 1
_SOURCES: Final = Path(__file__).parents[4]


def parameters_digest() -> str:
    """Return a digest of all defaults of source, tracker and decoder: the one set of parameters of all studies."""
    defaults = [msgspec.to_builtins(kind()) for kind in (EventSourceConfig, TrackerConfig, DecoderConfig)]
    return hashlib.sha256(json.dumps(defaults, sort_keys=True).encode()).hexdigest()[:16]


@cache
def code_digest() -> str:
    """Return a digest of everything that figures depend on: the packages' sources and presets."""
    digest = hashlib.sha256()
    for package in ("common/heliograph", "services/heliograph_services"):
        for path in sorted((_SOURCES / package).rglob("*")):
            if path.suffix in {".py", ".toml", ".json", ".csv"}:
                digest.update(path.relative_to(_SOURCES).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def commit() -> str:
    """Return the commit of the sources, with `+` where they differ from it; `unknown` without a repository."""
    try:
        told = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--exclude=*"],  # noqa: S607 - whichever git there is
            cwd=_SOURCES,
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return told.stdout.strip()


class Book:
    """The cells of a study in a folder.

    Args:
        folder: where.
        study: which.
        size: of it.
        release: what its seeds come from.
        resume: whether to go on with what is there.

    Raises:
        ConfigError: cells are there and `resume` is not set, or they are of another release, size or code.
        FileError: what is there cannot be read.
    """

    def __init__(self, folder: Path, study: Study, size: Size, release: str, *, resume: bool) -> None:
        self.path = folder / f"{study.name}.jsonl"
        self.head: dict[str, Any] = {
            "schema": SCHEMA,
            "study": study.name,
            "version": study.version,
            "size": size,
            "release": release,
            "parameters": parameters_digest(),
            "code": code_digest(),
        }
        self.looks: list[dict[str, Any]] = []
        self.done: dict[str, Done] = {}
        if not self.path.exists():
            return
        if not resume:
            raise ConfigError(f"{self.path}: cells are there: go on with them (--resume), or choose another --out")
        head, self.looks, self.done = read_cells(self.path)
        for name, value in self.head.items():
            if head.get(name) != value:
                was = head.get(name)
                raise ConfigError(f"{self.path}: its {name} is {was}, not {value}: choose another --out")

    def look(self, machine: dict[str, Any]) -> None:
        """Note that cells are about to be run.

        Raises:
            FileError: the file cannot be written.
        """
        self.looks.append({"commit": commit(), "machine": machine})
        if not self.path.exists():
            self._append(self.head)
        self._append({"look": self.looks[-1]})

    def keep(self, one: Done) -> None:
        """Keep a cell.

        Raises:
            FileError: the file cannot be written.
        """
        cell = one.cell
        self._append({"cell": cell.parameters, "seed": cell.seed, "counts": one.counts, "cpu_s": round(one.cpu_s, 2)})
        self.done[cell.key] = one

    def _append(self, line: dict[str, Any]) -> None:
        data = (json.dumps(line, separators=(",", ":")) + "\n").encode()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("ab") as file:
                if file.tell():
                    _drop_torn_line(self.path)
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise FileError(f"{self.path}: cannot be written: {error.strerror or error}") from None


def _drop_torn_line(path: Path) -> None:
    """Cut what follows the last whole line."""
    with path.open("rb+") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 1))
        if size and file.read(1) != b"\n":
            file.seek(0)
            file.truncate(file.read().rfind(b"\n") + 1)


def read_cells(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Done]]:
    """Return head, looks and cells of a file.

    Raises:
        FileError: it cannot be read, or is none of ours; the message names the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read: {error}") from None
    lines = text.split("\n")[:-1]  # what follows the last newline was cut off
    head: dict[str, Any] = {}
    looks: list[dict[str, Any]] = []
    done: dict[str, Done] = {}
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            if number == 1:
                head = dict(row)
                if head["schema"] != SCHEMA:
                    raise ValueError(f"schema must be {SCHEMA}, not {head['schema']}")
            elif "look" in row:
                looks.append(dict(row["look"]))
            else:
                cell = Cell(dict(row["cell"]), int(row["seed"]))
                done[cell.key] = Done(cell, dict(row["counts"]), float(row["cpu_s"]))
        except (ValueError, KeyError, TypeError) as error:
            raise FileError(f"{path}: line {number} is broken: {error}") from None
    if not head:
        raise FileError(f"{path}: has no head")
    return head, looks, done


def result_of(
    study: Study,
    head: dict[str, Any],
    looks: Sequence[dict[str, Any]],
    found: dict[str, Done],
    cells: Sequence[Cell],
) -> dict[str, Any]:
    """Return the result of the cells that are done, in the order of the study's own list.

    Args:
        study: which.
        head: what its file begins with (`read_cells`).
        looks: likewise, of each time that cells were run.
        found: the cells that are done, by key.
        cells: all of the study.
    """
    done = [found[cell.key] for cell in cells if cell.key in found]
    seeds = sorted({one.cell.seed for one in done})
    return {
        **head,
        "title": study.title,
        "about": study.about,
        "evidence": study.evidence,
        "preset": study.preset,
        "timing": study.timing,
        "commit": looks[-1]["commit"] if looks else "unknown",
        "machine": looks[-1]["machine"] if looks else {},
        "looks": len(looks),
        "cells": len(cells),
        "cells_done": len(done),
        "seeds": {"first": seeds[0] if seeds else None, "last": seeds[-1] if seeds else None, "count": len(seeds)},
        "cpu_s": round(sum(one.cpu_s for one in done), 1),
        "tables": [asdict(table) for table in study.tables(done)] if done else [],
    }


def write_result(path: Path, result: dict[str, Any]) -> None:
    """Write a result at once: a cut run leaves the old file or the new one.

    Raises:
        FileError: it cannot be written.
    """
    write_whole(path, json.dumps(result, indent=1) + "\n")


def write_whole(path: Path, text: str) -> None:
    """Write a file beside, then move it into place.

    Raises:
        FileError: it cannot be written.
    """
    beside = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(text, encoding="utf-8")
        os.replace(beside, path)  # noqa: PTH105 - at once
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_result(path: Path) -> dict[str, Any]:
    """Return a stored result.

    Raises:
        FileError: it cannot be read, or is none of ours.
    """
    try:
        result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        needed = "schema study title about evidence preset commit parameters release tables"
        for name in needed.split():
            if name not in result:
                raise ValueError(f"no {name} in it")
        if result["schema"] != SCHEMA:
            raise ValueError(f"schema must be {SCHEMA}, not {result['schema']}")
        for table in result["tables"]:
            columns, rows = table["columns"], table["rows"]
            for row in rows:
                _ = [row["figures"].get(name) for name in columns], row["what"], row["published"], row["n"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(f"{path}: no result of `heliograph evaluate`: {error}") from None
    return result
