"""Reading the metrics file: counts added over a run, then divided, always with n and an interval.

The ratios are those of `heliograph.accuracy`, over the blocks of `tallies`; more than `BLOCKS_LIMIT` blocks are merged,
neighbours in time first, so that the interval errs to the wide side.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from heliograph.accuracy import (
    bit_errors,
    bits_right,
    character_errors,
    frame_errors,
    goodput_bit_s,
    mar_received,
    mar_sent,
)
from heliograph.errors import FileError
from heliograph.shares import Share, merged, most_events, upper_bound
from heliograph_services.metrics_sink.schema import open_read
from heliograph_services.metrics_sink.tallies import Counts, Span, Tallies, process_numbers, process_series, span_of

BLOCKS_LIMIT: Final = 1024
HOUR_US: Final = 3_600_000_000
# The kinds of counters whose blocks the ratios need.
_BLOCKED: Final = (
    *(f"{what}_{group}" for what in ("sent", "right", "wrong") for group in ("visible", "in_view", "close", "text")),
    *("right", "wrong", "insertions", "bits_visible", "bits_right", "bits_matched", "payload_bits", "visible_us"),
)


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
    """Accuracy against the truth; see docs/metrics.md.

    `goodput_bit_s` is a mean over the beacons; `cer` is by protocol, its `right` the errors. `..._at_most`: the upper
    95 % bound (false alarms: Poisson; confusions: Clopper and Pearson, an identification judged).
    """

    mar_visible: Ratio
    mar_in_view: Ratio
    mar_received: Ratio
    mar_close: Ratio
    bar: Ratio
    bar_by_chance: float | None
    fer: Ratio
    ber: Ratio
    goodput_bit_s: float | None
    cer: dict[str, Ratio]
    judged: int
    false_alarms: int
    confusions: int
    false_alarms_per_camera_hour: float | None
    false_alarms_per_camera_hour_at_most: float | None
    false_alarms_per_track_hour: float | None
    false_alarms_per_track_hour_at_most: float | None
    confusions_at_most: float | None
    first: Acquisition
    again: Acquisition


class Hop(msgspec.Struct, frozen=True):
    """How long n messages took over a hop of a process: the mean of its seconds' p50, their greatest p95 and p99."""

    process: str
    hop: str
    n: int
    p50_ms: float
    p95_ms: float
    p99_ms: float


class Load(msgspec.Struct, frozen=True):
    """A process: the most that waited in its queues in a second, and its greatest share of a core."""

    process: str
    queue_most: int
    cpu_share_most: float


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
    """What one run of the sink has seen. `accuracy` is None where no truth was there; then `mar_estimated` is all.

    `late` messages came after their second was settled; `late_frames`, which they held, are in no other count.
    `block_s` is the length of the blocks of the intervals; `rates` are messages published a second of a process's life,
    by process and topic.
    """

    file: str
    run: int
    boot: str
    seconds: int
    block_s: int
    cameras: list[str]
    frames: int
    characters: int
    refused: dict[str, int]
    identified: dict[str, int]
    late: int
    late_frames: int
    missing: dict[str, int]
    dropped: dict[str, int]
    rates: dict[str, float]
    hops: list[Hop]
    loads: list[Load]
    mar_estimated: float | None
    accuracy: Accuracy | None
    sightings: list[Sighting]


def summarise(path: str | Path, run: int | None = None, last_s: float | None = None) -> Summary:
    """Return what a run has seen; by default the newest, and all of it.

    Args:
        path: the file.
        run: which start of the sink.
        last_s: only the last seconds by the host's clock, to a whole minute.

    Raises:
        FileError: the file is missing, damaged, or no metrics file of this version; there is no such run.
    """
    connection = open_read(Path(path))
    try:
        return _summarise(connection, str(path), span_of(connection, run, last_s))
    except sqlite3.Error as error:
        raise FileError(f"{path}: cannot be read as a metrics file: {error}") from None
    finally:
        connection.close()


def summary(path: str | Path) -> dict[str, Any]:
    """Return the newest run as plain values, for JSON.

    Raises:
        FileError: as `summarise`.
    """
    plain: dict[str, Any] = msgspec.to_builtins(summarise(path))
    return plain


def _summarise(connection: sqlite3.Connection, path: str, span: Span) -> Summary:
    counts = Tallies(connection, span, _BLOCKED)
    levels = process_series(connection, span, "level")
    estimates = counts.total["mar_estimates"]
    has_truth = any(counts.total[kind] for kind in ("sent_visible", "sent_in_view", "right", "wrong", "judged"))
    cameras = connection.execute("SELECT DISTINCT camera FROM stream WHERE run = ? ORDER BY 1", (span.run,))
    return Summary(
        file=path,
        run=span.run,
        boot=span.boot,
        seconds=counts.total["seconds"],
        block_s=span.block_s,
        cameras=[name for (name,) in cameras],
        frames=counts.total["frames"],
        characters=counts.total["characters"],
        refused=dict(sorted(counts.by_kind["refused"].items())),
        identified=dict(sorted(counts.by_kind["identified"].items())),
        late=counts.total["late"],
        late_frames=counts.total["late_frames"],
        missing=process_numbers(connection, span, "missing: "),
        dropped=process_numbers(connection, span, "dropped: "),
        rates=_rates(connection, span, levels),
        hops=_hops(connection, span),
        loads=_loads(levels),
        mar_estimated=counts.total["mar_estimate_ppm"] / estimates / 1e6 if estimates else None,
        accuracy=_accuracy(connection, span, counts) if has_truth else None,
        sightings=_sightings(connection, span),
    )


def _accuracy(connection: sqlite3.Connection, span: Span, counts: Tallies) -> Accuracy:
    total = counts.total
    bits, alarms = total["bits_visible"], total["false_alarms"]
    visible = _blocks(counts.columns("sent_visible", "right_visible", "sent_visible"))
    in_view = _blocks(counts.columns("sent_in_view", "right_in_view", "sent_in_view"))
    close = _blocks(counts.columns("sent_close", "right_close", "sent_close"))
    sent_bits = _blocks(counts.columns("bits_visible", "bits_right", "bits_visible"))
    matched = _blocks(counts.columns("bits_matched", "bits_right", "bits_matched"))
    payload = _blocks(counts.columns("visible_us", "payload_bits", "visible_us"))
    received = _blocks(counts.all_columns("right", "wrong", "insertions"))
    goodput = goodput_bit_s(payload[0], payload[1])
    return Accuracy(
        mar_visible=_ratio(mar_sent(*visible), visible[0]),
        mar_in_view=_ratio(mar_sent(*in_view), in_view[0]),
        mar_received=_ratio(mar_received(*received), received[0]),
        mar_close=_ratio(mar_sent(*close), close[0]),
        bar=_ratio(bits_right(*sent_bits), sent_bits[0]),
        bar_by_chance=total["bits_chance_milli"] / 1000 / bits if bits else None,
        fer=_ratio(frame_errors(*visible), visible[1] - visible[0]),
        ber=_ratio(bit_errors(*matched), matched[1] - matched[0]),
        goodput_bit_s=goodput.value if goodput.n else None,
        cer={name: _character_errors(counts, name) for name, n in sorted(counts.by_kind["sent_text"].items()) if n},
        judged=total["judged"],
        false_alarms=alarms,
        confusions=total["confusions"],
        false_alarms_per_camera_hour=_per_hour(alarms, total["observed_us"]),
        false_alarms_per_camera_hour_at_most=_per_hour(most_events(alarms), total["observed_us"]),
        false_alarms_per_track_hour=_per_hour(alarms, total["track_us"]),
        false_alarms_per_track_hour_at_most=_per_hour(most_events(alarms), total["track_us"]),
        confusions_at_most=upper_bound(total["confusions"], total["judged"]) if total["judged"] else None,
        first=_acquisition(connection, span, None),
        # Half a second without sight, as docs/metrics.md has it; shorter breaks are part of ordinary reading.
        again=_acquisition(connection, span, 500_000),
    )


def _blocks(columns: Counts) -> Counts:
    return merged(columns, BLOCKS_LIMIT)


def _ratio(found: Share, part: Counts) -> Ratio:
    """Return a share as it is shown; its numerator is the sum of `part`."""
    if not found.n:
        return Ratio(int(part.sum()), 0, None, None, None)
    return Ratio(int(part.sum()), found.n, found.value, found.low, found.high)


def _character_errors(counts: Tallies, protocol: str) -> Ratio:
    """Return CER of a text protocol: characters are matched by slot, so wrong = S, missing = D, insertions = I."""
    right, inserted, sent = _blocks(counts.all_columns("right_text", "insertions", "sent_text", what=protocol))
    return _ratio(character_errors(right, inserted, sent), sent - right + inserted)


def _per_hour(n: float, exposure_us: int) -> float | None:
    return n * HOUR_US / exposure_us if exposure_us else None


def _rates(connection: sqlite3.Connection, span: Span, levels: list[tuple[Any, ...]]) -> dict[str, float]:
    """Return messages published a second, by "process topic"; a process reports once a second."""
    prefix = "published: "
    seconds = {process: n for process, name, _, n in levels if name == "cpu_share"}
    rows = process_series(connection, span, "rate")
    return {
        f"{process} {name.removeprefix(prefix)}": round(n / seconds[process], 3)
        for process, name, n in rows
        if name.startswith(prefix) and process in seconds
    }


def _hops(connection: sqlite3.Connection, span: Span) -> list[Hop]:
    rows = process_series(connection, span, "hop")
    return [Hop(p, hop, n, *(round(us / 1000, 3) for us in (p50, p95, p99))) for p, hop, n, p50, p95, p99 in rows]


def _loads(levels: list[tuple[Any, ...]]) -> list[Load]:
    most: dict[str, dict[str, float]] = {}
    for process, name, value, _ in levels:
        most.setdefault(process, {})[name] = value
    return [Load(p, int(of.get("queue", 0)), round(of.get("cpu_share", 0.0), 4)) for p, of in sorted(most.items())]


def _acquisition(connection: sqlite3.Connection, span: Span, occluded_us: int | None) -> Acquisition:
    """Return the times of first appearances (None) or of those after at least so long out of sight."""
    rows = connection.execute(
        "SELECT a.acquired_us FROM acquisition a JOIN stream s ON s.id = a.stream WHERE s.run = ?1"
        " AND a.wall_s >= ?3 AND a.lasted_us >= 1000000"
        " AND iif(?2 IS NULL, a.occluded_us IS NULL, a.occluded_us >= ?2)",
        (span.run, occluded_us, span.since_wall_s),
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


def _sightings(connection: sqlite3.Connection, span: Span) -> list[Sighting]:
    rows = connection.execute(
        "SELECT s.camera, g.track, g.beacon, g.protocol, g.first_us, g.last_us, g.frames, g.ended FROM sighting g"
        " JOIN stream s ON s.id = g.stream WHERE s.run = ? AND g.wall_s >= ?"
        " ORDER BY s.camera, s.epoch, g.first_us, g.track",
        (span.run, span.since_wall_s),
    )
    return [
        Sighting(camera, track, beacon, protocol, first_us, last_us, frames, bool(ended))
        for camera, track, beacon, protocol, first_us, last_us, frames, ended in rows
    ]
