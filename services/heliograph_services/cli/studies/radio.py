"""A radio link between processes on one host: a TCP proxy that counts, goes silent, and takes its time.

`Proxy` counts the bytes that cross and goes silent when told to. `ShapedLink` has a bit rate and a delay as well, each
way by itself: a chunk that arrives at time a leaves the sender when the link is free, takes its bits / bit_rate to be
sent, and comes out delay_s later::

    sent = max(a, sent before) + 8 bytes / bit_rate          out = sent + delay_s

Chunks are at most a packet long, so that a small message waits for no more than what is before it; what the sender
writes beyond `QUEUE_S` of the link's time is not read yet: TCP holds it back, as a modem's queue does.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from queue import SimpleQueue
from typing import Final

_CHUNK: Final = 65536
PACKET_BYTES: Final = 1_400
# Each with the time at which it comes out of the link; an empty one ends them.
Chunks = SimpleQueue[tuple[float, bytes]]
# A modem's queue; more would hide a link that is too slow behind a delay without end.
QUEUE_S: Final = 0.5


class Proxy:
    """Forwards 127.0.0.1:port to 127.0.0.1:target_port, both ways.

    While the link is cut nothing passes and nothing is told to either side, as when a radio fades; when it is
    restored, what hung on the old link is reset, and new links pass.

    Args:
        target_port: whom it dials for each link that it accepts.

    Attributes:
        passed: bytes, to the target and back.
    """

    def __init__(self, target_port: int) -> None:
        self._target = ("127.0.0.1", target_port)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._lock = threading.Lock()
        self._sockets: list[socket.socket] = []
        self._up = True
        self._generation = 0
        self.passed = [0, 0]
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
            with self._lock:
                self._sockets += [inner, outer]
                generation = self._generation
            for end in (inner, outer):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for way, (source, sink) in enumerate(((inner, outer), (outer, inner))):
                self._forward(way, source, sink, generation)

    def _forward(self, way: int, source: socket.socket, sink: socket.socket, generation: int) -> None:
        """Begin to forward one direction of a link: 0 to the target, 1 back."""
        threading.Thread(target=self._pump, args=(way, source, sink, generation), daemon=True).start()

    def _pump(self, way: int, source: socket.socket, sink: socket.socket, generation: int) -> None:
        with contextlib.suppress(OSError):
            while chunk := source.recv(_CHUNK):
                if self.passes(way, len(chunk), generation):
                    sink.sendall(chunk)
        hang_up(source, sink)

    def passes(self, way: int, size: int, generation: int) -> bool:
        """Return whether so many bytes of a link of that generation get through, and count them."""
        with self._lock:
            passes = self._up and generation == self._generation
            self.passed[way] += size if passes else 0
        return passes

    @property
    def bytes_passed(self) -> int:
        """Bytes of both directions."""
        with self._lock:
            return sum(self.passed)

    def cut(self) -> None:
        """Let nothing pass any more."""
        with self._lock:
            self._up = False

    def restore(self) -> None:
        """Reset what hung on the cut link, and let new links pass."""
        with self._lock:
            self._up = True
            self._generation += 1
        self._drop()

    def _drop(self) -> None:
        with self._lock:
            old, self._sockets = self._sockets, []
        hang_up(*old)
        for end in old:
            end.close()

    def close(self) -> None:
        """End everything."""
        self._server.close()
        self._drop()


def hang_up(*ends: socket.socket) -> None:
    """Tell both sides that nothing more will come."""
    for end in ends:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


class ShapedLink(Proxy):
    """A proxy whose link takes its time.

    Args:
        target_port: whom it dials for each link that it accepts.
        bit_rate: of each direction.
        delay_s: of each direction.

    Attributes:
        worst_s: the longest that a chunk waited for the link to be free, each way.
    """

    def __init__(self, target_port: int, bit_rate: float, delay_s: float) -> None:
        self._byte_s = 8.0 / bit_rate
        self._delay_s = delay_s
        self.worst_s = [0.0, 0.0]
        super().__init__(target_port)

    def _forward(self, way: int, source: socket.socket, sink: socket.socket, generation: int) -> None:
        waiting: Chunks = SimpleQueue()
        threading.Thread(target=self._read, args=(waiting, way, source, generation), daemon=True).start()
        threading.Thread(target=_send, args=(waiting, source, sink), daemon=True).start()

    def _read(self, waiting: Chunks, way: int, source: socket.socket, generation: int) -> None:
        """Stamp what comes with the time at which it leaves the link."""
        free_s = 0.0
        with contextlib.suppress(OSError):
            while chunk := source.recv(PACKET_BYTES):
                if not self.passes(way, len(chunk), generation):
                    continue
                now = time.monotonic()
                wait_s = max(0.0, free_s - now)
                self.worst_s[way] = max(self.worst_s[way], wait_s)
                free_s = now + wait_s + len(chunk) * self._byte_s
                waiting.put((free_s + self._delay_s, chunk))
                if free_s - now > QUEUE_S:
                    time.sleep(free_s - now - QUEUE_S)
        waiting.put((0.0, b""))


def _send(waiting: Chunks, source: socket.socket, sink: socket.socket) -> None:
    """Send each chunk when its time has come."""
    with contextlib.suppress(OSError):
        while True:
            out_s, chunk = waiting.get()
            if not chunk:
                break
            time.sleep(max(0.0, out_s - time.monotonic()))
            sink.sendall(chunk)
    hang_up(source, sink)
