#!/usr/bin/env python3
"""Build the beacon's firmware: Python 3.11 and a C compiler, nothing else.

    python3 firmware/tools/make.py [TARGET ...] [--build FOLDER]     default: posix, into firmware/build
    python3 firmware/tools/make.py --missing                        say what cannot be built or run here, and why

    posix                        the virtual beacon, for this machine
    script                       the core on a clock of the tests' own
    esp32 esp32c3 esp32s3        that port on this machine, with fakes of the chip's peripherals (the real one: ESP-IDF)
    avr                          the port and the program that runs it in simavr
    riscv                        the port for QEMU
    fuzz                         libFuzzer on the core, and on its parsers alone (tools/fuzz.py runs them)

Compilers: CC (default cc), AVR_CC, RISCV_CC, CLANG; CFLAGS (default -O2 -g) are those of this machine's programs. A
missing compiler is told with its Debian package. What is younger than all that it is made of stays as it is.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

FIRMWARE: Final = Path(__file__).resolve().parents[1]
PEDANTIC: Final = "-std=c11 -Wall -Wextra -Wconversion -pedantic -Werror"
CORE: Final = "core/*.c"
CHIPS: Final = ("esp32", "esp32c3", "esp32s3")
# Debian's clang only recommends it: a clang without it compiles all, and cannot link a fuzzer.
LIBFUZZER: Final = "clang's libFuzzer"
# What building and running a target takes: a program or a file, and Debian's packages.
_CC: Final = ("cc", "gcc libc6-dev")
NEEDS: Final[dict[str, tuple[tuple[str, str], ...]]] = {
    "posix": (_CC,),
    "script": (_CC,),
    **dict.fromkeys(CHIPS, (_CC,)),
    "avr": (
        _CC,
        ("avr-gcc", "gcc-avr"),
        ("/usr/lib/avr/include/avr/io.h", "avr-libc"),
        ("/usr/include/simavr/sim_avr.h", "libsimavr-dev"),
        ("/usr/include/libelf.h", "libelf-dev"),
    ),
    "riscv": (("riscv64-unknown-elf-gcc", "gcc-riscv64-unknown-elf"), ("qemu-system-riscv32", "qemu-system-misc")),
    "fuzz": (("clang", "clang"), (LIBFUZZER, "libclang-rt-dev")),
}


@dataclass(frozen=True)
class Program:
    """A program to be made: name, compiler (variable, default), flags, and its sources as patterns."""

    name: str
    compiler: tuple[str, str]
    flags: str
    sources: tuple[str, ...]
    libraries: str = ""


HOST: Final = ("CC", "cc")
AVR_FLAGS: Final = "-mmcu=atmega1284p -DF_CPU=16000000uL -Os -flto -ffunction-sections -Wl,--gc-sections"
# Freestanding: no library but the compiler's own.
RISCV_FLAGS: Final = (
    "-march=rv32imac -mabi=ilp32 -Os -ffreestanding -fno-builtin -nostdlib -mcmodel=medany -misa-spec=2.2 "
    "-Wl,--no-warn-rwx-segments -Iports/riscv/include -T ports/riscv/link.ld"
)
FUZZ_FLAGS: Final = "-O1 -g -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all"


def _chip(name: str) -> Program:
    flags = f"{PEDANTIC} -DFAKE_{name.upper()} -Ifakes/esp_idf -Iports/esp32/main"
    return Program(f"beacon-{name}-host", HOST, flags, ("ports/esp32/main/*.c", "fakes/esp_idf/*.c", CORE))


def _fuzzer(name: str) -> Program:
    return Program(name, ("CLANG", "clang"), f"{PEDANTIC} {FUZZ_FLAGS}", (f"fuzz/{name}.c", CORE))


TARGETS: Final[dict[str, tuple[Program, ...]]] = {
    "posix": (Program("beacon-posix", HOST, PEDANTIC, ("ports/posix/*.c", CORE)),),
    "script": (Program("beacon-script", HOST, PEDANTIC, ("fakes/script.c", CORE)),),
    **{name: (_chip(name),) for name in CHIPS},
    "avr": (
        Program("beacon-avr.elf", ("AVR_CC", "avr-gcc"), f"{PEDANTIC} {AVR_FLAGS}", ("ports/avr/main.c", CORE)),
        # simavr's own headers are no strict C11.
        Program(
            "simavr_run",
            HOST,
            "-std=gnu11 -Wall -Wextra -Wconversion -Werror",
            ("ports/avr/simavr_run.c",),
            "-lsimavr -lelf",
        ),
    ),
    "riscv": (
        Program(
            "beacon-riscv.elf",
            ("RISCV_CC", "riscv64-unknown-elf-gcc"),
            f"{PEDANTIC} {RISCV_FLAGS}",
            ("ports/riscv/start.S", "ports/riscv/main.c", CORE),
            "-lgcc",
        ),
    ),
    "fuzz": (_fuzzer("fuzz_beacon"), _fuzzer("fuzz_parsers")),
}


class BuildError(Exception):
    """A program cannot be made; says why."""


class MissingError(BuildError):
    """What it takes is not here; names it, and Debian's packages."""


def missing(target: str) -> str:
    """Return what a target takes and is not here, with Debian's packages; empty where all is."""
    chosen = {default: os.environ.get(name) or default for name, default in (p.compiler for p in TARGETS[target])}
    absent = [(what, packages) for what, packages in NEEDS[target] if not _is_here(what, chosen)]
    if not absent:
        return ""
    packages = " ".join(dict.fromkeys(packages for _, packages in absent))
    return f"{', '.join(what for what, _ in absent)} not here (Debian: {packages})"


def _is_here(what: str, chosen: dict[str, str]) -> bool:
    """Return whether a program, a file or a library is here; `chosen` has the compilers that variables name."""
    if what != LIBFUZZER:
        return shutil.which(shlex.split(chosen.get(what, what))[0]) is not None or Path(what).is_file()
    clang = shlex.split(chosen["clang"])
    if shutil.which(clang[0]) is None:
        return False
    smallest = b"int LLVMFuzzerTestOneInput(const char *data, unsigned long size) { return data && size > 4000; }"
    with tempfile.TemporaryDirectory() as folder:
        command = [*clang, *FUZZ_FLAGS.split(), "-x", "c", "-", "-o", str(Path(folder) / "smallest")]
        return not subprocess.run(command, input=smallest, capture_output=True, check=False).returncode  # noqa: S603


def build(target: str, folder: Path) -> list[Path]:
    """Make a target in a folder; return its programs.

    Raises:
        BuildError: there is no such target, or the compiler refuses.
        MissingError: what it takes is not here.
    """
    if target not in TARGETS:
        raise BuildError(f"target must be one of {', '.join(TARGETS)}, not {target!r}")
    absent = missing(target)
    if absent:
        raise MissingError(f"{target}: {absent}")
    folder.mkdir(parents=True, exist_ok=True)
    return [_made(program, folder) for program in TARGETS[target]]


def _made(program: Program, folder: Path) -> Path:
    made = folder / program.name
    sources = [
        str(path.relative_to(FIRMWARE)) for pattern in program.sources for path in sorted(FIRMWARE.glob(pattern))
    ]
    if made.exists() and made.stat().st_mtime > max(path.stat().st_mtime for path in _inputs()):
        return made
    variable, default = program.compiler
    command = [*shlex.split(os.environ.get(variable) or default), *program.flags.split(), "-Icore"]
    if program.compiler == HOST:
        command += shlex.split(os.environ.get("CFLAGS", "-O2 -g"))
    command += ["-o", str(made.resolve()), *sources, *program.libraries.split()]
    done = subprocess.run(command, cwd=FIRMWARE, capture_output=True, text=True, check=False)  # noqa: S603 - from the table
    if done.returncode:
        raise BuildError(f"{program.name}: {shlex.join(command)}\n{done.stderr}")
    return made


def _inputs() -> list[Path]:
    """Return all that any program may be made of: a change anywhere makes all anew, which takes seconds."""
    return [Path(__file__), *(p for p in FIRMWARE.rglob("*") if p.suffix in {".c", ".h", ".S", ".ld"})]


def main(arguments: list[str]) -> int:
    """Build what is asked for; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", default=["posix"], metavar="TARGET", help=f"of {', '.join(TARGETS)}")
    parser.add_argument(
        "--build", type=Path, default=FIRMWARE / "build", metavar="FOLDER", help="default: firmware/build"
    )
    parser.add_argument("--missing", action="store_true", help="say what cannot be built or run here, and why")
    chosen = parser.parse_args(arguments)
    if chosen.missing:
        for target in TARGETS:
            if absent := missing(target):
                print(f"firmware, {target} skipped: {absent}")
        return 0
    try:
        for target in chosen.targets:
            for made in build(target, chosen.build):
                print(made)
    except BuildError as error:
        print(f"make.py: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
