"""The check of characters on fast links: distances, and what is corrected."""

from __future__ import annotations

from itertools import combinations

import pytest

from heliograph.link.checked_characters import CHARACTERS, code_of, nearest, word15, word16


@pytest.mark.parametrize(("word_of", "bits", "distance"), [(word15, 15, 5), (word16, 16, 6)])
def test_two_characters_differ_in_five_and_six_bits(word_of: object, bits: int, distance: int) -> None:
    assert callable(word_of)
    words = [word_of(code) for code in range(CHARACTERS)]
    assert min((a ^ b).bit_count() for a, b in combinations(words, 2)) == distance
    assert max(words) < 1 << bits


@pytest.mark.parametrize(("word_of", "bits"), [(word15, 15), (word16, 16)])
def test_one_wrong_bit_is_corrected_and_two_are_withheld(word_of: object, bits: int) -> None:
    assert callable(word_of)
    table = nearest(bits)
    for code in range(CHARACTERS):
        word = word_of(code)
        assert table[word] == code
        assert all(table[word ^ (1 << i)] == 256 + code for i in range(bits))
        assert all(table[word ^ (1 << i) ^ (1 << k)] == -1 for i, k in combinations(range(bits), 2))


@pytest.mark.parametrize("character", ["\x7f", "\u00e9"])
def test_what_is_no_character_is_refused_by_name(character: str) -> None:
    with pytest.raises(ValueError, match="character 3"):
        code_of(character, 3)
    with pytest.raises(ValueError, match=r"\[0, 127\], not 128"):
        word15(128)
