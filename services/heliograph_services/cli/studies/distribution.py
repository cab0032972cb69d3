"""Study 9: the tracker elsewhere: real processes, a radio link between tracker and decoder, cuts of that link.

The scene (simulated before, played at real time): four beacons on ellipses at up to .5 m/s, with new payloads for
every frame, give MAR; twelve that are switched on for .8 s at random instants, each with a payload of its own, give the
acquisition time: from the first edge to the arrival, at a client on the camera's host, of the first right
identification. All links see the same scenes. Processes, client and proxy share this host's processors, so times are
those of this machine and its load: `source late` says how far the source itself was behind real time, `dropped` what a
process that was too slow dropped in its full queues, and so could not read; `decoder` what it takes of a core.

    MAR_sent       K = 1, as the client heard it (docs/metrics.md)
    acquisition    median and p95; what was never identified counts as later than all
    latency        end of a frame to the client, and a track's instant to the client: median and p95, from counts in
                   bins of 5 %
    bytes          what was published across the link, and what the proxy counted; their ratio is to be 1 +- .05

With a cut the ratio says nothing: what is published then does not cross. Intervals reach from run to run
(`run_figures`): what is in one run shares the machine's load of that minute.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from heliograph.errors import ConfigError
from heliograph_services.cli.studies import run_figures
from heliograph_services.cli.studies.appearances import ON_S
from heliograph_services.cli.studies.distribution_scene import SENSOR, Scene, scene
from heliograph_services.cli.studies.link_runs import Heard, Link, play
from heliograph_services.cli.studies.study import (
    Cell,
    Counts,
    Curve,
    Done,
    Evidence,
    Figure,
    Panel,
    Parameters,
    Row,
    Size,
    Study,
    Table,
)
from heliograph_services.cli.studies.verdicts import RIGHT, Sent, verdicts
from heliograph_services.event_source.cameras.formats.npz import write_npz

# Of the beacons: five scans a bit. At twice this rate the decoder reads scan by scan, which took most of a core, and
# the study told of whatever else the machine did.
BIT_RATE: Final = 1_000
EVIDENCE: Final[Evidence] = "simulated light, real processes"
LINK_BIT_RATES: Final = (0.5e6, 2e6, 10e6)
DELAYS_MS: Final = (5.0, 50.0, 200.0)
# The radio of the shipped site.
CUT_RATE, CUT_DELAY_MS, CUT_AT_S = 2e6, 50.0, 4.0
CUTS_S: Final = (0.5, 2.0, 5.0)
SECONDS_S: Final = 12.0
RUNS: Final = 3
# A region's centre is within a pixel or two; the next beacon is 90 px away.
MATCH_PX: Final = 10.0


def cells(size: Size) -> list[Parameters]:
    """Return all cells: link, run; the scene of a run is simulated once for all links."""
    if size == "quick":
        return [_cell(link, 0, 6.0) for link in (None, _link(2e6, 50.0))]
    links = [None, *(_link(rate, delay_ms) for rate in LINK_BIT_RATES for delay_ms in DELAYS_MS)]
    links += [_link(CUT_RATE, CUT_DELAY_MS, cut_s) for cut_s in CUTS_S]
    return [_cell(link, run, SECONDS_S) for run in range(RUNS) for link in links]


def _link(rate: float, delay_ms: float, cut_s: float = 0.0) -> Parameters:
    return {"bit_rate": rate, "delay_ms": delay_ms, "cut_s": cut_s}


def _cell(link: Parameters | None, run: int, seconds: float) -> Parameters:
    return {"link": link, "run": run, "seconds": seconds}


def run(cell: Cell) -> Counts:
    """Run a cell."""
    one = cell.parameters
    seen = scene(cell.seed, float(one["seconds"]), BIT_RATE)
    told = one["link"]
    link = None
    if told is not None:
        at_s = CUT_AT_S if told["cut_s"] else math.inf
        link = Link(told["bit_rate"], told["delay_ms"] / 1e3, at_s, told["cut_s"])
    with tempfile.TemporaryDirectory(prefix="heliograph-study-") as name:
        file = Path(name) / "scene.npz"
        write_npz(file, *SENSOR, [seen.events])
        heard = play(file, "seed11", float(BIT_RATE), link, Path(name))
    return counts(seen, heard, float(one["seconds"]))


def counts(seen: Scene, heard: Heard, seconds: float) -> Counts:
    """Return what came of a run.

    Raises:
        ConfigError: nothing was heard.
    """
    if math.isinf(heard.origin_s):
        raise ConfigError("nothing was heard of the source")
    zero_s = heard.origin_s
    frames = [(at_s - t_us / 1e6 - zero_s, t_us) for at_s, one in heard.frames for t_us in one.t_us]
    tracks = [(at_s - as_of_us / 1e6 - zero_s, as_of_us) for at_s, as_of_us in heard.tracks]
    found = verdicts(seen.sent, [one for _, one in heard.frames], seen.paths)
    return {
        "blocks": {"ours": blocks(seen.sent, found.outcome)},
        "acquired_ms": acquired_ms(seen, heard),
        "frame_ms": run_figures.histogram(frames),
        "track_ms": run_figures.histogram(tracks),
        "published": heard.published,
        "crossed": heard.crossed,
        "records": heard.records,
        "refused": heard.refused,
        "dropped": sum(heard.dropped.values()),
        "decoder_share": decoder_share(heard, seconds),
        "late_p99_ms": round(1e3 * (float(np.quantile(heard.late_s, 0.99)) - zero_s), 2),
        "seconds": seconds,
    }


def acquired_ms(seen: Scene, heard: Heard) -> list[float | None]:
    """Return, for each appearance, when its first right identification arrived; None: never."""
    accepted = [(at_s, m) for at_s, m in heard.identities if m.change in {"accepted", "changed"} and not m.lost]
    out: list[float | None] = []
    for t_us, payload, x_px, y_px in seen.appearances:
        arrived_us = [
            (at_s - heard.origin_s) * 1e6
            for at_s, m in accepted
            if m.payload == payload
            and math.hypot(m.x_px - x_px, m.y_px - y_px) <= MATCH_PX
            and t_us < m.since_us < t_us + ON_S * 1e6
        ]
        out.append(round((min(arrived_us) - t_us) / 1e3, 1) if arrived_us else None)
    return out


def decoder_share(heard: Heard, seconds: float) -> list[float]:
    """Return what the decoder took of a core in each second that lay within the recording."""
    return [share for at_s, share in heard.decoder_share if 1.0 <= at_s - heard.origin_s <= seconds]


def blocks(sent: Sent, outcome: npt.NDArray[np.int8]) -> list[list[int]]:
    """Return beacon, second, frames sent, frames read right, of the frames that count."""
    of = sent.visible
    key = np.stack([sent.beacon[of], sent.t1_us[of] // 1_000_000], axis=1)
    names, at = np.unique(key, axis=0, return_inverse=True)
    n = np.bincount(at.reshape(-1), minlength=len(names))
    right = np.bincount(at.reshape(-1), outcome[of] == RIGHT, len(names)).astype(np.int64)
    return [[*map(int, name), int(a), int(b)] for name, a, b in zip(names, n, right, strict=True)]


def name_of(link: Parameters | None) -> str:
    """Return a link in words."""
    if link is None:
        return "one host"
    cut = f", cut for {link['cut_s']:g} s" if link["cut_s"] else ""
    return f"{link['bit_rate'] / 1e6:g} Mbit/s, {link['delay_ms']:g} ms{cut}"


def by_link(done: Sequence[Done]) -> dict[str, list[Done]]:
    """Return cells by link, in their order."""
    out: dict[str, list[Done]] = {}
    for one in done:
        out.setdefault(name_of(one["link"]), []).append(one)
    return out


def mar(done: Sequence[Done]) -> Figure:
    """Return MAR_sent."""
    return run_figures.of_runs([np.array(one.counts["blocks"]["ours"], np.int64).reshape(-1, 4)[:, 2:] for one in done])


def acquired(done: Sequence[Done], q: float) -> Figure:
    """Return a quantile of the acquisition times, ms."""
    return run_figures.acquisition([one.counts["acquired_ms"] for one in done], q)


def never(done: Sequence[Done]) -> Figure:
    """Return the share of appearances that were never identified."""
    runs = [[[1, ms is None] for ms in one.counts["acquired_ms"]] for one in done]
    return run_figures.of_runs([np.array(run, np.int64).reshape(-1, 2) for run in runs])


FOUND: Final = ("MAR_sent", "acquired: median", "acquired: p95", "never acquired")
TIMES: Final = ("frame: median", "frame: p95", "track: median", "track: p95", "source late: p99", "dropped", "decoder")
BYTES: Final = ("published", "crossed", "crossed / published")


def tables(done: Sequence[Done]) -> list[Table]:
    """Return accuracy and acquisition, latencies, bytes."""
    found, times, passed = list[Row](), list[Row](), list[Row]()
    for name, some in by_link(done).items():
        accuracy = mar(some)
        wanted = sum(len(one.counts["acquired_ms"]) for one in some)
        figures = {
            FOUND[0]: accuracy,
            FOUND[1]: acquired(some, 0.5),
            FOUND[2]: acquired(some, 0.95),
            FOUND[3]: never(some),
        }
        n = f"{accuracy.n} frames, {wanted} appearances, {len(some)} runs"
        found.append(Row(name, "-", figures, "", n, EVIDENCE))
        late = max(one.counts["late_p99_ms"] for one in some)
        late_of = {label: run_figures.latency([o.counts[kind] for o in some], q) for label, kind, q in _LATENCIES}
        n = f"{late_of[TIMES[0]].n} frames, {late_of[TIMES[2]].n} tracks messages, {len(some)} runs"
        dropped = Figure(sum(one.counts["dropped"] for one in some), unit="messages")
        shares = [one.counts["decoder_share"] for one in some if one.counts["decoder_share"]]
        core = run_figures.quotient([sum(one) for one in shares], [len(one) for one in shares], 3, "core")
        of_all = {**late_of, TIMES[4]: Figure(late, unit="ms"), TIMES[5]: dropped, TIMES[6]: core}
        times.append(Row(name, "-", of_all, "", n, EVIDENCE))
        if some[0]["link"] is not None:
            passed.append(_bytes(name, some))
    cut = "A cut goes with 2 Mbit/s and 50 ms, 4 s after the scene's beginning."
    return [
        Table("Accuracy and acquisition", FOUND, found, f"{cut} A p95 without a value: more than 5 % never."),
        Table(
            "Latency at a client on the camera's host",
            TIMES,
            times,
            "Bins of 5 %; source late: the worst run's; dropped: by tracker and decoder, in their full queues; decoder:"
            " the mean of its seconds.",
        ),
        Table(
            "Bytes between tracker and the camera's host",
            BYTES,
            passed,
            "Published: records with envelope, key and encoding, counted by a client without the link; crossed: the"
            " proxy's count, with what Zenoh adds. What is published during a cut does not cross.",
        ),
    ]


_LATENCIES: Final = (
    (TIMES[0], "frame_ms", 0.5),
    (TIMES[1], "frame_ms", 0.95),
    (TIMES[2], "track_ms", 0.5),
    (TIMES[3], "track_ms", 0.95),
)


def _bytes(name: str, some: Sequence[Done]) -> Row:
    published, crossed, seconds = ([one.counts[name] for one in some] for name in ("published", "crossed", "seconds"))
    ms = [1e3 * one for one in seconds]
    ratios = [one / whole for one, whole in zip(crossed, published, strict=True)]
    figures = {
        BYTES[0]: run_figures.quotient(published, ms, 2, "kB/s"),
        BYTES[1]: run_figures.quotient(crossed, ms, 2, "kB/s"),
        BYTES[2]: run_figures.quotient(crossed, published, 4),
    }
    each = f"{min(ratios):.3f} to {max(ratios):.3f}"
    records = sum(one.counts["records"] for one in some)
    return Row(name, "-", figures, "", f"{records} records, {len(some)} runs, ratio {each}", EVIDENCE)


def panels(done: Sequence[Done]) -> list[Panel]:
    """Return MAR and acquisition over the delay, a curve a bit rate."""
    whole = [one for one in done if one["link"] is not None and not one["link"]["cut_s"]]
    host = [one for one in done if one["link"] is None]
    what: list[tuple[str, str, Callable[[Sequence[Done]], Figure]]] = [
        ("MAR_sent", "MAR_sent", mar),
        ("acquisition", "median, ms", lambda some: acquired(some, 0.5)),
    ]
    out = []
    for title, label, figure_of in what:
        curves = []
        for rate in sorted({one["link"]["bit_rate"] for one in whole}):
            curve = Curve(f"{rate / 1e6:g} Mbit/s", [], [])
            for delay_ms in sorted({one["link"]["delay_ms"] for one in whole}):
                some = [o for o in whole if (o["link"]["bit_rate"], o["link"]["delay_ms"]) == (rate, delay_ms)]
                found = figure_of(some) if some else Figure(None)
                if found.value is not None:
                    curve.x.append(delay_ms)
                    curve.y.append(found.value)
                    curve.low.append(found.value if found.low is None else found.low)
                    curve.high.append(found.value if found.high is None else found.high)
            curves.append(curve)
        alone = figure_of(host) if host else Figure(None)
        if alone.value is not None:
            curves.append(Curve("one host", [0.0], [alone.value]))
        out.append(Panel(title, "delay each way, ms", label, curves))
    return out


STUDY: Final = Study(
    name="distribution",
    version=3,
    title="The tracker elsewhere",
    about=(
        "Real processes; the tracker reaches the camera's host through a TCP proxy alone, .5 to 10 Mbit/s and 5 to 200"
        " ms each way, with cuts; shared memory off. Four moving beacons of new payloads (MAR, K = 1) and twelve that"
        " are switched on for .8 s (acquisition), 1 kbit/s, at real time. Onsets of 5 ms a tick, 20 ms a message,"
        " thinned to .8 of the link's bit rate. Times are this machine's, with its load; intervals are of runs."
        " Not in the paper."
    ),
    preset="dvxplorer_mini (VARIABLE_5000), 3.6 mm f/2.0",
    evidence=EVIDENCE,
    cells=cells,
    run=run,
    tables=tables,
    panels=panels,
    timing=True,
)
