/* What comes next on the air: the program's word or text, and between texts the messages of the queue.
 *
 * A source makes frames one after another. An *item* is what is sent as a whole: the word, TEXT, one sending of
 * a message, a gap. A message ends when the last frame of its last sending has left the pump.
 */
#ifndef HG_SOURCE_H
#define HG_SOURCE_H

#include <stdbool.h>
#include <stdint.h>

#include "hg_program.h"
#include "hg_pump.h"

typedef struct {
    uint16_t id;
    bool text;
    uint8_t times;
    uint8_t n;
    uint8_t bytes[HG_MESSAGE_MOST];
} hg_message;

enum hg_item { HG_ITEM_NONE = 0, HG_ITEM_TEXT = 1, HG_ITEM_MESSAGE = 2 };

/* Where the source is; small, so that it can be taken back to an item's beginning. */
typedef struct {
    uint8_t item;    /* enum hg_item; none: the next is still to be chosen */
    uint8_t last;    /* the item before; none: nothing was sent yet */
    uint8_t message; /* running count of the message that is under way, or next */
    uint8_t sent;    /* times that it was sent to its end */
    uint8_t number;  /* of the packets of this item */
    uint8_t at;      /* characters or fragments that were made of it */
    bool gap;        /* a gap comes first */
} hg_cursor;

typedef struct {
    hg_program program;
    hg_clock clock;
    uint16_t program_id;
    hg_cursor cursor;
    hg_message queue[HG_QUEUE_PLACES];
    uint8_t head, tail; /* running counts: oldest message, place after the newest */
    uint16_t last_id;
} hg_source;

/* What a frame was, for whoever sends it. */
typedef struct {
    hg_cursor from;  /* the beginning of its item */
    uint16_t ends;   /* the message that ends with it, 0 none */
} hg_origin;

/* Turn a cursor, one of the source or one of an origin, to a program that is about to be set. */
void hg_source_turn(const hg_source *source, hg_cursor *cursor, const hg_program *program);

/* Take another program; where it is not alike, what is under way begins anew. */
void hg_source_set(hg_source *source, const hg_program *program, uint16_t program_id, uint32_t ticks_per_s);

/* Make the next frame. There must be a program. */
void hg_source_next(hg_source *source, hg_frame *frame, hg_origin *origin);

/* Make idle light of at least a character's length, which text needs before its first character. */
void hg_source_lead(const hg_source *source, hg_frame *frame);

/* Begin the origin's item again. */
void hg_source_back(hg_source *source, const hg_origin *origin);

/* Put a message in the queue; return its number, or 0 where the queue is full. */
uint16_t hg_source_queue(hg_source *source, const uint8_t *bytes, uint8_t n, bool text, uint8_t times);

/* Free places. */
uint8_t hg_source_free(const hg_source *source);

/* Take the oldest message out: it has ended. Return its number, 0 where there is none. */
uint16_t hg_source_pop(hg_source *source);

/* Go on with what comes after the messages: all were taken out. */
void hg_source_skip(hg_source *source);

#endif
