"""Write firmware/core/hg_codebooks.c from the stored codebooks: `python firmware/tools/make_codebooks.py`."""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BOOKS = ("code18d4", "code20d4")
TARGET = ROOT / "firmware/core/hg_codebooks.c"

HEAD = """/* Written by firmware/tools/make_codebooks.py; a word takes three bytes, most significant first. */
#include "hg_codebooks.h"

#include "hg_flash.h"

"""
TAIL = """typedef struct {
    const uint8_t *words;
    uint16_t n;
    uint8_t bits;
} book;
static const book BOOKS[HG_BOOKS] = {
%s};

uint16_t hg_book_words(uint8_t number)
{
    return BOOKS[number - 1u].n;
}

uint8_t hg_book_bits(uint8_t number)
{
    return BOOKS[number - 1u].bits;
}

uint32_t hg_book_word(uint8_t number, uint16_t index)
{
    const uint8_t *const at = BOOKS[number - 1u].words + 3u * (uint32_t)index;
    return ((uint32_t)hg_flash(at) << 16) | ((uint32_t)hg_flash(at + 1) << 8) | hg_flash(at + 2);
}
"""


def source() -> str:
    """Return the text of hg_codebooks.c."""
    tables, rows = [], []
    for name in BOOKS:
        book = json.loads((ROOT / f"common/heliograph/link/codebooks/{name}.json").read_text())
        words = [int(word, 2).to_bytes(3, "big") for word in book["words"]]
        triples = [", ".join(f"0x{byte:02x}" for byte in word) + "," for word in words]
        lines = ["    " + " ".join(triples[i : i + 6]) for i in range(0, len(triples), 6)]
        tables.append(f"static const uint8_t {name.upper()}[] HG_FLASH = {{\n" + "\n".join(lines) + "\n};\n\n")
        rows.append(f"    {{{name.upper()}, {len(words)}, {book['bits']}}},\n")
    return HEAD + "".join(tables) + TAIL % "".join(rows)


if __name__ == "__main__":
    TARGET.write_text(source())
