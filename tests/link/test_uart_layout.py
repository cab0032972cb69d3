"""The bits of a text."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from heliograph.link.modulations import modulation
from heliograph.link.uart_layout import word_table

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "uart.json").read_text())


@pytest.mark.parametrize("vector", VECTORS["texts"], ids=lambda v: repr(v["text"]))
def test_a_text_is_sent_as_worked_out_by_hand(vector: dict[str, str]) -> None:
    assert modulation("uart").encode(vector["text"]) == tuple(int(bit) for bit in vector["bits"])


def test_every_character_has_even_parity_and_differs_from_all_others_in_two_bits() -> None:
    words = [int(word) for word in word_table()]
    assert all((word >> 2).bit_count() % 2 == 0 and word & 3 == 3 and word < 1 << 10 for word in words)
    assert min((a ^ b).bit_count() for a in words for b in words if a != b) == 2


@pytest.mark.parametrize(("text", "named"), [("", "at least 1"), ("caf\u00e9", "'\u00e9'"), ("a\x7f", "DEL")])
def test_what_cannot_be_sent_is_refused_by_name(text: str, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        modulation("uart").encode(text)


def test_an_unknown_receiver_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="'nonesuch'"):
        modulation("uart").receiver(504.0, "nonesuch")


def test_a_bit_rate_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="bit rate"):
        modulation("uart").receiver(0.0)
