/* A program: what the beacon is to send, as SET says it (PROTOCOL.md has the record, byte by byte). */
#ifndef HG_PROGRAM_H
#define HG_PROGRAM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hg_frames.h"

enum hg_protocol { HG_NONE = 0, HG_SEED11 = 1, HG_CODE = 2, HG_UART = 3, HG_PACKET = 4 };

/* Capabilities, as HELLO tells them. */
#define HG_CAN_SEED11 0x001uL
#define HG_CAN_CODE 0x002uL
#define HG_CAN_UART 0x004uL
#define HG_CAN_PACKET 0x008uL
#define HG_CAN_POWER 0x100uL
#define HG_CAN_SAVE 0x200uL

/* Results, as replies tell them. */
enum hg_result {
    HG_OK = 0,
    HG_UNKNOWN = 1,
    HG_LENGTH = 2,
    HG_RANGE = 3,
    HG_AMBIGUOUS = 4,
    HG_UNSUPPORTED = 5,
    HG_FULL = 6,
    HG_NOT_NOW = 7,
    HG_STORAGE = 8,
    HG_WRONG_BOOT = 9,
    HG_WRONG_VERSION = 10,
    HG_NO_PROGRAM = 11
};

/* What a request came to; field is the offset of the wrong byte, for HG_RANGE. */
typedef struct {
    uint8_t result;
    uint8_t field;
} hg_verdict;

/* Offsets in the record. */
enum hg_field {
    HG_AT_PROTOCOL = 0,
    HG_AT_OPTION = 1,
    HG_AT_SIZE = 2,
    HG_AT_GAP = 3,
    HG_AT_RATE = 4,
    HG_AT_POWER = 8,
    HG_AT_PAYLOAD = 10,
    HG_AT_KIND = 14,
    HG_AT_TEXT = 15
};

typedef struct {
    uint8_t protocol; /* enum hg_protocol; HG_NONE: there is none */
    uint8_t option;
    uint8_t size;
    uint8_t gap_bits;
    uint32_t rate; /* thousandths of a bit/s */
    uint16_t power; /* thousandths */
    uint32_t payload;
    bool kind_text;
    uint8_t text_n;
    uint8_t text[HG_TEXT_MOST];
} hg_program;

/* What the hardware can do; the port fills it in. */
typedef struct {
    uint8_t uid[8];
    uint32_t capabilities;
    uint32_t rate_least; /* thousandths of a bit/s */
    uint32_t rate_most;
    uint32_t ticks_per_s; /* a multiple of 1000 */
    const char *port;     /* 1 to 12 characters */
} hg_hardware;

/* Read a record of n bytes; where the result is not HG_OK, the program is not touched. */
hg_verdict hg_program_read(hg_program *program, const hg_hardware *hardware, const uint8_t *record, size_t n);

/* Write a program's record (HG_RECORD_MOST bytes); return how many bytes. */
size_t hg_program_write(uint8_t *record, const hg_program *program);

/* Whether it carries messages. */
bool hg_program_carries(const hg_program *program);

/* Whether a message under way may go on where it is: the light that carries it is the same but for rate and power. */
bool hg_program_alike(const hg_program *a, const hg_program *b);

/* Bits and word of `seed11` and `code`. */
uint32_t hg_program_word(const hg_program *program, uint8_t *bits);

/* Whether n bytes can be sent as text of `uart`: 7-bit ASCII without DEL. Otherwise *at is the first that cannot. */
bool hg_is_ascii(const uint8_t *bytes, size_t n, size_t *at);

#endif
