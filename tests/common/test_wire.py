"""The envelope and the records: golden bytes, round trips, and refusals by name."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph import truth
from heliograph.errors import Refusal
from heliograph.events import EventBatch
from heliograph.messages import Message, Tracks
from heliograph.streams import Events, Image, Onsets
from heliograph.wire import SCHEMAS, Header, Refused, encoding_of, pack, pack_body, unpack
from support.mutate import mutations
from support.records import every_record, header_of

GOLDEN = Path(__file__).parents[1] / "vectors" / "wire.json"
ALL = {**SCHEMAS, **truth.SCHEMAS}


def opened(payload: bytes) -> tuple[Header, Message]:
    outcome = unpack(payload, ALL)
    assert not isinstance(outcome, Refused), outcome
    return outcome


def reason(payload: bytes) -> Refusal:
    outcome = unpack(payload, ALL)
    assert isinstance(outcome, Refused)
    return outcome.reason


def envelope(message: Message, **changes: object) -> bytes:
    packed: bytes = msgpack.packb(msgpack.unpackb(pack(header_of(message), message)) | changes)
    return packed


def test_golden_bytes_of_every_schema_are_what_they_were() -> None:
    golden = json.loads(GOLDEN.read_text())
    packed = {m.SCHEMA: pack(header_of(m), m).hex() for m in every_record()}
    # Two versions of zlib may pack the same columns differently: these are golden as they are read.
    zipped = {"onsets", "image", "truth"}
    assert packed.keys() == golden.keys()
    assert {n: t for n, t in packed.items() if n not in zipped} == {n: t for n, t in golden.items() if n not in zipped}


def test_golden_bytes_are_read_as_the_records_that_they_were_made_from() -> None:
    golden = json.loads(GOLDEN.read_text())
    for message in every_record():
        header, back = opened(bytes.fromhex(golden[message.SCHEMA]))
        assert header == header_of(message)
        assert pack_body(back) == pack_body(message)


def test_columns_that_unpack_to_more_than_they_should_are_refused_unread() -> None:
    body = every_record()[1].to_body()
    bomb = zlib.compress(bytes(10_000_000))
    for columns in (bomb, b"", b"no zlib", body["columns"] + b"x", body["columns"][:-1]):
        assert reason(envelope(every_record()[1], body=body | {"columns": columns})) is Refusal.BAD_BODY


def test_every_schema_has_a_record_in_the_golden_file() -> None:
    assert {m.SCHEMA for m in every_record()} == set(ALL)


@pytest.mark.parametrize("message", every_record(), ids=lambda m: m.SCHEMA)
def test_a_record_comes_back_as_it_went(message: Message) -> None:
    header, back = opened(pack(header_of(message), message))
    assert header == header_of(message)
    assert type(back) is type(message)
    assert pack_body(back) == pack_body(message)


def test_the_encoding_names_schema_and_major_version() -> None:
    assert encoding_of(every_record()[0]) == "application/msgpack;heliograph.events.v1"


def test_a_newer_minor_version_with_more_fields_is_read() -> None:
    message = every_record()[2]
    whole = msgpack.unpackb(pack(header_of(message), message))
    whole["version"] = [1, 9]
    whole["body"]["new_field"] = [1, 2]
    assert isinstance(opened(msgpack.packb(whole))[1], Tracks)


def test_another_major_version_is_refused_by_name() -> None:
    assert reason(envelope(every_record()[2], version=[2, 0])) is Refusal.WRONG_VERSION


def test_refusals_name_what_failed_first() -> None:
    tracks = every_record()[2]
    assert reason(b"") is Refusal.NOT_MSGPACK
    assert reason(b"\xc1") is Refusal.NOT_MSGPACK
    assert reason(b"\x91" * 5000) is Refusal.NOT_MSGPACK
    assert reason(msgpack.packb([1])) is Refusal.NO_ENVELOPE
    assert reason(envelope(tracks, seq=-1)) is Refusal.NO_ENVELOPE
    assert reason(envelope(tracks, schema="gossip")) is Refusal.UNKNOWN_SCHEMA
    assert reason(envelope(tracks, body={"camera": "cam0"})) is Refusal.BAD_BODY


def test_a_name_that_would_break_a_key_is_refused() -> None:
    body = every_record()[2].to_body()
    for name in ("", "a/b", "*", "x" * 65, "@v1"):
        assert reason(envelope(every_record()[2], body=body | {"camera": name})) is Refusal.BAD_BODY


def test_no_number_is_nan_or_infinite() -> None:
    body = every_record()[2].to_body()
    for value in (float("nan"), float("inf"), 1e300):
        assert reason(envelope(every_record()[2], body=body | {"x_px": [value]})) is Refusal.BAD_BODY


def test_events_that_run_backwards_or_leave_the_sensor_are_refused() -> None:
    body = every_record()[0].to_body()
    backwards = np.array([5, 3, 9], "<u4").tobytes()
    outside = np.array([3, 4, 640], "<u2").tobytes()
    late = np.array([0, 1, 1001], "<u4").tobytes()
    for changes in ({"dt_us": backwards}, {"x_px": outside}, {"dt_us": late}, {"n": 4}, {"t1_us": 900}):
        assert reason(envelope(every_record()[0], body=body | changes)) is Refusal.BAD_BODY


def test_onsets_must_hold_whole_ticks_that_add_up() -> None:
    body = every_record()[1].to_body()
    for changes in ({"t1_us": 10_001}, {"t0_us": 5000}, {"n": 2}, {"tick_us": 0}, {"pool_px": 2}):
        assert reason(envelope(every_record()[1], body=body | changes)) is Refusal.BAD_BODY


@pytest.mark.parametrize("message", every_record(), ids=lambda m: m.SCHEMA)
def test_ten_thousand_damaged_payloads_are_read_or_refused_and_never_raise(message: Message) -> None:
    refused = 0
    for payload in mutations(message, 10_000 // len(ALL), seed=1):
        refused += isinstance(unpack(payload, ALL), Refused)
    assert refused > 100


@given(st.lists(st.tuples(st.integers(0, 3000), st.integers(0, 63), st.integers(0, 31), st.booleans()), max_size=50))
def test_any_events_come_back(rows: list[tuple[int, int, int, bool]]) -> None:
    rows.sort()
    batch = EventBatch(
        np.array([r[0] for r in rows], np.int64) + 10**15,
        np.array([r[1] for r in rows], np.uint16),
        np.array([r[2] for r in rows], np.uint16),
        np.array([r[3] for r in rows], np.bool_),
    )
    t0 = 10**15
    events = Events(camera="c", stream="s", width=64, height=32, t0_us=t0, t1_us=t0 + 3001, batch=batch)
    back = opened(pack(header_of(events), events))[1]
    assert isinstance(back, Events)
    for name in ("t_us", "x_px", "y_px", "on"):
        assert np.array_equal(getattr(back.batch, name), getattr(batch, name))


def test_empty_onsets_still_say_that_time_has_passed() -> None:
    none = np.empty(0, np.uint16)
    onsets = Onsets(
        camera="c", stream="s", width=8, height=8, t0_us=0, t1_us=20_000, tick_us=5000, pool_px=1,
        tick=none, x_px=none, y_px=none, on_count=none.astype(np.uint8), off_count=none.astype(np.uint8), end=True,
    )  # fmt: skip
    back = opened(pack(header_of(onsets), onsets))[1]
    assert isinstance(back, Onsets)
    assert (back.ticks, len(back.tick), back.end) == (4, 0, True)


def test_an_image_comes_back_row_by_row() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    image = Image(camera="cam0", stream="5eed", t_us=5, grey=grey)
    _, back = opened(pack(header_of(image), image))
    assert isinstance(back, Image)
    assert (back.width, back.height, back.t_us) == (4, 3, 5)
    assert (back.grey == grey).all()


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 5},  # more pixels than bytes
        {"width": 3},  # more bytes than pixels
        {"width": 0},
        {"width": 4096, "height": 4096},  # a few bytes may not ask for 16 MB
        {"grey": b"no zlib"},
        {"grey": zlib.compress(bytes(12)) + b"x"},
        {"t_us": 2**60},
        {"stream": "a/b"},
    ],
)
def test_an_image_that_is_not_what_it_says_is_refused(changes: dict[str, object]) -> None:
    image = Image(camera="cam0", stream="5eed", t_us=5, grey=np.zeros((3, 4), np.uint8))
    assert reason(envelope(image, body=image.to_body() | changes)) is Refusal.BAD_BODY


@given(
    st.integers(1, 4),
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 1299), st.integers(0, 40), st.integers(0, 40)), max_size=60),
)
def test_onsets_come_back_entry_by_entry(pool_px: int, drawn: list[tuple[int, int, int, int]]) -> None:
    columns = -(-65 // pool_px)
    rows = -(-21 // pool_px)
    entries = sorted({(tick, place % (columns * rows)): counts for tick, place, *counts in drawn}.items())
    tick, place = (np.array([key[i] for key, _ in entries], np.int64) for i in range(2))
    on, off = (np.array([counts[i] for _, counts in entries], np.uint8) for i in range(2))
    onsets = Onsets(
        camera="c", stream="s", width=65, height=21, t0_us=0, t1_us=15_000, tick_us=5000, pool_px=pool_px,
        tick=tick.astype(np.uint16), x_px=(place % columns).astype(np.uint16),
        y_px=(place // columns).astype(np.uint16), on_count=on, off_count=off,
    )  # fmt: skip
    back = opened(pack(header_of(onsets), onsets))[1]
    assert isinstance(back, Onsets)
    for name in ("tick", "x_px", "y_px"):
        assert getattr(back, name).tolist() == getattr(onsets, name).tolist()
    for name in ("on_count", "off_count"):
        assert getattr(back, name).tolist() == np.minimum(getattr(onsets, name), 15).tolist()


def test_onsets_that_do_not_rise_within_a_tick_are_the_sender_s_error() -> None:
    onsets = every_record()[1]
    assert isinstance(onsets, Onsets)
    with pytest.raises(ValueError, match="rise"):
        msgspec.structs.replace(
            onsets, x_px=np.array([3, 639, 4], np.uint16), y_px=np.array([5, 5, 5], np.uint16)
        ).to_body()
