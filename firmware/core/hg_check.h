/* The two checks that the beacon computes, bit by bit (no tables: 128 bytes of code instead of 1.5 KB).
 *
 *   hg_crc16  CRC-16/GENIBUS: x^16 + x^12 + x^5 + 1, begun with FFFF, complemented; "123456789" gives D64E
 *             (serial line, store)
 *   hg_crc32  CRC-32/ISO-HDLC (IEEE 802.3); "123456789" gives CBF43926                          (packets of light)
 */
#ifndef HG_CHECK_H
#define HG_CHECK_H

#include <stddef.h>
#include <stdint.h>

uint16_t hg_crc16(const uint8_t *bytes, size_t n);
uint32_t hg_crc32(const uint8_t *bytes, size_t n);

#endif
