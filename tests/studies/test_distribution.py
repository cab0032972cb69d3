"""Study 9: links and their tables, what its client keeps, and its settings: those of the site with a radio."""

from __future__ import annotations

import socket
import tomllib
from pathlib import Path

import msgspec

from heliograph.messages import Health
from heliograph.shell.inbox import Sample
from heliograph_services.cli.studies import distribution, link_runs
from heliograph_services.cli.studies.radio import ShapedLink
from heliograph_services.cli.studies.study import Cell, Counts, Done
from support.records import header_of

ONBOARD = Path(__file__).parents[2] / "deploy" / "sites" / "onboard.toml"
LINK = {"bit_rate": 2e6, "delay_ms": 50.0, "cut_s": 0.0}


def done(link: dict[str, float] | None = None, **counts: object) -> Done:
    whole: Counts = {
        "blocks": {"ours": [[0, 1, 180, 180], [0, 2, 180, 171]]},
        "acquired_ms": [60.0, 70.0, None],
        "frame_ms": {"1": {"60": 100}},
        "track_ms": {"1": {"70": 20}},
        "published": 1000,
        "crossed": 1020,
        "records": 5,
        "refused": 0,
        "dropped": 3,
        "decoder_share": [0.25, 0.35],
        "late_p99_ms": 1.5,
        "seconds": 12.0,
    }
    return Done(Cell({"link": link, "run": 0, "seconds": 12.0}, 0), whole | counts, 1.0)


def test_the_source_sends_onsets_as_the_site_with_a_radio_has_them() -> None:
    entries = {one["kind"]: one for one in tomllib.loads(ONBOARD.read_text())["service"]}
    source, decoder = entries["event_source"], entries["decoder"]
    assert (source["tick_us"], source["onsets_us"]) == (link_runs.TICK_US, link_runs.ONSETS_US)
    assert decoder["window_us"] == link_runs.WINDOW_US


def test_tables_have_a_row_a_link_and_the_ratio_of_the_bytes() -> None:
    cells = [done(), done(LINK), done(LINK, crossed=1060), done(LINK | {"cut_s": 2.0})]
    found, times, passed = distribution.tables(cells)
    names = ["one host", "2 Mbit/s, 50 ms", "2 Mbit/s, 50 ms, cut for 2 s"]
    assert [row.what for row in found.rows] == [row.what for row in times.rows] == names
    assert [row.what for row in passed.rows] == names[1:]
    assert passed.rows[0].figures["crossed / published"].value == 1.04
    assert "ratio 1.020 to 1.060" in passed.rows[0].n
    assert found.rows[1].figures["MAR_sent"].value == 0.975
    assert [row.figures["dropped"].value for row in times.rows] == [3, 6, 3]
    assert {row.figures["decoder"].value for row in times.rows} == {0.3}
    assert len(distribution.panels(cells)) == 2


def test_the_decoders_share_of_a_core_is_of_seconds_in_which_the_recording_played() -> None:
    heard = link_runs.Heard(origin_s=100.0, late_s=[100.0])
    for at_s, share in ((100.5, 0.9), (102.0, 0.3), (103.0, 0.4), (104.5, 0.0)):
        message = Health(
            service="decoder", instance="a", pid=1, state="running", uptime_s=1.0, input_age_s=None, cpu_share=share,
            counters={}, gauges={},
        )  # fmt: skip
        header = msgspec.structs.replace(header_of(message), mono_ns=round(at_s * 1e9))
        heard.take(Sample("health", "k", b"", 1), header, message)
    assert distribution.decoder_share(heard, 4.0) == [0.3, 0.4]


def test_what_full_queues_dropped_is_what_each_process_said_last() -> None:
    heard = link_runs.Heard()
    for service, dropped in (("decoder", 4), ("tracker", 1), ("decoder", 9)):
        counters = {"dropped: events": dropped, "dropped: tracks": 1, "missing: events": 50}
        message = Health(
            service=service, instance="a", pid=1, state="running", uptime_s=1.0, input_age_s=None, cpu_share=0.1,
            counters=counters, gauges={},
        )  # fmt: skip
        heard.take(Sample("health", "k", b"", 1), header_of(message), message)
    assert heard.dropped == {"decoder": 10, "tracker": 2}


def test_all_links_see_the_same_scenes_and_runs_do_not() -> None:
    cells = distribution.STUDY.all_cells("full", "1.0")
    seeds = {run: {cell.seed for cell in cells if cell.parameters["run"] == run} for run in range(distribution.RUNS)}
    assert all(len(some) == 1 for some in seeds.values())
    assert len(set.union(*seeds.values())) == distribution.RUNS


def test_a_link_passes_what_comes_counts_it_and_passes_nothing_while_it_is_cut() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = ShapedLink(server.getsockname()[1], 1e8, 0.0)
        try:
            with socket.create_connection(("127.0.0.1", link.port)) as near:
                far, _ = server.accept()
                sent = bytes(range(256)) * 20
                near.sendall(sent)
                with far:
                    far.settimeout(20)
                    heard = b""
                    while len(heard) < len(sent):
                        heard += far.recv(65536)
                    assert heard == sent
                    assert link.passed == [len(sent), 0]
                    link.cut()
                    near.sendall(b"lost")
                    link.restore()
                    assert far.recv(1) == b""  # what hung on the cut link is reset
            assert link.bytes_passed == len(sent)
        finally:
            link.close()
