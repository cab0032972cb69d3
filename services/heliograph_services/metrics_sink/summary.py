"""Reading the metrics file: counts added over a run, then divided, always with n and an interval.

MAR_sent = right / sent, MAR_received = right / (right + wrong + insertions), BAR = right bits / bits sent,
FER = 1 - MAR_sent(visible), BER = wrong bits / bits of matched frames, CER = (wrong + missing + insertions) /
characters sent, and goodput = data bits of right frames / visible time that counts. The interval is a bootstrap over
blocks of one beacon and one second, since errors come in bursts; where all blocks agree, so that it has no width, the
bound says what k blocks without the opposite can exclude: 1 - 0.05^(1/k).
"""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from heliograph_services.metrics_sink.schema import open_read

RESAMPLES: Final = 1000
# More blocks than this are merged, neighbours in time first: the interval then errs to the wide side.
BLOCKS_LIMIT: Final = 1024
SEED: Final = 1
HOUR_US: Final = 3_600_000_000


class Ratio(msgspec.Struct, frozen=True):
    """right / n with the lower and upper end of its 95 % interval; None where n is 0."""

    right: int
    n: int
    value: float | None
    low: float | None
    high: float | None


class Acquisition(msgspec.Struct, frozen=True):
    """Times from the first visible bit to the first right identification, over all intervals of at least a second.

    Args:
        intervals: how many.
        median_ms: over all, those that were never acquired counting as longest; None where that is most of them.
        p95_ms: likewise.
        never_in_1_s: the share not acquired within a second.
    """

    intervals: int
    median_ms: float | None
    p95_ms: float | None
    never_in_1_s: float | None


class Accuracy(msgspec.Struct, frozen=True):
    """Accuracy against the truth; see the module and docs/metrics.md. `goodput_bit_s` is a mean over the beacons."""

    mar_visible: Ratio
    mar_in_view: Ratio
    mar_received: Ratio
    mar_close: Ratio
    bar: Ratio
    bar_by_chance: float | None
    fer: Ratio
    ber: Ratio
    goodput_bit_s: float | None
    cer: dict[str, float]
    judged: int
    false_alarms: int
    confusions: int
    false_alarms_per_camera_hour: float | None
    false_alarms_per_track_hour: float | None
    first: Acquisition
    again: Acquisition


class Sighting(msgspec.Struct, frozen=True):
    """An identified beacon from acceptance to loss; the row of rows.SightingRow without its places."""

    camera: str
    track: str
    beacon: str
    protocol: str
    first_us: int
    last_us: int
    frames: int
    ended: bool


class Summary(msgspec.Struct, frozen=True):
    """What one run of the sink has seen. `accuracy` is None where no truth was there; then `mar_estimated` is all."""

    file: str
    run: int
    boot: str
    seconds: int
    cameras: list[str]
    frames: int
    characters: int
    refused: dict[str, int]
    identified: dict[str, int]
    late: int
    missing: dict[str, int]
    dropped: dict[str, int]
    mar_estimated: float | None
    accuracy: Accuracy | None
    sightings: list[Sighting]


class _Counts:
    """The counts of a run, by kind (the word before the slash)."""

    def __init__(self, rows: list[tuple[int, int, str, int]]) -> None:
        self.total: dict[str, int] = defaultdict(int)
        self.by_kind: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
        self._blocks: dict[str, dict[tuple[str, int, int], int]] = defaultdict(dict)
        for stream, second, name, n in rows:
            kind, _, what = name.partition("/")
            self.total[kind] += n
            self.by_kind[kind][what] += n
            self._blocks[kind][what, stream, second] = n

    def ratio(self, right: str, sent: str) -> Ratio:
        """Return right / sent over blocks of the things that `sent` counts."""
        keys = sorted(self._blocks[sent])
        return ratio_of(
            np.array([self._blocks[right].get(key, 0) for key in keys], np.int64),
            np.array([self._blocks[sent][key] for key in keys], np.int64),
        )

    def received(self) -> Ratio:
        """Return right / published, over seconds."""
        kinds = ("right", "wrong", "insertions")
        keys = sorted({key for kind in kinds for key in self._blocks[kind]})
        columns = [np.array([self._blocks[kind].get(key, 0) for key in keys], np.int64) for kind in kinds]
        return ratio_of(columns[0], columns[0] + columns[1] + columns[2])


def ratio_of(right: np.ndarray[Any, np.dtype[np.int64]], sent: np.ndarray[Any, np.dtype[np.int64]]) -> Ratio:
    """Return a ratio of sums with its interval.

    Args:
        right: (k,) int64, the right ones of each block.
        sent: (k,) int64, all of each block.
    """
    total, n = int(right.sum()), int(sent.sum())
    if n == 0:
        return Ratio(total, n, None, None, None)
    blocks = len(sent)
    if blocks > BLOCKS_LIMIT:
        starts = np.unique(np.linspace(0, blocks, BLOCKS_LIMIT, endpoint=False).astype(np.int64))
        right, sent = np.add.reduceat(right, starts), np.add.reduceat(sent, starts)
        blocks = len(sent)
    generator = np.random.Generator(np.random.Philox(SEED))
    picks = generator.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=RESAMPLES)
    draws, sizes = picks @ right, picks @ sent
    ratios = draws[sizes > 0] / sizes[sizes > 0]
    low, high = (float(q) for q in np.quantile(ratios, [0.025, 0.975]))
    value = total / n
    slack = 1.0 - 0.05 ** (1.0 / blocks)
    low = min(low, 1.0 - slack) if total == n else low
    high = max(high, slack) if total == 0 else high
    return Ratio(total, n, value, low, high)


def summarise(path: str | Path, run: int | None = None) -> Summary:
    """Return what a run has seen; by default the newest.

    Raises:
        FileError: the file is missing, or no metrics file of this version.
    """
    connection = open_read(Path(path))
    try:
        return _summarise(connection, str(path), run)
    finally:
        connection.close()


def summary(path: str | Path) -> dict[str, Any]:
    """Return the newest run as plain values, for JSON.

    Raises:
        FileError: as `summarise`.
    """
    plain: dict[str, Any] = msgspec.to_builtins(summarise(path))
    return plain


def _summarise(connection: sqlite3.Connection, path: str, run: int | None) -> Summary:
    newest = connection.execute(
        "SELECT id, boot FROM run WHERE id = ifnull(?, (SELECT max(id) FROM run))", (run,)
    ).fetchone()
    run_id, boot = newest if newest is not None else (0, "")
    rows = connection.execute(
        "SELECT c.stream, c.second, n.text, c.n FROM count c JOIN name n ON n.id = c.name"
        " JOIN stream s ON s.id = c.stream WHERE s.run = ?",
        (run_id,),
    ).fetchall()
    counts = _Counts(rows)
    estimates = counts.total["mar_estimates"]
    has_truth = any(counts.total[kind] for kind in ("sent_visible", "sent_in_view", "right", "wrong", "judged"))
    return Summary(
        file=path,
        run=run_id,
        boot=boot,
        seconds=len({(stream, second) for stream, second, _, _ in rows}),
        cameras=[
            name
            for (name,) in connection.execute("SELECT DISTINCT camera FROM stream WHERE run = ? ORDER BY 1", (run_id,))
        ],
        frames=counts.total["frames"],
        characters=counts.total["characters"],
        refused=dict(sorted(counts.by_kind["refused"].items())),
        identified=dict(sorted(counts.by_kind["identified"].items())),
        late=counts.total["late"] + counts.total["late_frames"],
        missing=_health(connection, run_id, "missing: "),
        dropped=_health(connection, run_id, "dropped: "),
        mar_estimated=counts.total["mar_estimate_ppm"] / estimates / 1e6 if estimates else None,
        accuracy=_accuracy(connection, run_id, counts) if has_truth else None,
        sightings=_sightings(connection, run_id),
    )


def _accuracy(connection: sqlite3.Connection, run_id: int, counts: _Counts) -> Accuracy:
    bits = counts.total["bits_visible"]
    alarms = counts.total["false_alarms"]
    visible_us = counts.total["visible_us"]
    mar_visible = counts.ratio("right_visible", "sent_visible")
    return Accuracy(
        mar_visible=mar_visible,
        mar_in_view=counts.ratio("right_in_view", "sent_in_view"),
        mar_received=counts.received(),
        mar_close=counts.ratio("right_close", "sent_close"),
        bar=counts.ratio("bits_right", "bits_visible"),
        bar_by_chance=counts.total["bits_chance_milli"] / 1000 / bits if bits else None,
        fer=_rest(mar_visible),
        ber=_rest(counts.ratio("bits_right", "bits_matched")),
        goodput_bit_s=counts.total["payload_bits"] * 1e6 / visible_us if visible_us else None,
        cer=_character_errors(counts),
        judged=counts.total["judged"],
        false_alarms=alarms,
        confusions=counts.total["confusions"],
        false_alarms_per_camera_hour=_per_hour(alarms, counts.total["observed_us"]),
        false_alarms_per_track_hour=_per_hour(alarms, counts.total["track_us"]),
        first=_acquisition(connection, run_id, None),
        # Half a second without sight, as docs/metrics.md has it; shorter breaks are part of ordinary reading.
        again=_acquisition(connection, run_id, 500_000),
    )


def _rest(of: Ratio) -> Ratio:
    """Return the share of all others: its `right` are the wrong ones."""
    if of.value is None or of.low is None or of.high is None:
        return of
    return Ratio(of.n - of.right, of.n, 1.0 - of.value, 1.0 - of.high, 1.0 - of.low)


def _per_hour(n: int, exposure_us: int) -> float | None:
    return n * HOUR_US / exposure_us if exposure_us else None


def _character_errors(counts: _Counts) -> dict[str, float]:
    """Return CER of each text protocol: characters are matched by slot, so wrong = S, missing = D, insertions = I."""
    found = {}
    for protocol, sent in sorted(counts.by_kind["sent_text"].items()):
        if sent:
            missing = sent - counts.by_kind["right_text"][protocol] - counts.by_kind["wrong_text"][protocol]
            errors = counts.by_kind["wrong_text"][protocol] + missing + counts.by_kind["insertions"][protocol]
            found[protocol] = errors / sent
    return found


def _acquisition(connection: sqlite3.Connection, run_id: int, occluded_us: int | None) -> Acquisition:
    """Return the times of first appearances (None) or of those after at least so long out of sight."""
    rows = connection.execute(
        "SELECT a.acquired_us FROM acquisition a JOIN stream s ON s.id = a.stream WHERE s.run = ?1"
        " AND a.lasted_us >= 1000000 AND iif(?2 IS NULL, a.occluded_us IS NULL, a.occluded_us >= ?2)",
        (run_id, occluded_us),
    ).fetchall()
    times = np.sort(np.array([np.inf if acquired is None else acquired for (acquired,) in rows], np.float64))
    if not len(times):
        return Acquisition(0, None, None, None)
    late = float(np.mean(times > 1_000_000))
    return Acquisition(len(times), _order_ms(times, 0.5), _order_ms(times, 0.95), late)


def _order_ms(times: np.ndarray[Any, np.dtype[np.float64]], share: float) -> float | None:
    """Return the order statistic that `share` of the times do not exceed; an infinite one is None."""
    at = times[min(len(times) - 1, int(np.ceil(share * len(times))) - 1)]
    return float(at) / 1000 if np.isfinite(at) else None


def _health(connection: sqlite3.Connection, run_id: int, prefix: str) -> dict[str, int]:
    """Return the counters of all processes whose names begin so, added by what follows."""
    rows = connection.execute(
        "SELECT substr(name, ?), sum(value) FROM health WHERE run = ? AND substr(name, 1, ?) = ? GROUP BY 1 ORDER BY 1",
        (len(prefix) + 1, run_id, len(prefix), prefix),
    )
    return {name: int(value) for name, value in rows if value}


def _sightings(connection: sqlite3.Connection, run_id: int) -> list[Sighting]:
    rows = connection.execute(
        "SELECT s.camera, g.track, g.beacon, g.protocol, g.first_us, g.last_us, g.frames, g.ended FROM sighting g"
        " JOIN stream s ON s.id = g.stream WHERE s.run = ? ORDER BY s.camera, s.epoch, g.first_us, g.track",
        (run_id,),
    )
    return [
        Sighting(camera, track, beacon, protocol, first_us, last_us, frames, bool(ended))
        for camera, track, beacon, protocol, first_us, last_us, frames, ended in rows
    ]
