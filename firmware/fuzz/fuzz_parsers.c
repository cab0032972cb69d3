/* libFuzzer on the parsers alone, without the beacon around them; ASan and UBSan watch. The first byte of the input says which:
 *   0 mod 3   the line: bytes as they come. A body that is taken, framed anew, is taken again, and is the same
 *   1 mod 3   a body: what is framed comes out of the line as it went in, wherever the line stood before, and does not come
 *             out at all where one of its bytes is another (the input's next two say which, and which it is then)
 *   2 mod 3   a record, as SET and as the store hold it: what is taken is written as the same bytes, and read back from the store
 */
#include <stdlib.h>
#include <string.h>

#include "hg_beacon.h"
#include "hg_bytes.h"
#include "hg_line.h"
#include "hg_store.h"

typedef struct {
    uint8_t bytes[HG_STORE_MOST];
    size_t n;
} memory;

static void demand(bool truth)
{
    if (!truth) {
        abort();
    }
}

/* Put bytes on a line; return how many bodies came out, the last one's length in *length. */
static size_t taken(hg_line *line, const uint8_t *bytes, size_t n, size_t *length)
{
    size_t bodies = 0;
    for (size_t i = 0; i < n; i++) {
        const size_t body = hg_line_take(line, bytes[i]);
        if (body > 0u) {
            *length = body;
            bodies++;
        }
    }
    return bodies;
}

static void comes_back(const uint8_t *body, size_t n, hg_line *line)
{
    uint8_t copy[HG_BODY_MOST];
    uint8_t wire[HG_WIRE_MOST];
    size_t length = 0;
    memcpy(copy, body, n);
    const size_t wired = hg_line_frame(wire, copy, n);
    demand(wired <= HG_WIRE_MOST && wire[0] == 0 && wire[wired - 1] == 0 && memchr(wire + 1, 0, wired - 2) == 0);
    /* What the line had begun may end as a frame of its own at the first 00. */
    demand(taken(line, wire, wired, &length) >= 1u && length == n && memcmp(line->body, body, n) == 0);
}

static void try_line(const uint8_t *data, size_t size)
{
    hg_line line = {0};
    for (size_t i = 0; i < size; i++) {
        const size_t n = hg_line_take(&line, data[i]);
        if (n > 0u) {
            uint8_t body[HG_BODY_MOST];
            hg_line other = {0};
            demand(n >= HG_HEAD_BYTES && n + HG_CRC_BYTES <= HG_BODY_MOST);
            memcpy(body, line.body, n);
            comes_back(body, n, &other);
        }
    }
}

/* Whether a place on the wire holds a byte of the body, no delimiter and no code of COBS. */
static bool holds_body(const uint8_t *wire, size_t place)
{
    size_t code = 1;
    while (wire[code] != 0u && code < place) {
        code += wire[code];
    }
    return code != place && wire[place] != 0u;
}

static void try_body(const uint8_t *data, size_t size)
{
    const size_t most = HG_BODY_MOST - HG_CRC_BYTES;
    if (size < 2u + HG_HEAD_BYTES) {
        return;
    }
    const size_t n = size - 2u < most ? size - 2u : most;
    const uint8_t *const body = data + 2;
    hg_line line = {0};
    size_t length = 0;
    (void)taken(&line, data, size, &length);
    comes_back(body, n, &line);

    uint8_t copy[HG_BODY_MOST];
    uint8_t wire[HG_WIRE_MOST];
    memcpy(copy, body, n);
    const size_t wired = hg_line_frame(wire, copy, n);
    const size_t place = data[0] % wired;
    if (holds_body(wire, place) && data[1] != 0u && data[1] != wire[place]) {
        hg_line fresh = {0};
        wire[place] = data[1];
        /* One byte of the body is another: a burst of 8 bits at most, which a CRC of 16 always sees. (A code that is another
         * moves a 00, and one such in 65,536 is not seen.) */
        demand(taken(&fresh, wire, wired, &length) == 0u);
    }
}

static bool keep(void *context, const uint8_t *bytes, size_t n)
{
    memory *const self = context;
    demand(n <= sizeof self->bytes);
    memcpy(self->bytes, bytes, n);
    self->n = n;
    return true;
}

static size_t recall(void *context, uint8_t *bytes)
{
    const memory *const self = context;
    memcpy(bytes, self->bytes, self->n);
    return self->n;
}

static void try_record(const uint8_t *data, size_t size)
{
    static const hg_hardware hardware = {
        .capabilities = 0x30F, .rate_least = 50000, .rate_most = 20000000, .ticks_per_s = 1000000, .port = "fuzz"};
    memory kept = {.n = size < HG_STORE_MOST ? size : HG_STORE_MOST};
    const hg_port port = {.context = &kept, .save = keep, .load = recall};
    hg_program program;
    hg_program again;
    memcpy(kept.bytes, data, kept.n);
    (void)hg_store_load(&port, &hardware, &program);
    memset(&program, 0, sizeof program);
    const hg_verdict verdict = hg_program_read(&program, &hardware, data, size);
    if (verdict.result != HG_OK) {
        demand(program.protocol == HG_NONE && (verdict.result != HG_RANGE || verdict.field < size));
        return;
    }
    uint8_t record[HG_RECORD_MOST];
    const size_t n = hg_program_write(record, &program);
    demand(n == size && memcmp(record, data, n) == 0);
    demand(hg_store_save(&port, &program) && hg_store_load(&port, &hardware, &again));
    demand(hg_program_write(record, &again) == size && memcmp(record, data, size) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size == 0u) {
        return 0;
    }
    switch (data[0] % 3u) {
    case 0:
        try_line(data + 1, size - 1u);
        break;
    case 1:
        try_body(data + 1, size - 1u);
        break;
    default:
        try_record(data + 1, size - 1u);
        break;
    }
    return 0;
}
