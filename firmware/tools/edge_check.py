"""Check the edges of a beacon's light: are the frames whole, is the bit clock true?

One checker for all: the virtual beacon, the emulators, the model of the ESP32's RMT, a logic analyser's capture::

    python firmware/tools/edge_check.py FILE --protocol seed11 --bit-rate 1000 [--option parity=paper_text] [--gap 0]

A file has an edge a line, `t_ns,level` (level 1 lit, 0 dark), in order; lines that begin with `#` or a letter are
notes.
Light is cut where it is dark for longer than DARK_BITS: then it was disarmed, and what follows is another *stretch*. In
a stretch each interval between two edges is a whole number of bits::

    k = round((t[i] - t[i-1]) r)    error = t[i] - t[i-1] - k / r       drift = t[last] - t[first] - (sum of k) / r

with the bit rate r. The bits, k of each level, are then cut into frames, which must all be frames of the protocol; the
first and the last of a stretch may be cut off.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from heliograph.link.convolutional import POLYNOMIALS, TAIL, mother_bits
from heliograph.link.modulations import modulation
from heliograph.link.modulations.code import Code
from heliograph.link.modulations.packet import Packet
from heliograph.link.modulations.seed11 import Seed11
from heliograph.link.packet_layout import CRC_BYTES, HEADER_BYTES, SYNC_BITS, Layout
from heliograph.link.uart_layout import CHARACTER_BITS, character_bits

NS_PER_S: Final = 1_000_000_000
# No frame is dark for so long: the longest run of a word is 10 bits, a gap of packets is given and added.
DARK_BITS: Final = 24

Edge = tuple[int, int]


@dataclass
class Stretch:
    """Light between two darknesses.

    Args:
        bits: of the first lit bit to the last, as the intervals say.
        starts_ns: when each begins, by the edges before.
        errors_ns: of each interval.
        drift_ns: of the whole.
    """

    bits: str = ""
    starts_ns: list[float] = field(default_factory=list)
    errors_ns: list[float] = field(default_factory=list)
    drift_ns: float = 0.0


@dataclass
class Report:
    """What a capture holds: frames in order (payload, character, or address and data), and what was no frame."""

    frames: list[Any] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    stretches: int = 0
    edges: int = 0
    worst_error_ns: float = 0.0
    median_error_ns: float = 0.0
    worst_drift_ns: float = 0.0


def read_edges(lines: Iterable[str]) -> list[Edge]:
    """Return the edges of a file's lines.

    Raises:
        ValueError: a line is none, or the edges are out of order or do not alternate.
    """
    edges: list[Edge] = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line[0] == "#" or line[0].isalpha():
            continue
        time, _, level = line.partition(",")
        edge = (int(time), int(level))
        if edge[1] not in (0, 1) or (edges and (edge[0] < edges[-1][0] or edge[1] == edges[-1][1])):
            raise ValueError(f"line {number} is no edge after the one before: {line.strip()!r}")
        edges.append(edge)
    return edges


def stretches(edges: Sequence[Edge], bit_rate: float, dark_bits: int = DARK_BITS) -> list[Stretch]:
    """Return the stretches of light; the last bit of each is known only where an edge follows it."""
    found: list[Stretch] = []
    bit_ns = NS_PER_S / bit_rate
    now, total = Stretch(), 0
    first_ns = 0
    for (t_ns, level), (next_ns, _) in pairwise(edges):
        n = round((next_ns - t_ns) / bit_ns)
        if not level and n > dark_bits:
            found.append(now)
            now, total = Stretch(), 0
            continue
        if not now.bits:
            first_ns = t_ns
        now.starts_ns += [t_ns + i * bit_ns for i in range(n)]
        now.bits += str(level) * n
        now.errors_ns.append(next_ns - t_ns - n * bit_ns)
        total += n
        now.drift_ns = next_ns - first_ns - total * bit_ns
    found.append(now)
    return [stretch for stretch in found if stretch.bits]


def word_frames(bits: str, words: dict[str, int]) -> tuple[list[int], list[str]]:
    """Return the payloads of the words in a row, aligned where most of them are words, and what is none.

    What is cut off at either end is neither.
    """
    n = len(next(iter(words)))
    cut = [[bits[i : i + n] for i in range(offset, len(bits) - n + 1, n)] for offset in range(min(n, len(bits)))]
    best = max(cut, key=lambda row: sum(word in words for word in row), default=[])
    return [words[word] for word in best if word in words], [word for word in best if word not in words]


def uart_frames(bits: str) -> tuple[list[str], list[str]]:
    """Return the characters between idle light, and what is none."""
    table = {"".join(map(str, character_bits(code))): chr(code) for code in range(128)}
    good: list[str] = []
    bad: list[str] = []
    # A capture may end in idle light, which has no edge behind it: then the last character's ones are not in the bits.
    bits += "1" * (CHARACTER_BITS - 1)
    at = bits.find("0")
    while 0 <= at <= len(bits) - CHARACTER_BITS:
        word = bits[at : at + CHARACTER_BITS]
        (good if word in table else bad).append(table.get(word, word))
        at = bits.find("0", at + CHARACTER_BITS)
    return good, bad


def packet_frames(bits: str, layout: Layout) -> tuple[list[tuple[int, int, int, bytes]], list[str]]:
    """Return (address, number, fragment, data) of the packets, and what is none; between them it may be dark."""
    good: list[tuple[int, int, int, bytes]] = []
    bad: list[str] = []
    sync = "".join(map(str, layout.tables().sync))
    at = bits.find(sync)
    while 0 <= at <= len(bits) - layout.bits:
        air = bits[at : at + layout.bits]
        packet = layout.parse(packet_bytes(air, layout)) if air.startswith(sync) else None
        if packet is None:
            bad.append(air)
        else:
            good.append((packet.address, packet.number, packet.fragment, packet.data))
        at += layout.bits
        at += len(bits[at:]) - len(bits[at:].lstrip("0"))
    return good, bad


def packet_bytes(air: str, layout: Layout) -> bytes:
    """Return HEADER, DATA and CRC of an undisturbed packet: each step's bit follows from the code bits of that step.

    A bit that contradicts the others spoils the bytes, and so fails the packet's check.
    """
    tables = layout.tables()
    sent = {
        int(place): int(bit) ^ int(flip)
        for place, bit, flip in zip(tables.mother, air[SYNC_BITS:], tables.flip, strict=True)
    }
    data: list[int] = []
    for t in range(tables.steps):
        window = sum(data[t - back] << (TAIL - back) for back in range(1, TAIL + 1) if t >= back)
        branch = 0 if 2 * t in sent else 1
        data.append(sent[2 * t + branch] ^ ((window & POLYNOMIALS[branch]).bit_count() & 1))
    again = mother_bits(data)
    if any(again[place] != bit for place, bit in sent.items()) or any(data[-TAIL:]):
        return bytes(HEADER_BYTES + layout.block + CRC_BYTES - 1) + b"\1"
    return int("".join(map(str, data[:-TAIL])), 2).to_bytes(HEADER_BYTES + layout.block + CRC_BYTES, "big")


def frames_of(bits: str, protocol: str, options: dict[str, str | int]) -> tuple[list[Any], list[str]]:
    """Return a stretch's frames, and what is none.

    Raises:
        ValueError: the protocol is none of these four.
    """
    made = modulation(protocol, **options)
    if isinstance(made, Seed11 | Code):
        n = made.code.bits
        return word_frames(bits, {format(word, f"0{n}b"): payload for payload, word in enumerate(made.code.words)})
    if isinstance(made, Packet):
        return packet_frames(bits, made.layout)
    if protocol == "uart":
        return uart_frames(bits)
    raise ValueError(f"protocol must be one of seed11, code, uart, packet, not {protocol!r}")


def check(
    edges: Sequence[Edge], protocol: str, bit_rate: float, options: dict[str, str | int] | None = None, gap: int = 0
) -> Report:
    """Return what the edges hold; `gap` is the dark bits between packets."""
    report = Report(edges=len(edges))
    errors: list[float] = []
    for stretch in stretches(edges, bit_rate, DARK_BITS + gap):
        good, bad = frames_of(stretch.bits, protocol, options or {})
        report.frames += good
        report.damaged += bad
        report.stretches += 1
        errors += map(abs, stretch.errors_ns)
        report.worst_drift_ns = max(report.worst_drift_ns, abs(stretch.drift_ns), key=abs)
    if errors:
        report.worst_error_ns = max(errors)
        report.median_error_ns = sorted(errors)[len(errors) // 2]
    return report


def main(words: Sequence[str] | None = None) -> int:
    """Print a capture's report as JSON; return 0 where no frame is damaged and no interval beyond the tolerance."""
    parser = argparse.ArgumentParser(description="Check the edges of a beacon's light.")
    parser.add_argument("file", type=Path)
    parser.add_argument("--protocol", required=True, choices=("seed11", "code", "uart", "packet"))
    parser.add_argument("--bit-rate", type=float, required=True)
    parser.add_argument("--option", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--gap", type=int, default=0)
    parser.add_argument("--tolerance-us", type=float, default=1.0)
    chosen = parser.parse_args(words)
    pairs = [option.partition("=") for option in chosen.option]
    options = {name: int(value) if value.isdigit() else value for name, _, value in pairs}
    try:
        edges = read_edges(chosen.file.read_text().splitlines())
        report = check(edges, chosen.protocol, chosen.bit_rate, options, chosen.gap)
    except (OSError, ValueError) as error:
        sys.stderr.write(f"edge_check: {error}\n")
        return 2
    said = vars(report) | {"frames": len(report.frames), "damaged": len(report.damaged)}
    sys.stdout.write(json.dumps(said) + "\n")
    fine = report.frames and not report.damaged and report.worst_error_ns <= 1000 * chosen.tolerance_us
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
