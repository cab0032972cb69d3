"""A process's connection to the bus: records out, bounded queues of bytes in, and every gap counted.

Publishing follows `heliograph.qos`; a topic with history goes through Zenoh's advanced publisher, whose cache serves
late and cut-off readers. Receiving: a channel and a reader thread each subscription, which only moves bytes into the
`Inbox`; unpacking and the core run elsewhere. (A callback in Zenoh's own thread spares a wake, but must enter Python
anew each time, and was slower.)
"""

from __future__ import annotations

import json
import logging
import math
import secrets
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import zenoh
import zenoh.ext

from heliograph.errors import BusError, Refusal, Refusals
from heliograph.keys import everything_of, key, key_of, parse
from heliograph.messages import Message
from heliograph.qos import PROFILES, Profile
from heliograph.shell.inbox import Inbox, Sample
from heliograph.shell.process import Stop
from heliograph.wire import Header, Refused, encoding_of, header_for, pack, unpack

_LOG = logging.getLogger(__name__)

# What may wait for the core, by topic. A camera's streams come in 1 to 20 ms batches: 500 are half a second and more,
# at which a live core is hopelessly late and should drop. Everything else is small and rarer.
_QUEUE_LIMIT: Final = 4096
_STREAM_QUEUE_LIMIT: Final = 500
_STREAMS: Final = frozenset({"events", "onsets"})
# Zenoh's own channel between its network thread and our reader; a full one would block the link (all keys).
_CHANNEL: Final = 8192
# Keys whose time is not bounded (`qos.Profile.kept_s`), or a flood: the oldest give way, with their history.
_PUBLISHERS_LIMIT: Final = 512
# Senders whose numbering is followed; a flood of invented senders must not fill the memory.
_SENDERS_LIMIT: Final = 1024
_HEARTBEAT_S: Final = 0.5
# A reader ends when it has moved what its channel still held; on a crowded machine that has taken a second.
_READER_END_S: Final = 10.0

_PRIORITIES: Final = {
    "real_time": zenoh.Priority.REAL_TIME,
    "interactive_high": zenoh.Priority.INTERACTIVE_HIGH,
    "data_high": zenoh.Priority.DATA_HIGH,
    "data": zenoh.Priority.DATA,
    "data_low": zenoh.Priority.DATA_LOW,
    "background": zenoh.Priority.BACKGROUND,
}


def open_session(config: dict[str, Any], stop: Stop | None = None) -> zenoh.Session | None:
    """Return an open session, or None where a stop came first.

    `zenoh.open` blocks until a router answers, deaf to signals; so it waits in a thread of its own.

    Raises:
        BusError: the links cannot be opened.
    """
    result: list[zenoh.Session | BaseException] = []

    def run() -> None:
        try:
            result.append(zenoh.open(zenoh.Config.from_json5(json.dumps(config))))
        except Exception as error:  # noqa: BLE001 - ZError is a plain Exception; told in the caller's thread
            result.append(error)

    thread = threading.Thread(target=run, daemon=True, name="zenoh-open")
    thread.start()
    while thread.is_alive():
        thread.join(0.05)
        if stop:
            return None
    if isinstance(result[0], BaseException):
        endpoints = ", ".join(config["connect"]["endpoints"] or config.get("listen", {}).get("endpoints", []))
        # Zenoh ends its lines with the place in its source, which helps nobody here.
        first_line = str(result[0]).splitlines()[0].split(" at /")[0]
        raise BusError(f"cannot open the bus at {endpoints}: {first_line[:200]}")
    return result[0]


class Gaps:
    """Follows the numbering of each sender on each key, and counts what is missing."""

    def __init__(self) -> None:
        self._next: OrderedDict[tuple[str, str, str], int] = OrderedDict()
        self.missing: Counter[str] = Counter()

    def see(self, topic: str, key_text: str, header: Header, *, from_start: bool = False) -> int:
        """Return how many messages are missing before this one; a repeated or older one counts as none.

        Args:
            topic: under which the gap is counted.
            key_text: the sample's key.
            header: its header.
            from_start: whether an unknown sender's first message must be number 0.
        """
        sender = (header.source, header.boot, key_text)
        expected = self._next.pop(sender, 0 if from_start else header.seq)
        self._next[sender] = max(header.seq + 1, expected)
        if len(self._next) > _SENDERS_LIMIT:
            self._next.popitem(last=False)
        missing = max(0, header.seq - expected)
        if missing:
            self.missing[topic] += missing
        return missing


@dataclass(slots=True)
class _Publisher:
    """A declared key, how long it is kept unused, and when it was used last (monotonic)."""

    zenoh: Any
    kept_s: float
    used_s: float = 0.0


class Bus:
    """One process on the bus of a site.

    Args:
        session: an open Zenoh session; the caller closes it.
        site: the site's name.
        source: "{service}/{instance}", as it stands in every envelope.
    """

    def __init__(self, session: zenoh.Session, site: str, source: str) -> None:
        self.site = site
        self.boot = secrets.token_hex(4)
        self.inbox: Inbox | None = None
        self.gaps = Gaps()
        self.refusals: Refusals = Counter()
        self.published: Counter[str] = Counter()
        self.received: Counter[str] = Counter()
        self.bytes_out = 0
        self._session = session
        self._source = source
        self._seq: OrderedDict[str, int] = OrderedDict()
        self._publishers: OrderedDict[str, _Publisher] = OrderedDict()
        self._held: list[Any] = []
        self._readers: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._expected: dict[str, type[Message]] = {}

    def publish(self, message: Message) -> None:
        """Send a record on its key; never blocks, never fails on a closed link."""
        key_text = key_of(self.site, message)
        with self._lock:
            mono_ns = time.monotonic_ns()
            payload = self._sealed(key_text, message, mono_ns)
            self._publisher(key_text, message, mono_ns / 1e9).put(payload)
            self.published[message.SCHEMA] += 1
            self.bytes_out += len(payload)

    def counts(self) -> dict[str, int]:
        """Return how many messages of each topic were published here."""
        with self._lock:
            return dict(self.published)

    def sealed(self, message: Message) -> bytes:
        """Return a record in its envelope, numbered on its key, for those who ask or answer a query."""
        with self._lock:
            return self._sealed(key_of(self.site, message), message, time.monotonic_ns())

    def _sealed(self, key_text: str, message: Message, mono_ns: int) -> bytes:
        seq = self._seq.pop(key_text, 0)
        self._seq[key_text] = seq + 1
        header = header_for(
            message, source=self._source, boot=self.boot, seq=seq, mono_ns=mono_ns, wall_ns=time.time_ns()
        )
        return pack(header, message)

    @property
    def session(self) -> zenoh.Session:
        """The open session, for the rest of the shell."""
        return self._session

    def keep(self, declared: Any, reader: threading.Thread) -> None:
        """Withdraw what else the shell has declared, and wait for its reader, when this bus is closed."""
        self._held.append(declared)
        self._readers.append(reader)

    def _publisher(self, key_text: str, message: Message, now_s: float) -> Any:
        publisher = self._publishers.pop(key_text, None)
        if publisher is None:
            self._retire(now_s)
            profile = PROFILES[message.SCHEMA]
            publisher = _Publisher(_declare(self._session, key_text, profile, encoding_of(message)), profile.kept_s)
        publisher.used_s = now_s
        self._publishers[key_text] = publisher
        return publisher.zenoh

    def _retire(self, now_s: float) -> None:
        """Let go of keys that are over, and of the oldest where there are too many."""
        over = [text for text, held in self._publishers.items() if now_s - held.used_s > held.kept_s]
        over += list(self._publishers)[: max(0, len(self._publishers) + 1 - _PUBLISHERS_LIMIT)]
        for key_text in dict.fromkeys(over):
            self._seq.pop(key_text, None)
            self._publishers.pop(key_text).zenoh.undeclare()

    def announce(self, service: str, instance: str) -> None:
        """Say that this process is present and warm; withdrawn when the session ends."""
        token = self._session.liveliness().declare_token(key(self.site, "live", service, instance))
        self._held.append(token)

    def subscribe(
        self, schemas: dict[str, type[Message]], parts: Mapping[str, tuple[str, ...]] | None = None, queue: int = 0
    ) -> Inbox:
        """Receive the schemas into an inbox; call once.

        Args:
            schemas: what to read, by schema.
            parts: schema -> first chunks after the topic (the camera); all of the site by default.
            queue: most samples of a topic that wait, a camera's streams apart; 0 for the default.
        """
        limits = {name: _STREAM_QUEUE_LIMIT if name in _STREAMS else queue or _QUEUE_LIMIT for name in schemas}
        self.inbox = Inbox(limits, _STREAMS)
        self._expected = schemas
        for name in schemas:
            expression = everything_of(self.site, name, *(parts or {}).get(name, ()))
            self._read(name, expression, self.inbox)
        return self.inbox

    def _read(self, topic: str, expression: str, inbox: Inbox) -> None:
        channel: zenoh.handlers.FifoChannel[zenoh.Sample] = zenoh.handlers.FifoChannel(_CHANNEL)
        if PROFILES[topic].history:
            subscriber: Any = zenoh.ext.declare_advanced_subscriber(
                self._session,
                expression,
                channel,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )
        else:
            subscriber = self._session.declare_subscriber(expression, channel)
        self._held.append(subscriber)
        # The channel, not the subscriber: one that is being read cannot be undeclared.
        handler = subscriber.handler

        def run() -> None:
            while True:
                try:
                    sample = handler.recv()
                except Exception:  # noqa: BLE001 - the channel's only word for "closed"
                    return
                inbox.put(Sample(topic, str(sample.key_expr), sample.payload.to_bytes(), time.monotonic_ns()))

        reader = threading.Thread(target=run, daemon=True, name=f"read-{topic}")
        self._readers.append(reader)
        reader.start()

    def open(self, sample: Sample) -> tuple[Header, Message] | None:
        """Return a sample's header and record; None where it is refused, which is counted."""
        self.received[sample.topic] += 1
        outcome = unpack(sample.payload, self._expected)
        if not isinstance(outcome, Refused):
            header, message = outcome
            if key_of_or_none(self.site, message) == sample.key:
                return header, message
            outcome = Refused(Refusal.WRONG_KEY, f"{message.SCHEMA} on {sample.key}")
        self.refusals[outcome.reason] += 1
        if self.refusals[outcome.reason] == 1:  # the first of its kind; the counter tells of the others
            _LOG.warning("refused: %s: %s", outcome.reason.value, outcome.detail)
        return None

    def routers(self) -> list[str]:
        """Return the Zenoh ids of the routers that this session is linked with."""
        return sorted(str(zid) for zid in self._session.info.routers_zid())

    def watch(self, topic_prefix: str, on_change: Callable[[str, bool], None]) -> None:
        """Call on_change(key, present) for liveliness tokens below a topic, those already there included."""
        expression = everything_of(self.site, topic_prefix)

        def changed(sample: zenoh.Sample) -> None:
            on_change(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._held.append(self._session.liveliness().declare_subscriber(expression, changed, history=True))

    def close(self) -> None:
        """Withdraw all that was declared, and wait until the reader threads have ended.

        A thread that is still within Zenoh when the interpreter goes aborts the process ("exception not rethrown").
        """
        for held in (*self._held, *(publisher.zenoh for publisher in self._publishers.values())):
            held.undeclare()
        self._held.clear()
        self._publishers.clear()
        for reader in self._readers:
            reader.join(_READER_END_S)


def key_of_or_none(site: str, message: Message) -> str | None:
    """Return a record's key, or None where its names may not stand in one."""
    try:
        return key_of(site, message)
    except ValueError:
        return None


class _Undeclared:
    """A key that is sent to without a declared publisher."""

    def __init__(self, session: zenoh.Session, key_text: str, options: dict[str, Any]) -> None:
        self._session = session
        self._key_text = key_text
        self._options = options

    def put(self, payload: bytes) -> None:
        self._session.put(self._key_text, payload, **self._options)

    def undeclare(self) -> None:
        """Nothing was declared."""


def _declare(session: zenoh.Session, key_text: str, profile: Profile, encoding: str) -> Any:
    options: dict[str, Any] = {
        "encoding": encoding,
        "congestion_control": zenoh.CongestionControl.DROP,
        "priority": _PRIORITIES[profile.priority],
        "express": profile.express,
        "reliability": zenoh.Reliability.RELIABLE if profile.reliable else zenoh.Reliability.BEST_EFFORT,
    }
    if not profile.history and math.isfinite(profile.kept_s) and profile.reliable:
        # A track's keys come and go: Zenoh 1.10 keeps 1.8 kB of each key that was ever declared (4 kB where there is a
        # history: zenoh issue 1518), and nothing of one that is put to.
        del options["reliability"]
        return _Undeclared(session, key_text, options)
    if not profile.history:
        return session.declare_publisher(key_text, **options)
    return zenoh.ext.declare_advanced_publisher(
        session,
        key_text,
        cache=zenoh.ext.CacheConfig(profile.history),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=_HEARTBEAT_S, sporadic_heartbeat=None),
        publisher_detection=True,
        **options,
    )


@contextmanager
def connected(config: dict[str, Any], site: str, source: str, stop: Stop) -> Iterator[Bus | None]:
    """Open the bus for a process; None where a stop came before a router answered.

    Raises:
        BusError: the links cannot be opened.
    """
    session = open_session(config, stop)
    if session is None:
        yield None
        return
    with session:
        bus = Bus(session, site, source)
        try:
            yield bus
        finally:
            bus.close()


def live_keys(session_config: dict[str, Any], site: str) -> list[str]:
    """Return "service/instance" of the processes that are present on a site's bus, sorted.

    Raises:
        BusError: no router answers.
    """
    session = open_session(session_config)
    if session is None:  # no stop was given
        return []
    with session:
        replies = session.liveliness().get(everything_of(site, "live"), timeout=1.0)
        found = [parse(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]
    return sorted("/".join(item.parts) for item in found if item is not None)
