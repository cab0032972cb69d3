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
from queue import SimpleQueue
from typing import Final

from support.proxy import Proxy, hang_up

PACKET_BYTES: Final = 1_400
# Each with the time at which it comes out of the link; an empty one ends them.
Chunks = SimpleQueue[tuple[float, bytes]]
# A modem's queue; more would hide a link that is too slow behind a delay without end.
QUEUE_S: Final = 0.5


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
