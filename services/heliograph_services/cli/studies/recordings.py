"""Study 6: characters of the real recordings, over thinning: ours, the paper's rule, `wang2022`, untuned and tuned.

The recordings are those of Wang et al. (2022), for academic use only, and no part of this project;
HELIOGRAPH_BEACON_DATA names their folder. Each holds the end of an earlier pass of a text and one whole pass. They are
thinned in two ways:
*at random* a share of the events is kept; *first k*: of each burst (events of one polarity that follow each other
within a quarter of a bit) the first k alone, as a pixel with a long refractory time would leave them.

All get the same events of one light at the nominal bit rate, the receivers alone. The paper's rule is its polarity
window (`abs(P) >= .5` in windows of a bit) before the layout of a character; tuned are its window and phase. *Tuned*
is in hindsight, on the very events that are read, the best of a grid: more than an operator could do, and flattered.
Ours has one setting. CER = (S + D + I) / characters sent, by edit distance, of the whole pass; its interval is a
bootstrap over runs of 20 characters of the text sent. Development data: ours was built while looking at them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.core import Context
from heliograph.errors import FileError
from heliograph.events import EventBatch, Flags, Times, concatenate
from heliograph.link.contract import LinkFrame, Receiver, Text
from heliograph.link.modulations import modulation
from heliograph.link.uart_layout import TIME_FILL
from heliograph.link.wang2022 import WangParameters, WangReceiver, published
from heliograph.shares import share
from heliograph.streams import Events
from heliograph.units import bit_us
from heliograph_services.cli.studies import contest
from heliograph_services.cli.studies.study import (
    Cell,
    Counts,
    Curve,
    Done,
    Figure,
    Panel,
    Parameters,
    Row,
    Size,
    Study,
    Table,
    worse_than,
)
from heliograph_services.cli.studies.windows_rule import read_windows

# File, nominal bit rate, whole characters of the earlier pass in it.
RECORDINGS: Final = {"504hz_100m": (504.0, 104), "3125hz_30m": (3125.0, 302)}
ARMS: Final = ("ours", "paper", "paper, tuned", "wang2022", "wang2022, tuned")
SHARES: Final = (1.0, 0.3, 0.1, 0.03, 0.01)
FIRSTS: Final = (100, 30, 10, 3, 1)
SEEDS: Final = 3
# A block of the bootstrap.
CHARACTERS: Final = 20
STEP_US: Final = 100_000
# Published (Wang et al. 2022): characters right of the whole pass.
QUOTED: Final = {"504hz_100m": "wang2022: 1.000 right", "3125hz_30m": "wang2022: .877 right"}


def cells(size: Size) -> list[Parameters]:
    """Return all cells: recording, arm, thinning, run."""
    if size == "quick":
        return [_cell("3125hz_30m", arm, "at random", 1.0, 0) for arm in ("ours", "paper", "wang2022")]
    out = []
    for name, arm in product(RECORDINGS, ARMS):
        out += [_cell(name, arm, "at random", kept, run) for kept in SHARES for run in range(SEEDS if kept < 1 else 1)]
        out += [_cell(name, arm, "first", float(k), 0) for k in FIRSTS]
    return out


def _cell(name: str, arm: str, thinning: str, amount: float, run: int) -> Parameters:
    return {"arms": [arm], "recording": name, "thinning": thinning, "amount": amount, "run": run}


def folder() -> Path:
    """Return where the recordings are."""
    beside = Path(__file__).parents[5] / "shared" / "data" / "beacon"
    return Path(os.environ.get("HELIOGRAPH_BEACON_DATA", beside))


def missing() -> str:
    """Return why the study cannot be run here."""
    away = [name for name in ("sonnet.txt", *(f"{name}.mat" for name in RECORDINGS)) if not (folder() / name).is_file()]
    return f"{folder()}: no {', '.join(away)}; not shipped (HELIOGRAPH_BEACON_DATA names their folder)" if away else ""


@cache
def recording(name: str) -> tuple[Times, Flags, str]:
    """Return times, polarities and the text of the whole pass.

    Raises:
        FileError: the recording or its text is not there.
    """
    from heliograph_services.event_source.config import EventSourceConfig  # noqa: PLC0415 - compiles on import
    from heliograph_services.event_source.stream import open_stream  # noqa: PLC0415

    path = folder() / f"{name}.mat"
    if not path.is_file():
        raise FileError(
            f"{path}: not there; the recordings of Wang et al. 2022 are not shipped (HELIOGRAPH_BEACON_DATA)"
        )
    try:
        text = (folder() / "sonnet.txt").read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"{folder() / 'sonnet.txt'}: cannot be read: {error.strerror}") from None
    config = EventSourceConfig(backend="recording", file=str(path), window_us=STEP_US, loop=False)
    batches: list[EventBatch] = []
    for step in open_stream(config, Context(instance="study", boot="0", lockstep=True)):
        batches += [message.batch for message in step.messages if isinstance(message, Events)]
    whole = concatenate(batches)
    return whole.t_us, whole.on, text


def thinned(t_us: Times, on: Flags, thinning: str, amount: float, rate: float, seed: int) -> tuple[Times, Flags]:
    """Return what is left of the events; see the module."""
    if thinning == "at random":
        kept = np.random.default_rng(seed).random(len(t_us)) < amount
        return t_us[kept], on[kept]
    n = len(t_us)
    new = np.ones(n, np.bool_)
    new[1:] = (on[1:] != on[:-1]) | (np.diff(t_us) > bit_us(rate) / 4.0)
    place = np.arange(n)
    first = np.maximum.accumulate(np.where(new, place, 0))
    kept = place - first < int(amount)
    return t_us[kept], on[kept]


def run(cell: Cell) -> Counts:
    """Run a cell."""
    one = cell.parameters
    rate, earlier = RECORDINGS[one["recording"]]
    t_us, on, sonnet = recording(one["recording"])
    t_us, on = thinned(t_us, on, one["thinning"], float(one["amount"]), rate, cell.seed)
    arm = one["arms"][0]
    sent = sonnet[-earlier:] + sonnet
    best = min((score(sent, sonnet, text) for text in texts(arm, t_us, on, rate)), key=lambda found: found["errors"])
    return best | {"events": len(t_us)}


def texts(arm: str, t_us: Times, on: Flags, rate: float) -> Iterator[str]:
    """Yield what an arm reads: once, or once for each setting of its grid."""
    if arm == "ours":
        yield heard(modulation("uart").receiver(rate), t_us, on, told=True)
    elif arm == "wang2022":
        yield heard(WangReceiver(rate), t_us, on)
    elif arm == "wang2022, tuned":
        was = published(rate)
        for times, cutoff, middle in product((0.25, 0.5, 1.0, 2.0), (1 / 6, 1 / 3, 2 / 3), (0.5, 0.55)):
            tried = WangParameters(was.upper * times, was.lower * times, cutoff, middle=middle)
            yield heard(WangReceiver(rate, tried), t_us, on)
    elif arm == "paper":
        yield read_windows(t_us, on, bit_us(rate))
    else:
        for width, phase in product((1.0, 0.75, 0.5, 0.25), (0.0, 0.25, 0.5, 0.75)):
            yield read_windows(t_us, on, bit_us(rate), width, phase)


def heard(receiver: Receiver, t_us: Times, on: Flags, *, told: bool = False) -> str:
    """Return the text that a receiver reads.

    Args:
        receiver: fresh.
        t_us: (n,) int64.
        on: (n,) bool.
        told: only what it releases as text counts, not every character.
    """
    out: list[LinkFrame | Text] = []
    before = 0
    for until_us in range(int(t_us[0]) + STEP_US, int(t_us[-1]) + 2 * STEP_US, STEP_US) if len(t_us) else ():
        at = int(np.searchsorted(t_us, until_us))
        out += receiver.feed(t_us[before:at], on[before:at], until_us)
        before = at
    out += receiver.flush()
    if told:
        return "".join(one.text or "" for one in out if isinstance(one, Text))
    return "".join(chr(one.payload) for one in out if isinstance(one, LinkFrame) and one.payload != TIME_FILL)


def score(sent: str, sonnet: str, text: str) -> Counts:
    """Return the errors of the whole pass, by blocks of CHARACTERS of it, and what was printed.

    Args:
        sent: all that is in the recording.
        sonnet: the whole pass, its end.
        text: what was read.
    """
    costs = aligned(sent, text)[len(sent) - len(sonnet) :]
    blocks = [[len(part), sum(part)] for part in (costs[i : i + CHARACTERS] for i in range(0, len(costs), CHARACTERS))]
    return {"errors": sum(costs), "sent": len(sonnet), "blocks": blocks, "printed": len(text)}


def aligned(sent: str, text: str) -> list[int]:
    """Return, for each character sent, the errors of the best alignment there: wrong or missing 1, each insertion 1.

    An insertion counts at the character that it comes before; those after the last at the last.
    """
    n, m = len(sent), len(text)
    read = np.frombuffer(text.encode("utf-32-le"), np.uint32)
    column = np.arange(m + 1)
    rows = np.empty((n + 1, m + 1), np.int32)
    rows[0] = column
    for i, letter in enumerate(sent, 1):
        changed = np.minimum(rows[i - 1, :-1] + (read != ord(letter)), rows[i - 1, 1:] + 1)
        rows[i] = np.minimum.accumulate(np.concatenate([[i], changed]) - column) + column
    costs = [0] * n
    i, j = n, m
    while i > 0 or j > 0:
        here = rows[i, j]
        if i and j and here == rows[i - 1, j - 1] + (sent[i - 1] != text[j - 1]):
            costs[i - 1] += int(sent[i - 1] != text[j - 1])
            i, j = i - 1, j - 1
        elif i and here == rows[i - 1, j] + 1:
            costs[i - 1] += 1
            i -= 1
        else:
            costs[min(i, n - 1)] += 1
            j -= 1
    return costs


def tables(done: Sequence[Done]) -> list[Table]:
    """Return CER by recording and thinning."""
    rows = []
    for (name, thinning, amount), some in contest.grouped(done, "recording", "thinning", "amount").items():
        figures, found = {}, {}
        for arm in ARMS:
            parts = [np.array(one.counts["blocks"], np.int64) for one in some if one["arms"] == [arm]]
            if parts:
                found[arm] = np.concatenate(parts)
                figures[arm] = Figure.of(share(found[arm][:, 1], found[arm][:, 0]))
        ours = found.pop("ours", None)
        # Errors, not what is right: worse is more.
        worse = "" if ours is None else worse_than(_right(ours), {arm: _right(one) for arm, one in found.items()})
        left = f"{amount:.0%} at random" if thinning == "at random" else f"first {amount:.0f} of a burst"
        sent = sum(one.counts["sent"] for one in some if one["arms"] == ["ours"])
        runs = sum(one["arms"] == ["ours"] for one in some)
        quoted = QUOTED[name] if (thinning, amount) == ("at random", 1.0) else "-"
        rows.append(Row(f"{name}, {left}", quoted, figures, worse, f"{sent} characters, {runs} runs", "recording"))
    note = (
        "CER of the whole pass; `paper`: its polarity windows before the layout of a character. Tuned: in hindsight, on"
        " what is read. *Worse* tells the difference of the characters without an error."
    )
    return [Table("Character error rate over thinning", ARMS, rows, note)]


def _right(blocks: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    return np.stack([blocks[:, 0], blocks[:, 0] - blocks[:, 1]], axis=1)


def panels(done: Sequence[Done]) -> list[Panel]:
    """Return CER over the share of the events that is left, a panel a recording."""
    out = []
    for (name,), some in contest.grouped(done, "recording").items():
        curves = []
        for arm in ARMS:
            mine = [one for one in some if one["arms"] == [arm] and one["thinning"] == "at random"]
            curve = Curve(arm, [], [])
            for (amount,), each in sorted(contest.grouped(mine, "amount").items()):
                blocks = np.concatenate([np.array(one.counts["blocks"], np.int64) for one in each])
                found = share(blocks[:, 1], blocks[:, 0])
                curve.x.append(amount)
                curve.y.append(found.value)
                curve.low.append(found.low)
                curve.high.append(found.high)
            curves.append(curve)
        out.append(Panel(name, "share of the events, at random", "CER", curves, log_x=True))
    return out


STUDY: Final = Study(
    name="recordings",
    version=1,
    title="Recordings of a real beacon, thinned",
    about=(
        "Z. Wang, Y. Ng, J. Henderson, R. Mahony, *Smart visual beacons with asynchronous optical communications using"
        " event cameras*, IROS 2022: recordings for academic use only, not shipped; two outdoor recordings of a text,"
        " at 100 m and 504 bit/s, at 30 m and 3125 bit/s. Receivers alone, told protocol and nominal bit rate."
        " Development data: ours was built while looking at them; they say nothing about tracking or other light."
    ),
    preset="recorded",
    evidence="recording",
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
    missing=missing,
)
