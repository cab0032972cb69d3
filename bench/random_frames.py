"""Random frames through the real decisions: how many pass each stage, and how many identities they make.

    python bench/random_frames.py [--frames 1e8] [-o bench/results/false_frames.json]

A light sends random bits at the very clock of a receiver, for ever. Every bit position is taken for the beginning of a
frame, none for a better one: a receiver that has to choose one of its n alignments sees one of n.

`seed11`, `code` (code18d4, code20d4): slots of random bits as likelihoods (a burst of 20 events a transition, or of 3:
`clear` and `dim` light; a background of .3 of each polarity), tempered by `link.likelihood.slot`, each window decided
by `link.likelihood.decide`, accepted at `alignment.ACCEPT`, refused where ambiguous or periodic. Each alignment has a
row of its own, to the rule of `link.acceptance`: equal frames with no other between, and evidence enough; the row is
not broken by refused frames, nor forgotten when the score falls, which the receiver does. `equal_k`: rows of k equal
frames within 2 k - 1 frame lengths, whatever their evidence. The slots' likelihoods come from pools of 20,000 a kind.

`uart`: windows of eleven random bits, the next one bit on where the start, parity or stop bits are wrong and eleven
bits on where they are right, as if the follower found every place; runs of four and more go to `link.text_identity`,
exactly on time. Stages: windows, good characters, runs of 4, of 6, of 8, identities.

It stores after each chunk, with a seed of its own, and goes on where it was. Cost on one core for 1e8 frames: see
`cpu_s` in the result. Evidence: simulated.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from pathlib import Path
from typing import Any

import numba
import numpy as np

from heliograph.errors import Refusals
from heliograph.link.acceptance import MISSING, evidence_of, frames_needed
from heliograph.link.alignment import ACCEPT
from heliograph.link.codebook import load
from heliograph.link.frames import CyclicCode, bits_of, seed11_code
from heliograph.link.likelihood import BEST, NEXT, SCORE, VERDICT_FIELDS, decide, slot
from heliograph.link.text_identity import TextIdentity
from heliograph.link.uart_follow import Decision
from heliograph.link.uart_layout import CHARACTER_BITS, word_table

RESULT = Path(__file__).parent / "results" / "false_frames.json"
NAME = "false_frames/1"
CHUNK = 4_000_000
POOL = 20_000
BURST = {"clear": 20.0, "dim": 3.0}
BACKGROUND = 0.3
ROW_LEAST = 4  # characters of a run that is looked at


def codes() -> dict[str, CyclicCode]:
    """Return the cyclic codes on trial."""
    return {"seed11": seed11_code()} | {name: load(name).code() for name in ("code18d4", "code20d4")}


def pools(burst: float, seed: int) -> np.ndarray:
    """Return (4, POOL, 4) tempered likelihoods of slots that really are dark, rise, fall, lit."""
    rng = np.random.default_rng([seed, 1])
    on, off = np.full(4, BACKGROUND), np.full(4, BACKGROUND)
    on[1] += burst
    off[2] += burst
    logs = np.zeros((4, POOL, 4))
    for x in range(4):
        n_on, n_off = rng.poisson(on[x], POOL), rng.poisson(off[x], POOL)
        for y in range(4):
            logs[x, :, y] = n_on * np.log(on[y]) - on[y] + n_off * np.log(off[y]) - off[y]
    out = np.empty_like(logs)
    for x in range(4):
        for i in range(POOL):
            slot(logs[x, i], out[x, i])
    return out


@numba.njit
def _cyclic(seed, frames, pool, words, refused, next_one, needed, missing, evidence, counts):  # type: ignore[no-untyped-def]
    """Decide so many windows; add up accepted frames, rows of 2, 3, ... equal ones."""
    np.random.seed(seed)  # noqa: NPY002 - numba's own generator
    n = words.shape[1]
    size = n + 1
    ring = np.ones((size, 4))
    verdict = np.empty(VERDICT_FIELDS)
    payload = np.full(n, -1, np.int64)
    at = np.zeros((n, 8), np.int64)
    length = np.zeros(n, np.int64)
    nats = np.zeros(n)
    before = 0
    for m in range(frames + n):
        bit = np.random.randint(2)  # noqa: NPY002
        ring[m % size] = pool[2 * before + bit, np.random.randint(pool.shape[1])]  # noqa: NPY002
        before = bit
        if m < n:
            continue
        decide(ring, m - n, words, next_one, verdict)
        counts[0] += 1
        if not verdict[SCORE] >= ACCEPT:
            continue
        best = int(verdict[BEST])
        if refused[best]:
            continue
        counts[1] += 1
        r = m % n
        if payload[r] != best:
            payload[r] = best
            length[r] = 0
        if length[r] > 0:
            nats[r] += (m // n - at[r, 0] - 1) * np.log(missing)
        if length[r] == 0 or nats[r] <= 0.0:
            nats[r] = 0.0
        score = verdict[SCORE]
        worth = evidence[1] if score >= 1.0 else min(evidence[0] + np.log(score / (1.0 - score)), evidence[1])
        nats[r] += worth + np.log(1.0 - missing)
        for k in range(7, 0, -1):
            at[r, k] = at[r, k - 1]
        at[r, 0] = m // n
        length[r] = min(length[r] + 1, 8)
        for k in range(2, needed + 1):
            if length[r] >= k and at[r, 0] - at[r, k - 1] <= 2 * k - 1:
                counts[k] += 1
        if length[r] >= needed and nats[r] >= evidence[2]:
            counts[needed + 1] += 1


@numba.njit
def _characters(seed, windows, good, found, counts):  # type: ignore[no-untyped-def]
    """Go through random bits; fill in the characters of runs of ROW_LEAST and more, each run ended by -1."""
    np.random.seed(seed)  # noqa: NPY002
    run = np.empty(64, np.int64)
    have = word = length = n = 0
    while counts[0] < windows:
        word = ((word << 1) | np.random.randint(2)) & 0x7FF  # noqa: NPY002
        have += 1
        if have < 11:
            continue
        counts[0] += 1
        code = good[word]
        if code >= 0:
            counts[1] += 1
            run[min(length, 63)] = code
            length += 1
            have = 0
            continue
        if length >= 4:
            for k in range(min(length, 64)):
                found[n] = run[k]
                n += 1
            found[n] = -1
            n += 1
        length = 0
    return n


def cyclic(code: CyclicCode, burst: float, seed: int, frames: int) -> dict[str, int]:
    """Return the counts of so many windows."""
    needed = frames_needed(code)
    refused = np.zeros(len(code.words), np.bool_)
    refused[list(code.twins.keys() | code.periodic)] = True
    words = np.array([bits_of(word, code.bits) for word in code.words], np.uint8)
    next_one = NEXT if code.start[1] and code.start[0] >> (code.start[1] - 1) else 0.5
    worth = evidence_of(code)
    evidence = np.array([worth.at_even, worth.most, worth.needed])
    counts = np.zeros(needed + 2, np.int64)
    _cyclic(seed, frames, pools(burst, seed), words, refused, next_one, needed, MISSING, evidence, counts)
    rows = {f"equal_{k}": int(counts[k]) for k in range(2, needed + 1)}
    return {"frames": int(counts[0]), "accepted": int(counts[1]), **rows, "identities": int(counts[needed + 1])}


def uart(seed: int, windows: int) -> dict[str, int]:
    """Return the counts of so many windows."""
    good = np.full(1 << CHARACTER_BITS, -1, np.int64)
    good[word_table()] = np.arange(128)
    found, counts = np.empty(windows // 100 + 1000, np.int64), np.zeros(2, np.int64)
    n = _characters(seed, windows, good, found, counts)
    out = {"frames": int(counts[0]), "accepted": int(counts[1]), "equal_4": 0, "equal_6": 0, "equal_8": 0}
    out["identities"] = 0
    run: list[int] = []
    for code in found[:n].tolist():
        if code >= 0:
            run.append(code)
            continue
        for k in (4, 6, 8):
            out[f"equal_{k}"] += len(run) >= k
        out["identities"] += _is_text(run)
        run = []
    return out


def _is_text(run: list[int]) -> bool:
    identity = TextIdentity(Refusals(), 1000.0)
    for i, code in enumerate(run):
        decision = Decision(i * 176.0, (i + 1) * 176.0, code, None, True, i == 0, 20.0, 0.0, 100)
        identity.take(decision, 11_000 * (i + 1))
    return identity.accepted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=float, default=1e8, help="of each protocol, half of them of each light")
    parser.add_argument("--only", nargs="+", default=["seed11", "code18d4", "code20d4", "uart"])
    parser.add_argument("--budget", type=float, default=1e9, help="CPU seconds, then it stops")
    parser.add_argument("--release", default="development", help="what the seeds are derived from")
    parser.add_argument("-o", type=Path, default=RESULT)
    arguments = parser.parse_args()
    stored: dict[str, Any] = json.loads(arguments.o.read_text()) if arguments.o.is_file() else {}
    if stored.get("release") != arguments.release:
        stored = {"study": NAME, "release": arguments.release, "evidence": "simulated", "looks": 0, "rows": {}}
    stored["looks"] += 1
    for name in arguments.only:
        for light in BURST if name != "uart" else ("hard bits",):
            wanted = arguments.frames / (2 if name != "uart" else 1)
            row = stored["rows"].setdefault(f"{name}, {light}", {"chunks": 0, "cpu_s": 0.0, "counts": {}})
            while row["counts"].get("frames", 0) < wanted and time.process_time() < arguments.budget:
                seed = zlib.crc32(f"{NAME} {arguments.release} {name} {light} {row['chunks']}".encode())
                frames = int(min(CHUNK, wanted - row["counts"].get("frames", 0)))
                began = time.process_time()
                new = uart(seed, frames) if name == "uart" else cyclic(codes()[name], BURST[light], seed, frames)
                for key, value in new.items():
                    row["counts"][key] = row["counts"].get(key, 0) + value
                row["chunks"] += 1
                row["cpu_s"] = round(row["cpu_s"] + time.process_time() - began, 2)
                arguments.o.write_text(json.dumps(stored, indent=1) + "\n")
            print(f"{name}, {light}: {row['counts']}, {row['cpu_s']} CPU s", flush=True)


if __name__ == "__main__":
    main()
