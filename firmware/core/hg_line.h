/* The serial line: COBS frames around bodies with a CRC (PROTOCOL.md, "On the wire").
 *
 * COBS (S. Cheshire, M. Baker, "Consistent overhead byte stuffing", 1999): a frame is a row of blocks; a block is a code
 * byte c and c - 1 bytes that are not 00; it stands for those bytes and, where c is not FF, for a 00 after them, but
 * for the last one's. 00 itself ends the frame.
 */
#ifndef HG_LINE_H
#define HG_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hg_limits.h"

/* Takes the line's bytes one by one; all zero is its beginning. */
typedef struct {
    uint8_t body[HG_BODY_MOST];
    uint16_t n;     /* bytes of the body so far */
    uint8_t block;  /* bytes that its block still holds */
    bool zero;      /* a 00 is due before the next block */
    bool begun;     /* something came since the last 00 */
    bool broken;    /* what comes up to the next 00 is lost */
    uint32_t bad;   /* frames dropped: no COBS, too long, too short, or the wrong CRC */
} hg_line;

/* Take a byte; return the length of the body without its CRC (it lies in line->body until the next call), or 0. */
size_t hg_line_take(hg_line *line, uint8_t byte);

/* Write a body of n bytes and its CRC, framed, into wire (HG_WIRE_MOST bytes); return how many.
 * The body must have two bytes to spare behind it, for the CRC; n is at most HG_BODY_MOST - HG_CRC_BYTES. */
size_t hg_line_frame(uint8_t *wire, uint8_t *body, size_t n);

#endif
