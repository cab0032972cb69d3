"""A TCP proxy that a test owns: counts the bytes that cross, and plays a radio link that goes silent."""

from __future__ import annotations

import contextlib
import socket
import threading
from typing import Final

_CHUNK: Final = 65536


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
