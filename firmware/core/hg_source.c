#include "hg_source.h"

#include <string.h>

#include "hg_packet.h"

#define IDLE_BITS HG_UART_BITS
#define NUMBERS_MASK 15u

static hg_message *message_of(hg_source *source, uint8_t count)
{
    return &source->queue[count & (HG_QUEUE_PLACES - 1u)];
}

/* Choose the next item: a message if one waits, or TEXT. Only TEXT after TEXT keeps its number: it is a repeat. */
static void choose(hg_source *source)
{
    hg_cursor *const cursor = &source->cursor;
    cursor->item = cursor->message != source->tail ? HG_ITEM_MESSAGE : HG_ITEM_TEXT;
    if (cursor->last != HG_ITEM_NONE && (cursor->last == HG_ITEM_MESSAGE || cursor->item == HG_ITEM_MESSAGE)) {
        cursor->number = (cursor->number + 1u) & NUMBERS_MASK;
    }
    cursor->last = cursor->item;
    cursor->at = 0;
}

void hg_source_turn(const hg_source *source, hg_cursor *cursor, const hg_program *program)
{
    const hg_program *const old = &source->program;
    const bool same_text = old->text_n == program->text_n && memcmp(old->text, program->text, old->text_n) == 0
                           && old->kind_text == program->kind_text;
    if (!hg_program_alike(old, program)) {
        cursor->at = 0;
        cursor->gap = false;
    }
    if (!same_text && cursor->last == HG_ITEM_TEXT) {
        cursor->item = HG_ITEM_NONE;
        cursor->last = HG_ITEM_MESSAGE; /* other words, another number */
        cursor->gap = false;
    }
}

void hg_source_set(hg_source *source, const hg_program *program, uint16_t program_id, uint32_t ticks_per_s)
{
    hg_source_turn(source, &source->cursor, program);
    source->program = *program;
    source->program_id = program_id;
    source->clock = hg_clock_of(ticks_per_s, program->rate);
}

static void level_frame(const hg_source *source, hg_bits *bits, uint16_t n)
{
    const bool lit = source->program.protocol == HG_UART;
    memset(bits->bytes, lit ? 0xFF : 0, sizeof bits->bytes);
    bits->n = n;
}

static void stamp(const hg_source *source, hg_frame *frame)
{
    frame->clock = source->clock;
    frame->power = source->program.power;
    frame->program = source->program_id;
    frame->repeat = !hg_program_carries(&source->program);
    frame->idle_lit = source->program.protocol == HG_UART;
    frame->bits.n = 0;
}

/* The next packet of data; return whether it is the last. */
static bool packet(const hg_source *source, hg_bits *bits, const uint8_t *data, uint8_t n, bool text)
{
    const hg_program *const program = &source->program;
    const uint16_t from = (uint16_t)((uint16_t)source->cursor.at * program->size);
    const uint16_t left = (uint16_t)(n - from);
    const bool more = left > program->size;
    const hg_packet packet = {
        .address = (uint8_t)program->payload,
        .text = text,
        .number = source->cursor.number,
        .fragment = source->cursor.at,
        .more = more,
        .data = data + from,
        .n = (uint8_t)(more ? program->size : left),
    };
    hg_packet_frame(bits, &packet, program->size, program->option);
    return !more;
}

/* The next frame of an item's bytes; return whether it is the last. */
static bool piece(const hg_source *source, hg_bits *bits, const uint8_t *data, uint8_t n, bool text)
{
    if (source->program.protocol == HG_PACKET) {
        return packet(source, bits, data, n, text);
    }
    if (n == 0u) {
        level_frame(source, bits, IDLE_BITS);
        return true;
    }
    hg_bits_put(bits, hg_uart_word(data[source->cursor.at]), HG_UART_BITS);
    return source->cursor.at + 1u >= n;
}

/* The next frame of the item under way; return whether it is its last. */
static bool item_piece(hg_source *source, hg_bits *bits)
{
    const hg_message *const message = message_of(source, source->cursor.message);
    const hg_program *const program = &source->program;
    const bool last = source->cursor.item == HG_ITEM_MESSAGE
                          ? piece(source, bits, message->bytes, message->n, message->text)
                          : piece(source, bits, program->text, program->text_n, program->kind_text);
    source->cursor.at++;
    return last;
}

/* The item under way is over; return the message that ends with it, or 0. */
static uint16_t item_end(hg_source *source)
{
    hg_cursor *const cursor = &source->cursor;
    const hg_message *const message = message_of(source, cursor->message);
    const bool sending = cursor->item == HG_ITEM_MESSAGE;
    cursor->at = 0;
    cursor->gap = source->program.gap_bits > 0u;
    if (sending && ++cursor->sent < message->times) {
        return 0; /* the same again, under the same number */
    }
    cursor->item = HG_ITEM_NONE;
    if (!sending) {
        return 0;
    }
    cursor->sent = 0;
    cursor->message++;
    return message->id;
}

void hg_source_next(hg_source *source, hg_frame *frame, hg_origin *origin)
{
    hg_cursor *const cursor = &source->cursor;
    stamp(source, frame);
    origin->ends = 0;
    if (!hg_program_carries(&source->program)) {
        uint8_t n;
        const uint32_t word = hg_program_word(&source->program, &n);
        hg_bits_put(&frame->bits, word, n);
        origin->from = *cursor;
        return;
    }
    if (cursor->gap) {
        cursor->gap = false;
        origin->from = *cursor;
        level_frame(source, &frame->bits, source->program.gap_bits);
        return;
    }
    if (cursor->item == HG_ITEM_NONE) {
        choose(source);
    }
    origin->from = *cursor;
    origin->from.at = 0;
    if (item_piece(source, &frame->bits)) {
        origin->ends = item_end(source);
    }
}

void hg_source_lead(const hg_source *source, hg_frame *frame)
{
    stamp(source, frame);
    level_frame(source, &frame->bits, IDLE_BITS);
}

void hg_source_back(hg_source *source, const hg_origin *origin)
{
    source->cursor = origin->from;
}

uint16_t hg_source_queue(hg_source *source, const uint8_t *bytes, uint8_t n, bool text, uint8_t times)
{
    if (hg_source_free(source) == 0u) {
        return 0;
    }
    hg_message *const message = message_of(source, source->tail);
    source->last_id = source->last_id == UINT16_MAX ? 1u : (uint16_t)(source->last_id + 1u);
    message->id = source->last_id;
    message->text = text;
    message->times = times;
    message->n = n;
    memcpy(message->bytes, bytes, n);
    source->tail++;
    return message->id;
}

uint8_t hg_source_free(const hg_source *source)
{
    return (uint8_t)(HG_QUEUE_PLACES - (uint8_t)(source->tail - source->head));
}

uint16_t hg_source_pop(hg_source *source)
{
    if (source->head == source->tail) {
        return 0;
    }
    const uint16_t id = message_of(source, source->head)->id;
    source->head++;
    return id;
}

void hg_source_skip(hg_source *source)
{
    hg_cursor *const cursor = &source->cursor;
    cursor->message = source->tail;
    if (cursor->item == HG_ITEM_MESSAGE) {
        cursor->item = HG_ITEM_NONE;
        cursor->sent = 0;
        cursor->at = 0;
    }
}
