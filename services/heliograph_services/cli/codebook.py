"""`heliograph codebook`: the books of rotation-unique words that are stored, and the search for others.

codebook list                                     the stored books
codebook show NAME                                a book's words; NAME is a stored name or a .json file
codebook generate --bits N --distance D [...]     a new book, to a file or to stdout
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from heliograph.errors import ConfigError, FileError, HeliographError
from heliograph.link.codebook import STORED, Codebook, generate, load

# The exit status of an operator's mistake, as everywhere in heliograph.
STATUS_MISTAKE = 2


def run(argv: list[str]) -> int:
    """Run the command; return the exit status (0, or 2 with one line on stderr)."""
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.action(arguments))
    except (HeliographError, ValueError) as error:
        print(f"heliograph codebook: {error}", file=sys.stderr)
        return STATUS_MISTAKE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="heliograph codebook", description="Books of rotation-unique words.")
    actions = parser.add_subparsers(required=True, metavar="list|show|generate")
    listing = actions.add_parser("list", help="the stored books")
    listing.set_defaults(action=_list)
    show = actions.add_parser("show", help="a book's words")
    show.add_argument("name", metavar="NAME", help=f"{', '.join(STORED)}, or a .json file")
    show.set_defaults(action=_show)
    make = actions.add_parser("generate", help="search for a book")
    make.add_argument("--bits", type=int, required=True, metavar="N", help="length of a word, 4 to 24")
    make.add_argument("--distance", type=int, required=True, metavar="D", help="least distance over all rotations")
    make.add_argument("--max-run", type=int, default=5, metavar="R", help="longest run of equal bits (default 5)")
    make.add_argument("--at-least", type=int, default=1, metavar="K", help="fail with fewer words than this")
    make.add_argument("--seed", type=int, default=0, metavar="S", help="another order of the search (default 0)")
    make.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the book here")
    make.set_defaults(action=_generate)
    for action in (listing, show, make):
        action.add_argument("--json", action="store_true", help="one JSON object a line")
    return parser


def _summary(book: Codebook) -> dict[str, str | int]:
    return {
        "name": book.name,
        "ids": len(book.words),
        "bits": book.bits,
        "distance": book.distance,
        "max_run": book.max_run,
    }


def _table(books: list[Codebook]) -> None:
    print(f"{'name':<12}{'ids':>6}{'bits':>6}{'distance':>10}{'max run':>9}")
    for book in books:
        print(f"{book.name:<12}{len(book.words):>6}{book.bits:>6}{book.distance:>10}{book.max_run:>9}")


def _list(arguments: argparse.Namespace) -> int:
    books = [load(name) for name in STORED]
    if arguments.json:
        for book in books:
            print(json.dumps(_summary(book)))
    else:
        _table(books)
    return 0


def _show(arguments: argparse.Namespace) -> int:
    book = load(arguments.name)
    words = [f"{word:0{book.bits}b}" for word in book.words]
    if arguments.json:
        print(json.dumps({**_summary(book), "words": words}))
        return 0
    _table([book])
    for payload, word in enumerate(words):
        print(f"{payload:>5}  {word}")
    return 0


def _generate(arguments: argparse.Namespace) -> int:
    name = "" if arguments.output is None else arguments.output.stem
    book = generate(arguments.bits, arguments.distance, arguments.max_run, arguments.seed, name)
    if len(book.words) < arguments.at_least:
        raise ConfigError(f"the search found {len(book.words)} words, not at least {arguments.at_least}")
    if arguments.output is not None:
        try:
            arguments.output.write_text(book.to_json(), "utf-8")
        except OSError as error:
            raise FileError(f"codebook cannot be written: {error}") from None
    if arguments.json:
        words = [f"{word:0{book.bits}b}" for word in book.words]
        print(json.dumps({**_summary(book), "words": words} if arguments.output is None else _summary(book)))
    elif arguments.output is None:
        print(book.to_json(), end="")
    else:
        _table([book])
    return 0
