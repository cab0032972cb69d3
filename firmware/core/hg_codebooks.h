/* The stored codebooks of `code`: a payload is the index of its word, so neither book may ever change.
 * hg_codebooks.c is written by firmware/tools/make_codebooks.py from common/heliograph/link/codebooks/. */
#ifndef HG_CODEBOOKS_H
#define HG_CODEBOOKS_H

#include <stdint.h>

#define HG_BOOKS 2u /* 1 code18d4, 2 code20d4 */

/* How many words the book (1 or 2) has. */
uint16_t hg_book_words(uint8_t book);

/* How many bits each has. */
uint8_t hg_book_bits(uint8_t book);

/* A word; first on the air = most significant. */
uint32_t hg_book_word(uint8_t book, uint16_t index);

#endif
