#include "hg_line.h"

#include "hg_bytes.h"
#include "hg_check.h"

static void put(hg_line *line, uint8_t byte)
{
    if (line->n == HG_BODY_MOST) {
        line->broken = true;
        return;
    }
    line->body[line->n++] = byte;
}

/* A 00 came: check what lies before it, and begin anew. */
static size_t ended(hg_line *line)
{
    const bool whole = line->begun && !line->broken && line->block == 0u;
    const uint16_t n = line->n;
    const bool begun = line->begun;
    line->n = 0;
    line->block = 0;
    line->zero = false;
    line->begun = false;
    line->broken = false;
    if (!begun) {
        return 0;
    }
    if (whole && n >= HG_HEAD_BYTES + HG_CRC_BYTES) {
        const size_t checked = (size_t)n - HG_CRC_BYTES;
        if (hg_crc16(line->body, checked) == hg_get16(line->body + checked)) {
            return checked;
        }
    }
    line->bad++;
    return 0;
}

size_t hg_line_take(hg_line *line, uint8_t byte)
{
    if (byte == 0u) {
        return ended(line);
    }
    line->begun = true;
    if (line->broken) {
        return 0;
    }
    if (line->block > 0u) {
        line->block--;
        put(line, byte);
        return 0;
    }
    if (line->zero) {
        put(line, 0u);
    }
    line->block = (uint8_t)(byte - 1u);
    line->zero = byte != 0xFFu;
    return 0;
}

size_t hg_line_frame(uint8_t *wire, uint8_t *body, size_t n)
{
    hg_put16(body + n, hg_crc16(body, n));
    n += HG_CRC_BYTES;
    size_t at = 0;
    wire[at++] = 0;
    size_t code = at++; /* a body of at most 254 bytes never needs FF and one more */
    for (size_t i = 0; i < n; i++) {
        if (body[i] != 0u) {
            wire[at++] = body[i];
        } else {
            wire[code] = (uint8_t)(at - code);
            code = at++;
        }
    }
    wire[code] = (uint8_t)(at - code);
    wire[at++] = 0;
    return at;
}
