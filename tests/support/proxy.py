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
    """

    def __init__(self, target_port: int) -> None:
        self._target = ("127.0.0.1", target_port)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._lock = threading.Lock()
        self._sockets: list[socket.socket] = []
        self._up = True
        self._generation = 0
        self.bytes_passed = 0
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
            for source, sink in ((inner, outer), (outer, inner)):
                threading.Thread(target=self._pump, args=(source, sink, generation), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, generation: int) -> None:
        with contextlib.suppress(OSError):
            while chunk := source.recv(_CHUNK):
                with self._lock:
                    passes = self._up and generation == self._generation
                    self.bytes_passed += len(chunk) if passes else 0
                if passes:
                    sink.sendall(chunk)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

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
        for end in old:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def close(self) -> None:
        """End everything."""
        self._server.close()
        self._drop()
