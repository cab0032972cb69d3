"""A TCP link with a bit rate and a delay, for benches: 127.0.0.1:port to 127.0.0.1:target_port, each way by itself.

A chunk that arrives at time a leaves the sender when the link is free, takes its bits / bit_rate to be sent, and comes
out delay_s later::

    sent = max(a, sent before) + 8 bytes / bit_rate          out = sent + delay_s

Chunks are at most a packet long, so that a small message waits for no more than what is before it; what the sender
writes beyond `QUEUE_S` of the link's time is not read yet: TCP holds it back, as a modem's queue does.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from typing import Final

PACKET_BYTES: Final = 1_400
# A modem's queue; more would hide a link that is too slow behind a delay without end.
QUEUE_S: Final = 0.5


class ShapedLink:
    """Forwards both ways.

    Args:
        target_port: whom it dials for each link that it accepts.
        bit_rate: of each direction.
        delay_s: of each direction.

    Attributes:
        bytes_passed: (to the target, back).
        worst_s: the longest that a chunk waited for the link to be free, each way.
    """

    def __init__(self, target_port: int, bit_rate: float, delay_s: float) -> None:
        self._target = ("127.0.0.1", target_port)
        self._byte_s = 8.0 / bit_rate
        self._delay_s = delay_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._sockets: list[socket.socket] = []
        self.bytes_passed = [0, 0]
        self.worst_s = [0.0, 0.0]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                inner, _ = self._server.accept()
            except OSError:
                return
            try:
                outer = socket.create_connection(self._target, timeout=5)
            except OSError:
                inner.close()
                continue
            outer.settimeout(None)
            self._sockets += [inner, outer]
            for end in (inner, outer):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for way, (source, sink) in enumerate(((inner, outer), (outer, inner))):
                _Way(self, way, source, sink)

    def close(self) -> None:
        """End everything."""
        self._server.close()
        for end in self._sockets:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


class _Way:
    """One direction: a thread reads and stamps, another sends when it is time."""

    def __init__(self, link: ShapedLink, way: int, source: socket.socket, sink: socket.socket) -> None:
        self._link, self._way, self._source, self._sink = link, way, source, sink
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._changed = threading.Condition()
        self._ended = False
        for run in (self._read, self._send):
            threading.Thread(target=run, daemon=True).start()

    def _read(self) -> None:
        link, free_s = self._link, 0.0
        with contextlib.suppress(OSError):
            while chunk := self._source.recv(PACKET_BYTES):
                now = time.monotonic()
                wait_s = max(0.0, free_s - now)
                link.worst_s[self._way] = max(link.worst_s[self._way], wait_s)
                free_s = now + wait_s + len(chunk) * link._byte_s  # noqa: SLF001 - one module
                link.bytes_passed[self._way] += len(chunk)
                with self._changed:
                    self._waiting.append((free_s + link._delay_s, chunk))  # noqa: SLF001
                    self._changed.notify()
                if free_s - now > QUEUE_S:
                    time.sleep(free_s - now - QUEUE_S)
        with self._changed:
            self._ended = True
            self._changed.notify()

    def _send(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                with self._changed:
                    while not self._waiting and not self._ended:
                        self._changed.wait()
                    if not self._waiting:
                        break
                    out_s, chunk = self._waiting.popleft()
                time.sleep(max(0.0, out_s - time.monotonic()))
                self._sink.sendall(chunk)
        for end in (self._source, self._sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
