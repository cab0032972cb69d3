"""Questions and answers on the bus: a query carries one record, and its reply another.

Who answers declares exact keys; a wildcard that happens to cover them is handed on as it was asked, so that the
answerer can refuse it. A reader thread a key moves questions into the answerer's own queue; they are answered from its
own thread.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import zenoh

from heliograph.keys import key_of
from heliograph.messages import Message
from heliograph.shell.bus import Bus
from heliograph.wire import Refused, encoding_of, unpack

# Questions that wait in Zenoh for a reader that only moves them on.
_CHANNEL: Final = 256


@dataclass(slots=True)
class Question:
    """A query that waits for its answer.

    Args:
        key: the key expression as it was asked: a wildcard is not the key it covers.
        own_key: the key on which it came in.
        payload: its bytes; empty for none.
    """

    key: str
    own_key: str
    payload: bytes
    _query: Any

    def answer(self, bus: Bus, message: Message) -> None:
        """Reply with a record, once; never fails on a closed link."""
        query, self._query = self._query, None
        if query is None:
            return
        try:
            query.reply(self.own_key, bus.sealed(message), encoding=encoding_of(message))
        except zenoh.ZError:  # who asked has gone
            return
        finally:
            query.drop()

    def drop(self) -> None:
        """End the question without an answer."""
        query, self._query = self._query, None
        if query is not None:
            query.drop()


def answering(bus: Bus, own_key: str, take: Callable[[Question], None]) -> None:
    """Hand on what is asked on a key, from a reader thread, until the bus is closed."""
    channel: zenoh.handlers.FifoChannel[zenoh.Query] = zenoh.handlers.FifoChannel(_CHANNEL)
    queryable = bus.session.declare_queryable(own_key, channel, complete=True)
    handler = queryable.handler

    def run() -> None:
        while True:
            try:
                query = handler.recv()
            except Exception:  # noqa: BLE001 - the channel's only word for "closed"
                return
            payload = query.payload.to_bytes() if query.payload is not None else b""
            take(Question(str(query.key_expr), own_key, payload, query))

    reader = threading.Thread(target=run, daemon=True, name=f"answer-{own_key.rsplit('/', 2)[-2]}")
    bus.keep(queryable, reader)
    reader.start()


def ask(
    bus: Bus, message: Message, expected: dict[str, type[Message]], timeout_s: float
) -> tuple[list[Message], list[str]]:
    """Ask on a record's own key; return the answers, and why others were none.

    No answer at all within the time, or nobody there who answers, gives two empty lists.
    """
    replies = bus.session.get(
        key_of(bus.site, message),
        payload=bus.sealed(message),
        encoding=encoding_of(message),
        timeout=timeout_s,
    )
    answers: list[Message] = []
    refused: list[str] = []
    for reply in replies:
        if reply.ok is None:
            continue
        outcome = unpack(reply.ok.payload.to_bytes(), expected)
        if isinstance(outcome, Refused):
            refused.append(f"{outcome.reason.value}: {outcome.detail}")
        else:
            answers.append(outcome[1])
    return answers, refused
