/* Frames of light: which bits go on the air. The first on the air is bit 7 of byte 0; 1 is lit, 0 dark.
 *
 *   seed11   1110 PPPPPP C        C: parity of the payload, `even` (C = 1 for an odd number of ones) or the opposite
 *   code     a word of a book, 4 to 32 bits
 *   uart     0 DDDDDDD P 1 1      start, 7-bit ASCII (most significant bit first), even parity, two stop bits
 *   packet   see hg_packet.h
 *
 * The layouts are those of the decoder (common/heliograph/link/), and both are tested with tests/vectors/.
 */
#ifndef HG_FRAMES_H
#define HG_FRAMES_H

#include <stdbool.h>
#include <stdint.h>

#include "hg_limits.h"

#define HG_SEED11_BITS 11u
#define HG_SEED11_PAYLOADS 64u
#define HG_UART_BITS 11u
#define HG_UART_CODES 127u /* DEL is time fill, not text */

typedef struct {
    uint8_t bytes[HG_FRAME_BYTES];
    uint16_t n;
} hg_bits;

/* Put n bits, at most 32, behind what is there; first on the air = most significant. */
void hg_bits_put(hg_bits *bits, uint32_t value, uint8_t n);

/* The word of a payload, 0 to 63; odd: the parity of the paper's sentence ("paper_text"). */
uint16_t hg_seed11_word(uint8_t payload, bool odd);

/* Whether another payload's word is a rotation of this one's. */
bool hg_seed11_ambiguous(uint8_t payload, bool odd);

/* The 11 bits of a character, 0 to 127. */
uint16_t hg_uart_word(uint8_t code);

#endif
