/* Sizes and limits of the beacon, all of them in one place: there is no heap, so they are its memory. */
#ifndef HG_LIMITS_H
#define HG_LIMITS_H

/* Of the protocol (PROTOCOL.md). COBS costs one byte up to a body of 254. */
#define HG_VERSION 1u
#define HG_BODY_MOST 254u
#define HG_HEAD_BYTES 6u
#define HG_CRC_BYTES 2u
#define HG_PAYLOAD_MOST (HG_BODY_MOST - HG_HEAD_BYTES - HG_CRC_BYTES)
/* 00, the code byte of COBS, the body, 00. */
#define HG_WIRE_MOST (HG_BODY_MOST + 3u)
/* Longest reply: STATUS has 42 bytes of payload, GET 3 + 15 + HG_TEXT_MOST = 82. */
#define HG_REPLY_MOST 96u

#define HG_TEXT_MOST 64u
#define HG_RECORD_HEAD 15u
#define HG_RECORD_MOST (HG_RECORD_HEAD + HG_TEXT_MOST)
#define HG_MESSAGE_MOST 240u
/* A power of two: running counts of a byte index the ring. */
#define HG_QUEUE_PLACES 4u
#define HG_TIMES_MOST 8u
#define HG_LEASE_MOST_MS 3600000uL
/* Events that wait for the line; one frame of light can end two messages, lease and program at once. */
#define HG_EVENTS_MOST 8u

/* A packet of 30 bytes at rate 1/2 has 24 + 2 * 302 = 628 bits. */
#define HG_FRAME_BITS_MOST 628u
#define HG_FRAME_BYTES ((HG_FRAME_BITS_MOST + 7u) / 8u)

/* What a store holds: "HB", a version, a length, the record, a CRC. */
#define HG_STORE_MOST (4u + HG_RECORD_MOST + 2u)

#endif
