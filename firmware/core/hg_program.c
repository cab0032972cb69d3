#include "hg_program.h"

#include <string.h>

#include "hg_bytes.h"
#include "hg_codebooks.h"
#include "hg_packet.h"

#define WORD_LEAST 4u
#define WORD_MOST 32u
#define POWER_FULL 1000u
#define ADDRESS_MOST 255u

static const hg_verdict FINE = {HG_OK, 0};

static hg_verdict wrong(enum hg_field field)
{
    const hg_verdict verdict = {HG_RANGE, (uint8_t)field};
    return verdict;
}

static hg_verdict refused(enum hg_result result)
{
    const hg_verdict verdict = {(uint8_t)result, 0};
    return verdict;
}

bool hg_is_ascii(const uint8_t *bytes, size_t n, size_t *at)
{
    for (*at = 0; *at < n; (*at)++) {
        if (bytes[*at] >= HG_UART_CODES) {
            return false;
        }
    }
    return true;
}

/* What has to be nothing where the protocol has no use for it. */
static hg_verdict plain(const hg_program *program, bool option, bool size, bool gap, bool kind)
{
    if (option && program->option != 0u) {
        return wrong(HG_AT_OPTION);
    }
    if (size && program->size != 0u) {
        return wrong(HG_AT_SIZE);
    }
    if (gap && program->gap_bits != 0u) {
        return wrong(HG_AT_GAP);
    }
    return kind && program->kind_text ? wrong(HG_AT_KIND) : FINE;
}

static hg_verdict check_seed11(const hg_program *program)
{
    if (program->option > 1u) {
        return wrong(HG_AT_OPTION);
    }
    const hg_verdict verdict = plain(program, false, true, true, true);
    if (verdict.result != HG_OK) {
        return verdict;
    }
    if (program->payload >= HG_SEED11_PAYLOADS) {
        return wrong(HG_AT_PAYLOAD);
    }
    return hg_seed11_ambiguous((uint8_t)program->payload, program->option == 1u) ? refused(HG_AMBIGUOUS) : FINE;
}

static hg_verdict check_code(const hg_program *program)
{
    if (program->option > HG_BOOKS) {
        return wrong(HG_AT_OPTION);
    }
    const hg_verdict verdict = plain(program, false, program->option != 0u, true, true);
    if (verdict.result != HG_OK) {
        return verdict;
    }
    if (program->option != 0u) {
        return program->payload >= hg_book_words(program->option) ? wrong(HG_AT_PAYLOAD) : FINE;
    }
    if (program->size < WORD_LEAST || program->size > WORD_MOST) {
        return wrong(HG_AT_SIZE);
    }
    return program->size < WORD_MOST && (program->payload >> program->size) != 0u ? wrong(HG_AT_PAYLOAD) : FINE;
}

static hg_verdict check_uart(const hg_program *program)
{
    const hg_verdict verdict = plain(program, true, true, false, true);
    if (verdict.result != HG_OK) {
        return verdict;
    }
    size_t at;
    if (program->payload != 0u) {
        return wrong(HG_AT_PAYLOAD);
    }
    return hg_is_ascii(program->text, program->text_n, &at) ? FINE : wrong(HG_AT_TEXT);
}

static hg_verdict check_packet(const hg_program *program)
{
    if (program->option >= HG_PACKET_RATES) {
        return wrong(HG_AT_OPTION);
    }
    if (program->size < HG_BLOCK_LEAST || program->size > HG_BLOCK_MOST) {
        return wrong(HG_AT_SIZE);
    }
    return program->payload > ADDRESS_MOST ? wrong(HG_AT_PAYLOAD) : FINE;
}

static hg_verdict check(const hg_program *program, const hg_hardware *hardware)
{
    if (program->protocol < HG_SEED11 || program->protocol > HG_PACKET) {
        return wrong(HG_AT_PROTOCOL);
    }
    if (((hardware->capabilities >> (program->protocol - 1u)) & 1u) == 0u) {
        return refused(HG_UNSUPPORTED);
    }
    if (program->rate < hardware->rate_least || program->rate > hardware->rate_most) {
        return wrong(HG_AT_RATE);
    }
    if (program->power == 0u || program->power > POWER_FULL) {
        return wrong(HG_AT_POWER);
    }
    if (program->power != POWER_FULL && (hardware->capabilities & HG_CAN_POWER) == 0u) {
        return refused(HG_UNSUPPORTED);
    }
    switch (program->protocol) {
    case HG_SEED11:
        return check_seed11(program);
    case HG_CODE:
        return check_code(program);
    case HG_UART:
        return check_uart(program);
    default:
        return check_packet(program);
    }
}

hg_verdict hg_program_read(hg_program *program, const hg_hardware *hardware, const uint8_t *record, size_t n)
{
    if (n < HG_RECORD_HEAD || n > HG_RECORD_MOST) {
        return refused(HG_LENGTH);
    }
    if (record[HG_AT_KIND] > 1u) {
        return wrong(HG_AT_KIND);
    }
    hg_program read;
    memset(&read, 0, sizeof read);
    read.protocol = record[HG_AT_PROTOCOL];
    read.option = record[HG_AT_OPTION];
    read.size = record[HG_AT_SIZE];
    read.gap_bits = record[HG_AT_GAP];
    read.rate = hg_get32(record + HG_AT_RATE);
    read.power = hg_get16(record + HG_AT_POWER);
    read.payload = hg_get32(record + HG_AT_PAYLOAD);
    read.kind_text = record[HG_AT_KIND] == 1u;
    read.text_n = (uint8_t)(n - HG_RECORD_HEAD);
    memcpy(read.text, record + HG_AT_TEXT, read.text_n);
    const hg_verdict verdict = check(&read, hardware);
    if (verdict.result != HG_OK) {
        return verdict;
    }
    if (read.text_n > 0u && !hg_program_carries(&read)) {
        return refused(HG_LENGTH);
    }
    *program = read;
    return verdict;
}

size_t hg_program_write(uint8_t *record, const hg_program *program)
{
    record[HG_AT_PROTOCOL] = program->protocol;
    record[HG_AT_OPTION] = program->option;
    record[HG_AT_SIZE] = program->size;
    record[HG_AT_GAP] = program->gap_bits;
    hg_put32(record + HG_AT_RATE, program->rate);
    hg_put16(record + HG_AT_POWER, program->power);
    hg_put32(record + HG_AT_PAYLOAD, program->payload);
    record[HG_AT_KIND] = program->kind_text ? 1u : 0u;
    memcpy(record + HG_AT_TEXT, program->text, program->text_n);
    return (size_t)HG_RECORD_HEAD + program->text_n;
}

bool hg_program_carries(const hg_program *program)
{
    return program->protocol == HG_UART || program->protocol == HG_PACKET;
}

bool hg_program_alike(const hg_program *a, const hg_program *b)
{
    return a->protocol == b->protocol && a->option == b->option && a->size == b->size && a->payload == b->payload;
}

uint32_t hg_program_word(const hg_program *program, uint8_t *bits)
{
    if (program->protocol == HG_SEED11) {
        *bits = HG_SEED11_BITS;
        return hg_seed11_word((uint8_t)program->payload, program->option == 1u);
    }
    if (program->option == 0u) {
        *bits = program->size;
        return program->payload;
    }
    *bits = hg_book_bits(program->option);
    return hg_book_word(program->option, (uint16_t)program->payload);
}
