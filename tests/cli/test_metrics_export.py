"""`heliograph metrics export`: what is in the file comes out, as CSV and as Parquet; mistakes are one line."""

from __future__ import annotations

import csv
import io
import sqlite3
from pathlib import Path

import pytest

from heliograph.core import Context
from heliograph.errors import ConfigError, FileError
from heliograph.messages import Health, Message
from heliograph_services.cli.__main__ import main
from heliograph_services.cli.metrics import seconds_of
from heliograph_services.metrics_sink.config import MetricsSinkConfig
from heliograph_services.metrics_sink.export import TABLES, export
from heliograph_services.metrics_sink.service import make_core
from heliograph_services.metrics_sink.summary import summarise
from support.truth_scenes import Said, Sent, state, truth

UNTIL_US = 3_000_000
CONTEXT = Context(instance="metrics_sink", boot="b0", lockstep=False)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "m.sqlite"
    core = make_core(MetricsSinkConfig(file=str(path)), CONTEXT)
    messages: list[Message] = [*truth([Sent()], UNTIL_US), *Said().all_of(Sent(), UNTIL_US).messages(), state(60_000)]
    for message in sorted(messages, key=lambda each: each.time_us):
        core.feed(message)
    hop = {"latency bus n": 10.0, "latency bus p50_us": 100.0, "latency bus p95_us": 200.0, "latency bus p99_us": 300.0}
    core.feed(
        Health(
            service="decoder",
            instance="decoder",
            pid=7,
            state="running",
            uptime_s=1.0,
            input_age_s=None,
            cpu_share=0.5,
            counters={"published: frames": 100},
            gauges={"queue": 2.0, **hop},
        )
    )
    core.close()
    return path


def read_csv(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_counts_come_out_as_they_are_in_the_file(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "counts.csv"
    assert main(["metrics", "export", str(file), "-o", str(out)]) == 0
    rows = read_csv(out.read_text(encoding="utf-8"))
    frames = {int(row["second"]): int(row["n"]) for row in rows if row["name"] == "frames"}
    assert frames == {0: 90, 1: 91, 2: 91}
    assert {(row["run"], row["camera"], row["epoch"]) for row in rows} == {("1", "cam0", "0")}


def test_every_table_has_the_columns_that_it_names(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, table in TABLES.items():
        n = export(file, name, "-")
        text = capsys.readouterr().out
        rows = read_csv(text)
        assert len(rows) == n >= 1, name
        assert tuple(rows[0]) == table.columns
        assert export(file, name, "-", run=9) == 0
        capsys.readouterr()


def test_parquet_holds_the_same_values_with_types(file: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed (extra `analysis`)")
    for name, table in TABLES.items():
        out, text = tmp_path / f"{name}.parquet", tmp_path / f"{name}.csv"
        assert export(file, name, out) == export(file, name, text)
        found = parquet.read_table(out)
        assert found.column_names == list(table.columns)
        for typed, plain in zip(found.to_pylist(), read_csv(text.read_text(encoding="utf-8")), strict=True):
            assert {key: "" if value is None else str(value) for key, value in typed.items()} == plain


def test_an_unknown_table_ending_or_run_is_one_line(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, word in (
        (["export", str(file), "--table", "moon", "-o", "x.csv"], "table must be one of counts, "),
        (["export", str(file), "-o", "x.xlsx"], "output must end in .csv or .parquet"),
        (["export", str(file), "-o", str(tmp_path / "no" / "x.csv")], "cannot be written"),
        (["export", str(tmp_path / "none.sqlite"), "-o", "-"], "no such metrics file"),
        (["show", str(file), "--run", "7"], "run must be 1 to 1"),
        (["show", str(file), "--last", "soon"], "--last must be a whole number of s, m, h or d"),
    ):
        assert main(["metrics", *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert word in line


def test_a_damaged_file_is_one_line_wherever_it_is_damaged(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whole pages overwritten: SQLite finds out at once or in the middle of a query; never a traceback."""
    whole = file.read_bytes()
    told: list[str] = []
    for page in range(1, len(whole) // 4096):
        bad = tmp_path / f"bad{page}.sqlite"
        bad.write_bytes(whole[: 4096 * page] + b"\xa5" * 4096 + whole[4096 * (page + 1) :])
        for arguments in (["show", str(bad)], ["export", str(bad), "-o", str(tmp_path / "x.csv")]):
            if main(["metrics", *arguments]) != 0:
                told.append(capsys.readouterr().err)
            capsys.readouterr()
    assert told
    assert all(len(text.splitlines()) == 1 and "metrics file" in text for text in told)
    cut = tmp_path / "cut.sqlite"
    cut.write_bytes(whole[:5000])
    with pytest.raises(FileError, match="metrics file"):
        summarise(cut)


def test_a_file_of_another_version_is_told_apart(file: Path, tmp_path: Path) -> None:
    old = tmp_path / "old.sqlite"
    old.write_bytes(file.read_bytes())
    with sqlite3.connect(old) as connection:
        connection.execute("UPDATE meta SET version = 1")
    with pytest.raises(FileError, match="metrics of version 1, this program has version 2: move the file away"):
        export(old, "counts", "-")


def test_a_file_on_a_read_only_medium_can_be_read(file: Path, tmp_path: Path) -> None:
    """No companion files beside it, none can be made: as after copying a file to an archive."""
    folder = tmp_path / "archive"
    folder.mkdir()
    (folder / "m.sqlite").write_bytes(file.read_bytes())
    folder.chmod(0o555)
    try:
        assert summarise(folder / "m.sqlite").frames == 272
    finally:
        folder.chmod(0o755)


def test_times_are_whole_numbers_with_a_unit() -> None:
    assert [seconds_of(text) for text in ("90s", "10m", "2h", "7d")] == [90.0, 600.0, 7200.0, 604800.0]
    for text in ("", "h", "2", "-1h", "1.5h", "0s", "9999d", "²h"):
        with pytest.raises(ConfigError):
            seconds_of(text)


def test_the_last_while_alone_is_added(file: Path) -> None:
    assert summarise(file, last_s=60.0).frames == 272
    assert summarise(file).hops[0].p99_ms == 0.3
    assert summarise(file).rates == {"decoder/decoder frames": 100.0}
