"""docs/wire.md says what the code packs."""

from __future__ import annotations

import importlib.util
import re
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from heliograph.streams import Onsets
from support.records import every_record

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def make_wire() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_wire", ROOT / "docs" / "make_wire.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_generated_part_of_the_page_is_up_to_date(make_wire: ModuleType) -> None:
    assert (ROOT / "docs" / "wire.md").read_text(encoding="utf-8") == make_wire.page(), "run python docs/make_wire.py"


def test_every_schema_has_a_section_and_every_topic_a_row(make_wire: ModuleType) -> None:
    assert make_wire.undocumented() == []
    page = make_wire.generated()
    for topic in make_wire.TOPICS:
        assert f"\n| `{topic}` |" in page


@pytest.mark.parametrize(
    ("name", "words"),
    [("TimeUs", "int (≥ -2^53, ≤ 2^53)"), ("Share", "float (≥ 0, ≤ 1)"), ("Name", "str (name)")],
)
def test_ranges_are_told_in_words(make_wire: ModuleType, name: str, words: str) -> None:
    from heliograph import messages  # noqa: PLC0415 - by name

    assert make_wire.type_words(getattr(messages, name)) == words


def test_the_recipe_for_onsets_reads_what_was_sent() -> None:
    recipe = re.search(r"```python\n(raw = .*?)```", (ROOT / "docs" / "wire.md").read_text(encoding="utf-8"), re.DOTALL)
    assert recipe is not None
    onsets = every_record()[1]
    assert isinstance(onsets, Onsets)
    read: dict[str, Any] = {"np": np, "zlib": zlib, "body": onsets.to_body()}
    exec(recipe[1], read)  # the page's own text
    for name, column in (
        ("tick", onsets.tick),
        ("x", onsets.x_px),
        ("y", onsets.y_px),
        ("on", onsets.on_count),
        ("off", onsets.off_count),
    ):
        assert read[name].tolist() == column.tolist()
