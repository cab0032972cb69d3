/* A packet of light. The layout, first on the air at the left (common/heliograph/link/packet_layout.py is its home):
 *
 *   SYNC  24 bits, 111100110011010010101000
 *   BODY  the code bits of HEADER | DATA | CRC-32 | TAIL (six zeros), punctured, interleaved, scrambled
 *
 *   HEADER AAAAAAAA K NNNN FFFFFF LLLLL  address, kind (1 text), number, fragment, bytes used (31: all, more follow)
 *
 *   Code         K = 7, A = 171, B = 133 (octal), patterns of DVB-S: 1/2, 2/3, 3/4, 5/6
 *   Interleaver  code bit i goes to place i S^-1 mod N; S the least number, coprime to N, of at least N / 7
 *   Scrambler    place j is inverted where PN9 (x^9 + x^5 + 1, begun with nine ones) is one
 *
 * hg_packet_frame divides and takes some milliseconds on eight bits: it runs in the main loop, one frame ahead.
 */
#ifndef HG_PACKET_H
#define HG_PACKET_H

#include <stdbool.h>
#include <stdint.h>

#include "hg_frames.h"

#define HG_PACKET_RATES 4u
#define HG_BLOCK_LEAST 4u
#define HG_BLOCK_MOST 30u
#define HG_FRAGMENTS 64u

typedef struct {
    uint8_t address;
    bool text;
    uint8_t number;   /* 0 to 15 */
    uint8_t fragment; /* 0 to 63 */
    bool more;        /* further fragments follow: then the data fill the block */
    const uint8_t *data;
    uint8_t n;        /* bytes of data that are used, at most block */
} hg_packet;

/* Write a packet's bits. block: 4 to 30 bytes of data; rate: 0 to 3 for 1/2, 2/3, 3/4, 5/6. */
void hg_packet_frame(hg_bits *bits, const hg_packet *packet, uint8_t block, uint8_t rate);

#endif
