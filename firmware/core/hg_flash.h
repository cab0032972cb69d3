/* Tables that stay in program memory where data and programs have memories of their own (AVR). */
#ifndef HG_FLASH_H
#define HG_FLASH_H

#include <stdint.h>

#ifdef __AVR__
#include <avr/pgmspace.h>
#define HG_FLASH PROGMEM
static inline uint8_t hg_flash(const uint8_t *at)
{
    return pgm_read_byte(at);
}
#else
#define HG_FLASH
static inline uint8_t hg_flash(const uint8_t *at)
{
    return *at;
}
#endif

#endif
