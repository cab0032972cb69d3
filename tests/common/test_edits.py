"""Differences of texts: by hand, by properties, and against a search that tries everything."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.edits import Edits, edits
from support import text_light

SHORT = st.text("ab ", max_size=7)


@pytest.mark.parametrize(
    ("sent", "read", "by_hand"),
    [
        ("", "", (0, 0, 0)),
        ("kitten", "sitting", (2, 0, 1)),
        ("abc", "", (0, 3, 0)),
        ("", "ab", (0, 0, 2)),
        ("abcd", "bcd", (0, 1, 0)),
        ("ab", "ba", (2, 0, 0)),
        ("summer's day", "summer's dey?", (1, 0, 1)),
    ],
)
def test_texts_worked_by_hand(sent: str, read: str, by_hand: tuple[int, int, int]) -> None:
    assert edits(sent, read) == Edits(len(sent), *by_hand)


def test_the_rate_is_of_the_characters_sent() -> None:
    assert edits("abcd", "abxdyy").cer == 0.75
    assert edits("", "a").cer is None


@given(SHORT, SHORT)
def test_it_is_the_least_of_all_ways_and_of_these_the_one_with_the_fewest_gaps(sent: str, read: str) -> None:
    @cache
    def best(i: int, j: int) -> tuple[int, int]:
        if i == len(sent) or j == len(read):
            return (len(sent) - i + len(read) - j,) * 2
        ways = [best(i + 1, j), best(i, j + 1)]
        both = best(i + 1, j + 1)
        return min([(n + 1, gaps + 1) for n, gaps in ways] + [(both[0] + (sent[i] != read[j]), both[1])])

    found = edits(sent, read)
    assert (found.errors, found.missing + found.inserted) == best(0, 0)
    assert found.inserted - found.missing == len(read) - len(sent)
    assert found.errors == text_light.edits(sent, read)


@given(SHORT, SHORT)
def test_the_way_back_swaps_missing_and_inserted(sent: str, read: str) -> None:
    there, back = edits(sent, read), edits(read, sent)
    assert (there.replaced, there.missing, there.inserted) == (back.replaced, back.inserted, back.missing)
