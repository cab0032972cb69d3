"""Keys are built and parsed in one place."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.keys import TOPICS, everything_of, key, key_of, parse
from heliograph.messages import Message
from heliograph.qos import PROFILES
from support.records import every_record

CHUNKS = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.:-]{0,20}", fullmatch=True)


@given(CHUNKS, st.sampled_from(sorted(TOPICS)), CHUNKS, CHUNKS)
def test_a_key_parses_into_what_it_was_built_from(site: str, topic: str, first: str, second: str) -> None:
    parts = (first, second)[: TOPICS[topic]]
    found = parse(key(site, topic, *parts))
    assert found is not None
    assert (found.site, found.topic, found.parts) == (site, topic, parts)
    assert str(found) == key(site, topic, *parts)


@pytest.mark.parametrize("message", every_record(), ids=lambda m: m.SCHEMA)
def test_every_record_has_a_key_and_a_profile(message: Message) -> None:
    found = parse(key_of("demo", message))
    assert found is not None
    assert found.topic == message.SCHEMA.partition("_")[0]  # a command and its reply are of the topic "beacon"
    assert message.SCHEMA in PROFILES


def test_the_keys_are_those_of_the_contract() -> None:
    built = {m.SCHEMA: key_of("demo", m) for m in every_record()}
    assert built["tracks"] == "heliograph/@v1/demo/tracks/cam0"
    assert built["ids"] == "heliograph/@v1/demo/ids/cam0/5eed-0"
    assert built["messages"] == "heliograph/@v1/demo/messages/cam0/5eed-1"
    assert built["progress"] == "heliograph/@v1/demo/progress/cam0/decoder"
    assert built["health"] == "heliograph/@v1/demo/health/decoder/decoder"
    assert key("demo", "beacon", "crane", "cmd") == "heliograph/@v1/demo/beacon/crane/cmd"
    assert everything_of("demo", "ids") == "heliograph/@v1/demo/ids/*/*"
    assert everything_of("demo", "ids", "cam0") == "heliograph/@v1/demo/ids/cam0/*"


@pytest.mark.parametrize("text", ["", "a/b", "*", "$*", "@v1", "x" * 65, "-x", "a b", "ä"])
def test_what_would_break_a_key_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="must be 1 to 64"):
        key(text, "tracks", "cam0")


@pytest.mark.parametrize("text", ["", "heliograph", "heliograph/@v2/s/tracks/c", "heliograph/@v1/s/tracks", "x/y/z"])
def test_other_peoples_keys_parse_to_none(text: str) -> None:
    assert parse(text) is None


def test_an_unknown_topic_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="one of events, onsets"):
        key("s", "gossip", "c")
    with pytest.raises(ValueError, match="takes 1 parts"):
        key("s", "tracks", "a", "b")
