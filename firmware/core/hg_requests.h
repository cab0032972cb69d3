/* The requests of PROTOCOL.md: what each does, and its reply. Only hg_beacon.c calls this. */
#ifndef HG_REQUESTS_H
#define HG_REQUESTS_H

#include "hg_beacon.h"

enum hg_request {
    HG_HELLO = 0x01,
    HG_GET = 0x02,
    HG_SET = 0x03,
    HG_ARM = 0x04,
    HG_DISARM = 0x05,
    HG_QUEUE = 0x06,
    HG_CLEAR = 0x07,
    HG_STATUS = 0x08,
    HG_SAVE = 0x09
};
#define HG_REQUEST_MOST 0x3Fu
#define HG_REPLY_BIT 0x80u

/* Carry out a request; write the reply's payload (HG_REPLY_MOST bytes); return how many bytes. */
uint8_t hg_request_carry_out(hg_beacon *beacon, uint8_t type, const uint8_t *payload, size_t n, uint8_t *reply);

/* Write and count a refusal: a result, and what RANGE (the byte) and WRONG_BOOT (the UID) add; return how many bytes. */
uint8_t hg_request_refuse(hg_beacon *beacon, hg_verdict verdict, uint8_t *reply);

#endif
