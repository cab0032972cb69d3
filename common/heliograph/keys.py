"""The keys of the bus, built and parsed here and nowhere else.

::

    heliograph/@v1/{site}/events|onsets|tracks|flow|clock|image|truth|frames|status/{camera}
    heliograph/@v1/{site}/ids|messages|link/{camera}/{track}
    heliograph/@v1/{site}/progress/{camera}/{service}
    heliograph/@v1/{site}/beacon/{name}/cmd|state
    heliograph/@v1/{site}/metrics|health|live/{service}/{instance}

`@v1` is a verbatim chunk: no wildcard of a stranger matches it, and another major version lives beside this one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from heliograph.messages import Message

ROOT: Final = "heliograph/@v1"
# How many chunks follow each topic.
TOPICS: Final[dict[str, int]] = {
    "events": 1,
    "onsets": 1,
    "tracks": 1,
    "flow": 1,
    "clock": 1,
    "image": 1,
    "truth": 1,
    "frames": 1,
    "status": 1,
    "ids": 2,
    "messages": 2,
    "link": 2,
    "progress": 2,
    "beacon": 2,
    "metrics": 2,
    "health": 2,
    "live": 2,
}
# A process names the same few keys a thousand times a second: those of its cameras, and of the tracks of the moment.
KEYS_KEPT: Final = 1024
# Schemas whose topic is not their own name: the rest of the key.
_OF_BEACONS: Final = {"beacon": "state", "beacon_cmd": "cmd", "beacon_reply": "cmd"}
_CHUNK: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:-]{0,63}")


@dataclass(frozen=True, slots=True)
class Key:
    """A parsed key: the site, the topic, and what names the thing within it."""

    site: str
    topic: str
    parts: tuple[str, ...]

    def __str__(self) -> str:
        return "/".join((ROOT, self.site, self.topic, *self.parts))


def chunk(text: str, what: str = "name") -> str:
    """Return the text if it may stand in a key.

    Raises:
        ValueError: it is empty, longer than 64, or has a character outside letters, digits and `_ . : -`.
    """
    if not _CHUNK.fullmatch(text):
        raise ValueError(f"{what} must be 1 to 64 letters, digits or _ . : - (none of . : - first), not {text!r}")
    return text


def key(site: str, topic: str, *parts: str) -> str:
    """Return a key.

    Raises:
        ValueError: an unknown topic, a wrong number of parts, or a part that may not stand in a key.
    """
    return _key(site, topic, parts)


@lru_cache(maxsize=KEYS_KEPT)
def _key(site: str, topic: str, parts: tuple[str, ...]) -> str:
    if topic not in TOPICS:
        raise ValueError(f"topic must be one of {', '.join(TOPICS)}, not {topic!r}")
    if len(parts) != TOPICS[topic]:
        raise ValueError(f"{topic} takes {TOPICS[topic]} parts, not {parts}")
    return str(Key(chunk(site, "site"), topic, tuple(chunk(part) for part in parts)))


def key_of(site: str, message: Message) -> str:
    """Return the key of a record: its schema is the topic, its names are the parts."""
    if message.SCHEMA in _OF_BEACONS:
        return key(site, "beacon", getattr(message, "name"), _OF_BEACONS[message.SCHEMA])  # noqa: B009 - as below
    if TOPICS[message.SCHEMA] == 1:
        return key(site, message.SCHEMA, getattr(message, "camera"))  # noqa: B009 - not every record has it
    names = ("service", "instance") if message.SCHEMA in {"health", "metrics"} else ("camera", "track")
    if message.SCHEMA == "progress":
        names = ("camera", "service")
    return key(site, message.SCHEMA, *(getattr(message, name) for name in names))


def everything_of(site: str, topic: str, *parts: str) -> str:
    """Return the expression for all keys of a topic that begin with the parts.

    Raises:
        ValueError: as `key`, but fewer parts are allowed.
    """
    if topic not in TOPICS or len(parts) > TOPICS[topic]:
        raise ValueError(f"no topic {topic!r} with {len(parts)} parts")
    stars = ("*",) * (TOPICS[topic] - len(parts))
    return "/".join((ROOT, chunk(site, "site"), topic, *(chunk(part) for part in parts), *stars))


def parse(text: str) -> Key | None:
    """Return the parts of a key, or None where it is none of ours."""
    if not text.startswith(ROOT + "/"):
        return None
    chunks = text[len(ROOT) + 1 :].split("/")
    if len(chunks) < 2 or TOPICS.get(chunks[1]) != len(chunks) - 2:
        return None
    if not all(_CHUNK.fullmatch(part) for part in chunks):
        return None
    return Key(chunks[0], chunks[1], tuple(chunks[2:]))
