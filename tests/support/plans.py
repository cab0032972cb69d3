"""How SQLite goes about the statements of a reader of the metrics file."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

from heliograph_services.metrics_sink import schema, summary


def plans_of(path: Path, query: Callable[[], Any]) -> set[str]:
    """Return the lines of EXPLAIN QUERY PLAN of every statement that `summary` runs for a query, once each."""
    statements: list[str] = []

    def watched(file: Path) -> sqlite3.Connection:
        connection = schema.open_read(file)
        connection.set_trace_callback(statements.append)
        return connection

    with patch.object(summary, "open_read", watched):
        query()
    connection = schema.open_read(path)
    try:
        return {
            line
            for statement in statements
            if statement.lstrip().upper().startswith(("SELECT", "WITH"))
            for *_, line in connection.execute(f"EXPLAIN QUERY PLAN {statement}")
        }
    finally:
        connection.close()
