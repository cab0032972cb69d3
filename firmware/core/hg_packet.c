#include "hg_packet.h"

#include <string.h>

#include "hg_bytes.h"
#include "hg_check.h"

#define SYNC 0xF334A8uL
#define SYNC_BITS 24u
#define HEADER_BYTES 3u
#define CRC_BYTES 4u
#define TAIL_BITS 6u
#define BURST 7u
#define MORE 31u
/* Newest bit first, as the octal numbers are written; the newest is the register's bit 6. */
#define POLYNOMIAL_A 0x79u
#define POLYNOMIAL_B 0x5Bu

/* Which of A and B are sent in each step of a period: bit t of a mask is step t. */
typedef struct {
    uint8_t period, a, b;
} pattern;
static const pattern PATTERNS[HG_PACKET_RATES] = {
    {1, 0x01, 0x01},
    {2, 0x01, 0x03},
    {3, 0x05, 0x03},
    {5, 0x15, 0x0B},
};

static bool parity(uint8_t value)
{
    value = (uint8_t)(value ^ (value >> 4));
    value = (uint8_t)(value ^ (value >> 2));
    return ((value ^ (value >> 1)) & 1u) != 0u;
}

static uint16_t gcd(uint16_t a, uint16_t b)
{
    while (b != 0u) {
        const uint16_t rest = (uint16_t)(a % b);
        a = b;
        b = rest;
    }
    return a;
}

/* S^-1 modulo n: where code bit 1 goes. */
static uint16_t interleaver_stride(uint16_t n)
{
    uint16_t step = (uint16_t)((n + BURST - 1u) / BURST);
    while (gcd(step, n) != 1u) {
        step++;
    }
    uint16_t place = 0;
    for (uint16_t at = 0; at != 1u; place++) {
        at = (uint16_t)(at + step);
        at = at >= n ? (uint16_t)(at - n) : at;
    }
    return place;
}

static uint16_t body_bits(uint16_t steps, const pattern *sent)
{
    uint16_t n = 0;
    for (uint16_t t = 0; t < steps; t++) {
        const uint8_t phase = (uint8_t)(t % sent->period);
        n = (uint16_t)(n + ((sent->a >> phase) & 1) + ((sent->b >> phase) & 1));
    }
    return n;
}

static void assemble(uint8_t *whole, const hg_packet *packet, uint8_t block)
{
    const uint16_t header = (uint16_t)((packet->text ? 0x8000u : 0u) | (uint16_t)((packet->number & 15u) << 11)
                                       | (uint16_t)((packet->fragment & 63u) << 5)
                                       | (packet->more ? MORE : packet->n));
    whole[0] = packet->address;
    hg_put16(whole + 1, header);
    memset(whole + HEADER_BYTES, 0, block);
    if (packet->n > 0u) {
        memcpy(whole + HEADER_BYTES, packet->data, packet->n);
    }
    hg_put32(whole + HEADER_BYTES + block, hg_crc32(whole, HEADER_BYTES + (size_t)block));
}

static void put_at(hg_bits *bits, uint16_t place, bool bit)
{
    if (bit) {
        bits->bytes[place >> 3] = (uint8_t)(bits->bytes[place >> 3] | (0x80u >> (place & 7u)));
    }
}

static void scramble(hg_bits *bits, uint16_t n)
{
    uint16_t register_ = 0x1FFu; /* bit 0 is the next one out, bit 8 the one nine places on */
    for (uint16_t j = 0; j < n; j++) {
        const uint16_t place = (uint16_t)(SYNC_BITS + j);
        if ((register_ & 1u) != 0u) {
            bits->bytes[place >> 3] = (uint8_t)(bits->bytes[place >> 3] ^ (0x80u >> (place & 7u)));
        }
        const uint16_t next = (uint16_t)((register_ ^ (register_ >> 4)) & 1u); /* b[j-9] + b[j-5] */
        register_ = (uint16_t)((register_ >> 1) | (uint16_t)(next << 8));
    }
}

void hg_packet_frame(hg_bits *bits, const hg_packet *packet, uint8_t block, uint8_t rate)
{
    uint8_t whole[HEADER_BYTES + HG_BLOCK_MOST + CRC_BYTES];
    assemble(whole, packet, block);
    const pattern *const sent = &PATTERNS[rate];
    const uint16_t data_bits = (uint16_t)(8u * (HEADER_BYTES + block + CRC_BYTES));
    const uint16_t steps = (uint16_t)(data_bits + TAIL_BITS);
    const uint16_t n = body_bits(steps, sent);
    const uint16_t stride = interleaver_stride(n);
    memset(bits, 0, sizeof *bits);
    hg_bits_put(bits, SYNC, SYNC_BITS);
    uint8_t window = 0;
    uint8_t phase = 0;
    uint16_t place = 0;
    for (uint16_t t = 0; t < steps; t++) {
        const bool bit = t < data_bits && ((whole[t >> 3] >> (7u - (t & 7u))) & 1) != 0;
        window = (uint8_t)((bit ? 0x40u : 0u) | (window >> 1));
        for (uint8_t branch = 0; branch < 2u; branch++) {
            const uint8_t mask = branch == 0u ? sent->a : sent->b;
            if (((mask >> phase) & 1) == 0) {
                continue;
            }
            const uint8_t polynomial = branch == 0u ? POLYNOMIAL_A : POLYNOMIAL_B;
            put_at(bits, (uint16_t)(SYNC_BITS + place), parity((uint8_t)(window & polynomial)));
            place = (uint16_t)(place + stride);
            place = place >= n ? (uint16_t)(place - n) : place;
        }
        phase = phase + 1u == sent->period ? 0u : (uint8_t)(phase + 1u);
    }
    bits->n = (uint16_t)(SYNC_BITS + n);
    scramble(bits, n);
}
