"""`GET /metrics` on loopback: the page that the sink made last, for Prometheus.

One thread, one request at a time: a client that dawdles is cut off, and can only keep other scrapers waiting. The
page is a finished string that the working thread replaces once a second, so a scrape never waits for the sink, nor the
sink for a scrape.
"""

from __future__ import annotations

import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Final

from heliograph.errors import ConfigError
from heliograph_services.metrics_sink.exposition import CONTENT_TYPE

HOST: Final = "127.0.0.1"
PATH: Final = "/metrics"
# On loopback a request is there at once.
_TIMEOUT_S: Final = 2.0


class Scrape:
    """Serves a page until it is closed.

    Args:
        port: of the loopback.

    Raises:
        ConfigError: the port is taken.
    """

    def __init__(self, port: int) -> None:
        self.page = ""
        try:
            self._server = _Server((HOST, port), self)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ConfigError(f"prometheus_port must be free on {HOST}, {port} is not: {reason}") from None
        # The poll bounds how long a stop takes.
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True, name="scrape"
        )
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(_TIMEOUT_S)


class _Server(HTTPServer):
    def __init__(self, address: tuple[str, int], scrape: Scrape) -> None:
        self.scrape = scrape
        super().__init__(address, _Handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Say nothing of a client that went away."""


class _Handler(BaseHTTPRequestHandler):
    timeout = _TIMEOUT_S
    server: _Server

    def do_GET(self) -> None:
        """Answer one request."""
        if self.path.split("?", 1)[0] != PATH:
            self.send_error(404, f"only {PATH} is here")
            return
        body = self.server.scrape.page.encode()
        self.send_response(200)
        self.send_header("Content-Type", CONTENT_TYPE)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class's name
        """Log nothing: a scrape comes every few seconds."""
