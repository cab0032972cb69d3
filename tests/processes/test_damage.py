"""Ten thousand damaged messages on every subscribed key: each read or refused by name, and every process lives on."""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from heliograph import truth
from heliograph.keys import key
from heliograph.messages import Health, Message, Progress
from heliograph.shell.links import client_config
from heliograph.shell.site import BusLinks
from heliograph.wire import SCHEMAS
from support.fed import site_text
from support.mutate import mutations
from support.processes import Collector, Host, collecting, free_port
from support.records import every_record
from support.replay import SERVICES, in_one_process, recording, through_processes
from support.replay import site as replayed
from support.scene import Scene

pytestmark = pytest.mark.processes

# Each service, and what it subscribes to.
SUBSCRIBED = {
    "tracker": ["onsets", "status"],
    "decoder": ["events", "tracks"],
    "metrics_sink": ["frames", "ids", "messages", "link", "tracks", "health", "truth"],
}
N = int(os.environ.get("HELIOGRAPH_DAMAGED_MESSAGES", "10000"))


def site(port: int, folder: Path) -> str:
    kinds = "".join(f'[[service]]\nkind = "{kind}"\n' for kind in SUBSCRIBED)
    return site_text("noise", port, f'{kinds}file = "{folder}/metrics.sqlite"')


def samples() -> dict[str, Message]:
    return {message.SCHEMA: message for message in every_record()}


def key_for(schema: str) -> str:
    names = {1: ("cam0",), 2: ("cam0", "t-1")}
    two = {"health": ("decoder", "decoder")}
    parts = two.get(schema) or names[2 if schema in {"ids", "messages", "link"} else 1]
    return key("noise", schema, *parts)


def received(heard: Collector, service: str) -> dict[str, int]:
    reports = [m for m in heard.messages["health"] if isinstance(m, Health) and m.service == service]
    return reports[-1].counters if reports else {}


def everything_arrived(heard: Collector, sent: dict[str, int]) -> bool:
    for service, schemas in SUBSCRIBED.items():
        counters = received(heard, service)
        for schema in schemas:
            took = counters.get(f"received: {schema}", 0) + counters.get(f"dropped: {schema}", 0)
            if took < sent[schema]:
                return False
    return True


@contextlib.contextmanager
def damaged_progress(port: int) -> Iterator[None]:
    """Publish damaged words of progress, in the names of both awaited services, while a replay goes on."""
    end = threading.Event()
    links = BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False)

    def run() -> None:
        with zenoh.open(zenoh.Config.from_json5(json.dumps(client_config(links)))) as session:
            for service in ("tracker", "decoder"):
                record = Progress(camera="cam0", service=service, t_us=1_000_000)
                for payload in mutations(record, N // 2, seed=3):
                    session.put(key("replay", "progress", "cam0", service), payload)
                    if end.wait(0.0002):
                        return

    sender = threading.Thread(target=run)
    sender.start()
    try:
        yield
    finally:
        end.set()
        sender.join()


def test_damaged_words_of_progress_neither_hurry_nor_stop_a_lockstep_source(scene: Scene, tmp_path: Path) -> None:
    port = free_port()
    text = replayed(port, recording(scene.path), "", scene.beacons)
    found = through_processes(tmp_path, text, port, SERVICES, lambda: damaged_progress(port))
    assert found == in_one_process(tmp_path / f"site{port}.toml")


def test_damaged_messages_are_counted_by_reason_and_no_process_dies(tmp_path: Path) -> None:
    port = free_port()
    host = Host(tmp_path, "noise", site(port, tmp_path), list(SUBSCRIBED))
    schemas = sorted({schema for wanted in SUBSCRIBED.values() for schema in wanted})
    assert set(schemas) <= {*SCHEMAS, *truth.SCHEMAS}
    config = client_config(BusLinks(connect=(f"tcp/127.0.0.1:{port}",), shared_memory=False))
    try:
        with collecting(port, "noise", ["health"]) as heard:
            heard.until(lambda h: all(received(h, service) for service in SUBSCRIBED), "all services to report")
            with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
                for schema in schemas:
                    # Nothing is dropped on this side, so that the counts can be compared.
                    publisher = session.declare_publisher(
                        key_for(schema), congestion_control=zenoh.CongestionControl.BLOCK
                    )
                    for payload in mutations(samples()[schema], N, seed=7):
                        publisher.put(payload)
                heard.until(lambda h: everything_arrived(h, dict.fromkeys(schemas, N)), "all of it to arrive")
            for service in SUBSCRIBED:
                refused = {name: n for name, n in received(heard, service).items() if name.startswith("refused: ")}
                print(service, refused)
                assert refused.get("refused: message is not msgpack", 0) > N // 20
                assert refused.get("refused: message body breaks its schema", 0) > N // 20
                assert "refused: core refused its input" not in refused, host.log(service)
            assert sorted(host.alive()) == sorted(["router", *SUBSCRIBED])
    finally:
        statuses = host.close()
    assert statuses == dict.fromkeys(statuses, 0)
    for service in SUBSCRIBED:
        assert "Traceback" not in host.log(service)
