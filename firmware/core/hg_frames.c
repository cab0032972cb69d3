#include "hg_frames.h"

static bool odd_ones(uint8_t value)
{
    value = (uint8_t)(value ^ (value >> 4));
    value = (uint8_t)(value ^ (value >> 2));
    value = (uint8_t)(value ^ (value >> 1));
    return (value & 1u) != 0u;
}

void hg_bits_put(hg_bits *bits, uint32_t value, uint8_t n)
{
    while (n > 0u) {
        n--;
        const uint8_t mask = (uint8_t)(0x80u >> (bits->n & 7u));
        uint8_t *const byte = &bits->bytes[bits->n >> 3];
        *byte = (uint8_t)(((value >> n) & 1u) != 0u ? *byte | mask : *byte & (uint8_t)~mask);
        bits->n++;
    }
}

uint16_t hg_seed11_word(uint8_t payload, bool odd)
{
    const uint16_t check = odd_ones(payload) != odd ? 1u : 0u;
    return (uint16_t)(0x700u | (uint16_t)((uint16_t)payload << 1) | check);
}

bool hg_seed11_ambiguous(uint8_t payload, bool odd)
{
    uint16_t turned = hg_seed11_word(payload, odd);
    const uint16_t own = turned;
    for (uint8_t by = 1; by < HG_SEED11_BITS; by++) {
        turned = (uint16_t)(((uint16_t)(turned << 1) | (turned >> (HG_SEED11_BITS - 1u))) & 0x7FFu);
        const uint8_t other = (uint8_t)((turned >> 1) & 0x3Fu);
        if (turned != own && hg_seed11_word(other, odd) == turned) {
            return true;
        }
    }
    return false;
}

uint16_t hg_uart_word(uint8_t code)
{
    return (uint16_t)((uint16_t)((uint16_t)code << 3) | (odd_ones(code) ? 7u : 3u));
}
