"""Stored books never change and keep their promises; books of others are read or refused; the command."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import ConfigError, FileError
from heliograph.link.codebook import STORED, Codebook, generate, load
from heliograph.link.modulations.code import Code
from heliograph_services.cli import codebook as command
from reference import cyclic_plain as plain
from support.lights import Light, read, repeated, seen

VECTORS = json.loads((Path(__file__).parents[1] / "vectors" / "code.json").read_text("utf-8"))


def texts(book: Codebook) -> list[str]:
    return [f"{word:0{book.bits}b}" for word in book.words]


@pytest.mark.parametrize("name", STORED)
def test_a_stored_book_is_the_one_that_beacons_in_the_field_use(name: str) -> None:
    book, known = load(name), VECTORS["books"][name]
    words = texts(book)
    assert hashlib.sha256("\n".join(words).encode()).hexdigest() == known["sha256_of_words_joined_by_newline"]
    link = Code(name)
    for payload, word in known["words"].items():
        assert "".join(map(str, link.encode(int(payload)))) == word


@pytest.mark.parametrize(("name", "bits", "ids"), [("code18d4", 18, 160), ("code20d4", 20, 500)])
def test_a_stored_book_has_distance_4_runs_of_at_most_5_and_enough_ids(name: str, bits: int, ids: int) -> None:
    book = load(name)
    assert book.bits == bits
    assert len(book.words) >= ids
    assert book.distance == 4
    assert book.max_run == max(plain.longest_cyclic_run(word) for word in texts(book)) == 5
    # The plain distance of all pairs takes minutes for 20 bits: every 5th word against all, for 18 bits every one.
    words = texts(book)
    step = 1 if bits == 18 else 20
    for word in words[::step]:
        assert all(plain.distance(word, own) >= 4 for own in plain.turns(word)[1:])
        turned = [int(turn, 2) for turn in plain.turns(word)]
        for other in book.words:
            assert int(word, 2) == other or min((other ^ turn).bit_count() for turn in turned) >= 4


def test_the_search_gives_the_stored_books_again() -> None:
    book = generate(18, 4)
    assert book == load("code18d4")


@settings(max_examples=20)
@given(st.integers(6, 12), st.integers(1, 4), st.integers(3, 8), st.integers(0, 5))
def test_a_found_book_keeps_what_was_asked(bits: int, distance: int, max_run: int, seed: int) -> None:
    try:
        book = generate(bits, distance, min(max_run, bits), seed)
    except ConfigError:
        return
    words = texts(book)
    assert plain.least_distance(words) == book.distance >= distance
    assert max(plain.longest_cyclic_run(word) for word in words) <= max_run
    assert generate(bits, distance, min(max_run, bits), seed) == book


def test_a_book_as_a_list_of_bits_is_read_like_one_of_texts(tmp_path: Path) -> None:
    words = [[0, 0, 0, 1, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1]]
    (tmp_path / "lists.json").write_text(json.dumps(words), "utf-8")
    (tmp_path / "texts.json").write_text(json.dumps({"sequences": ["0001011", "0000111"]}), "utf-8")
    lists, strings = Code(str(tmp_path / "lists.json")), Code(str(tmp_path / "texts.json"))
    assert lists.encode(0) == strings.encode(0) == (0, 0, 0, 1, 0, 1, 1)
    assert lists.code.name == "lists"
    assert lists.advice(0) is None
    assert lists.advice(1) is not None


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("3", "must list 1 to 4096 words"),
        ("[]", "must list 1 to 4096 words"),
        ('["0011", "001"]', "the same length"),
        ("[1, 2]", "the same length"),
        ('["0012"]', "word 0 has a bit that is neither 0 nor 1"),
        ('[[0, 0, 1, "1"]]', "word 0 has a bit that is neither 0 nor 1"),
        ('["0011", "1001"]', "or rotations of them, are the same"),
        ('["0101", "1010"]', "or rotations of them, are the same"),
        ('["0000"]', "must hold both a 0 and a 1"),
    ],
)
def test_a_damaged_book_is_refused_in_one_line(tmp_path: Path, content: str, fault: str) -> None:
    path = tmp_path / "book.json"
    path.write_text(content, "utf-8")
    with pytest.raises(FileError, match=fault) as raised:
        Code(str(path))
    assert "\n" not in str(raised.value)


def test_a_missing_book_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot be read"):
        load(str(tmp_path / "none.json"))
    with pytest.raises(ValueError, match="codebook must be one of code18d4, code20d4 or a path"):
        load("code19d4")
    huge = tmp_path / "huge.json"
    huge.write_bytes(b" " * 2_000_001)
    with pytest.raises(FileError, match="larger than"):
        load(str(huge))


def test_the_command_lists_shows_and_generates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.run(["list", "--json"]) == 0
    listed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [book["name"] for book in listed] == list(STORED)
    assert command.run(["list"]) == 0
    assert command.run(["show", "code18d4"]) == 0
    assert f"    0  {VECTORS['books']['code18d4']['words']['0']}" in capsys.readouterr().out
    path = tmp_path / "mine.json"
    assert command.run(["generate", "--bits", "10", "--distance", "2", "--at-least", "5", "-o", str(path)]) == 0
    assert "mine" in capsys.readouterr().out
    assert load(str(path)).bits == 10
    assert command.run(["generate", "--bits", "8", "--distance", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["bits"] == 8
    assert command.run(["show", str(path), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["words"]) >= 5


@pytest.mark.parametrize(
    ("argv", "fault"),
    [
        (["generate", "--bits", "40", "--distance", "4"], "bits must be in [4, 24], not 40"),
        (["generate", "--bits", "8", "--distance", "2", "--at-least", "99"], "not at least 99"),
        (["generate", "--bits", "5", "--distance", "4"], "no word of 5 bits has distance 4"),
        (["generate", "--bits", "8", "--distance", "2", "-o", "/nowhere/x.json"], "cannot be written"),
        (["show", "nothing"], "codebook must be one of"),
    ],
)
def test_the_commands_mistakes_are_one_line_and_status_2(
    argv: list[str], fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run(argv) == 2
    error = capsys.readouterr().err
    assert fault in error
    assert error.count("\n") == 1


# Twelve bits, distance 3: two words that turn into themselves after six bits (one is a square wave), and four others.
SEQUENCES = """0,0,1,0,0,1,0,1,0,1,1,1
0,0,0,1,0,0,1,1,0,1,1,1

0,0,0,1,1,1,0,0,0,1,1,1
0,0,1,0,1,1,0,0,1,0,1,1
0,0,1,1,0,1,1,0,1,0,1,1
0,0,0,1,1,0,0,1,1,1,0,1
"""


@pytest.fixture
def sequences(tmp_path: Path) -> Path:
    path = tmp_path / "sequences.txt"
    path.write_text(SEQUENCES, "utf-8")
    return path


def test_a_sequence_file_of_uvdar_is_a_book(sequences: Path) -> None:
    book = load(str(sequences))
    assert (book.name, book.bits, len(book.words), book.distance) == ("sequences", 12, 6, 3)
    link = Code(str(sequences))
    assert link.encode(1) == (0, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1, 1)
    assert link.code.periodic == {2}
    assert link.advice(2) is not None
    assert link.advice(3) is None


@pytest.mark.parametrize("payload", range(6))
def test_every_word_of_a_sequence_file_is_read_those_that_turn_into_themselves_too(
    sequences: Path, payload: int
) -> None:
    link = Code(str(sequences), periodic="believed")
    receiver = link.receiver(60.0)
    what = seen(Light(), repeated(link.encode(payload), 12), 60.0, 1)
    frames = read(receiver, what)
    assert {frame.payload for frame in frames} == {payload}
    assert len(frames) >= 10
    identity = receiver.identity()
    assert identity is not None
    assert identity.payload == payload


def test_a_line_with_another_number_of_bits_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "book.txt"
    path.write_text("0,0,1,1\n0,1,1\n", "utf-8")
    with pytest.raises(FileError, match="the same length"):
        load(str(path))
    path.write_text("0,0,1,1\n0,1,1,2\n", "utf-8")
    with pytest.raises(FileError, match="word 1 has a bit that is neither 0 nor 1"):
        load(str(path))
