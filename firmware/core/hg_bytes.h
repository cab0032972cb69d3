/* Numbers in bytes, most significant first. */
#ifndef HG_BYTES_H
#define HG_BYTES_H

#include <stdint.h>

static inline uint16_t hg_get16(const uint8_t *at)
{
    return (uint16_t)((uint16_t)((uint16_t)at[0] << 8) | at[1]);
}

static inline uint32_t hg_get32(const uint8_t *at)
{
    return ((uint32_t)hg_get16(at) << 16) | hg_get16(at + 2);
}

static inline void hg_put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value >> 8);
    at[1] = (uint8_t)(value & 0xFFu);
}

static inline void hg_put32(uint8_t *at, uint32_t value)
{
    hg_put16(at, (uint16_t)(value >> 16));
    hg_put16(at + 2, (uint16_t)(value & 0xFFFFu));
}

#endif
