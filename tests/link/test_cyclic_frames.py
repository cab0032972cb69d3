"""Words of seed11 against vectors worked by hand, and the arithmetic of rotations against a plain one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from heliograph.errors import Refusal
from heliograph.link.frames import (
    PARITIES,
    CyclicCode,
    bits_of,
    cyclic_code,
    cyclic_distance,
    cyclic_runs,
    least_distance,
    rotated,
    rotations,
    seed11_code,
    word_of,
)
from heliograph.link.modulations import modulation
from heliograph.link.modulations.seed11 import Seed11
from reference import cyclic_plain as plain

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "seed11.json").read_text("utf-8"))
WORDS = st.integers(4, 16).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, 2**n - 1), st.integers(0, 2**n - 1)))


def text(word: int, n: int) -> str:
    return f"{word:0{n}b}"


@pytest.mark.parametrize("frame", VECTORS["frames"], ids=lambda f: f"{f['payload']}-{f['parity']}")
def test_a_frame_is_the_one_worked_by_hand(frame: dict[str, str | int]) -> None:
    assert "".join(map(str, Seed11(str(frame["parity"])).encode(int(frame["payload"])))) == frame["bits"]


def test_the_papers_received_bits_are_a_rotation_of_its_frame() -> None:
    given_ = VECTORS["rotation"]
    word = seed11_code("even").words[given_["payload"]]
    assert int(given_["received"], 2) in rotations(word, 11)


@pytest.mark.parametrize("parity", PARITIES)
def test_the_ambiguous_pairs_are_the_eight_of_the_notes(parity: str) -> None:
    code = Seed11(parity).code
    pairs = sorted({(min(p, q), max(p, q)) for p, others in code.twins.items() for q in others})
    assert [list(pair) for pair in pairs] == VECTORS["ambiguous"][parity]
    assert pairs == plain.ambiguous_pairs(parity)
    assert len(code.words) - len(code.twins) == 48


@pytest.mark.parametrize("parity", PARITIES)
def test_the_encoder_refuses_an_ambiguous_payload_and_names_its_twin(parity: str) -> None:
    link = Seed11(parity)
    for low, high in VECTORS["ambiguous"][parity]:
        with pytest.raises(ValueError, match=rf"payload {low} cannot be sent: .* reads like {high} "):
            link.encode(low)
        with pytest.raises(ValueError, match=rf"payload {high} cannot be sent: .* reads like {low} "):
            link.encode(high)


@pytest.mark.parametrize("parity", PARITIES)
def test_advice_is_given_against_square_waves_alone(parity: str) -> None:
    link = Seed11(parity)
    advised = [p for p in range(64) if link.advice(p) is not None]
    assert advised == VECTORS["periodic"][parity]
    assert link.code.longest_run == VECTORS["longest_run"][parity]
    for payload in advised:
        assert len(link.encode(payload)) == 11


def test_the_words_differ_by_two_bits_at_any_rotation() -> None:
    for parity in PARITIES:
        code = Seed11(parity).code
        safe = [text(word, 11) for p, word in enumerate(code.words) if p not in code.twins]
        assert code.distance == plain.least_distance(safe) == 2


@pytest.mark.parametrize("payload", [-1, 64, 1000])
def test_a_payload_outside_the_range_is_refused(payload: int) -> None:
    with pytest.raises(ValueError, match=rf"payload must be in \[0, 63\], not {payload}"):
        Seed11().encode(payload)


def test_unknown_options_and_receivers_are_refused_with_the_choice() -> None:
    with pytest.raises(ValueError, match="parity must be one of even, paper_text, not 'odd'"):
        Seed11("odd")
    with pytest.raises(ValueError, match="receiver of seed11 must be one of default, paper, paper_tuned, binning"):
        Seed11().receiver(1000.0, "best")
    with pytest.raises(ValueError, match="receiver of code must be one of default, binning, binning_tuned"):
        modulation("code").receiver(1000.0, "paper")
    with pytest.raises(ValueError, match="bit rate must be in"):
        Seed11().receiver(0.0)
    with pytest.raises(ValueError, match="periodic must be one of refused, read, believed, not 2"):
        modulation("seed11", periodic=2)
    with pytest.raises(ValueError, match="payload of code20d4 must be in"):
        modulation("code").encode(522)


def test_a_clear_word_outside_the_code_is_refused_for_its_first_fault() -> None:
    code = seed11_code("even")
    assert code.hard_refusal(int("01101010101", 2)) is Refusal.NO_START_CODE
    assert code.hard_refusal(int("11101010100", 2)) is Refusal.PARITY
    assert CyclicCode("book", 11, code.words).hard_refusal(0) is Refusal.UNKNOWN_WORD


@given(WORDS)
def test_rotations_runs_and_distances_are_those_of_strings(case: tuple[int, int, int]) -> None:
    n, a, b = case
    assert [text(word, n) for word in rotations(a, n)] == plain.turns(text(a, n))
    assert max(cyclic_runs(a, n)) == min(plain.longest_cyclic_run(text(a, n)), n)
    assert sum(cyclic_runs(a, n)) == n
    others = plain.turns(text(b, n))[1:] if a == b else plain.turns(text(b, n))
    assert cyclic_distance(a, b, n) == min(plain.distance(text(a, n), other) for other in others)
    assert word_of(bits_of(a, n)) == a
    assert rotated(rotated(a, n, 3), n, n - 3) == a
    if a != b:
        assert least_distance([a, b], n) == plain.least_distance([text(a, n), text(b, n)])


@pytest.mark.parametrize(
    ("n", "words", "fault"),
    [
        (3, [1], "4 to 32 bits, not 3"),
        (33, [1], "4 to 32 bits, not 33"),
        (8, [], "at least one word"),
        (8, [1, 1], "given twice"),
        (8, [256], "more than 8 bits"),
    ],
)
def test_a_code_of_unsound_words_is_refused(n: int, words: list[int], fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        cyclic_code("x", n, words)
