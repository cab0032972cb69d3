"""What the tests of the command line share."""

from __future__ import annotations

import socket

import pytest


@pytest.fixture
def free_endpoint() -> str:
    """Return an endpoint on a port that was free a moment ago."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"
