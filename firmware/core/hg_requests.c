#include "hg_requests.h"

#include <string.h>

#include "hg_bytes.h"
#include "hg_check.h"
#include "hg_light.h"
#include "hg_store.h"

#define FIRMWARE_MAJOR 1u
#define FIRMWARE_MINOR 0u
#define FIRMWARE_PATCH 0u
#define NONCE_BYTES 4u
#define QUEUE_HEAD 2u
#define PORT_NAME_MOST 12u

static hg_verdict verdict_of(enum hg_result result)
{
    const hg_verdict verdict = {(uint8_t)result, 0};
    return verdict;
}

static hg_verdict wrong(uint8_t field)
{
    const hg_verdict verdict = {HG_RANGE, field};
    return verdict;
}

uint8_t hg_request_refuse(hg_beacon *beacon, hg_verdict verdict, uint8_t *reply)
{
    beacon->refused++;
    reply[0] = verdict.result;
    reply[1] = verdict.field;
    if (verdict.result == HG_WRONG_BOOT) {
        memcpy(reply + 1, beacon->hardware.uid, sizeof beacon->hardware.uid);
        return 1u + sizeof beacon->hardware.uid;
    }
    return verdict.result == HG_RANGE ? 2u : 1u;
}

static uint8_t hello(const hg_beacon *beacon, const uint8_t *nonce, uint8_t *reply)
{
    const hg_hardware *const hardware = &beacon->hardware;
    uint8_t *at = reply;
    *at++ = HG_OK;
    memcpy(at, nonce, NONCE_BYTES);
    at += NONCE_BYTES;
    *at++ = HG_VERSION;
    *at++ = FIRMWARE_MAJOR;
    *at++ = FIRMWARE_MINOR;
    *at++ = FIRMWARE_PATCH;
    memcpy(at, hardware->uid, sizeof hardware->uid);
    at += sizeof hardware->uid;
    hg_put32(at, hardware->capabilities);
    hg_put32(at + 4, hardware->rate_least);
    hg_put32(at + 8, hardware->rate_most);
    hg_put32(at + 12, hardware->ticks_per_s);
    hg_put16(at + 16, HG_MESSAGE_MOST);
    at[18] = HG_TEXT_MOST;
    at[19] = HG_QUEUE_PLACES;
    at += 20;
    for (uint8_t i = 0; i < PORT_NAME_MOST && hardware->port[i] != '\0'; i++) {
        *at++ = (uint8_t)hardware->port[i];
    }
    return (uint8_t)(at - reply);
}

static uint8_t get(const hg_beacon *beacon, uint8_t *reply)
{
    reply[0] = HG_OK;
    hg_put16(reply + 1, beacon->program_id);
    return (uint8_t)(3u + hg_program_write(reply + 3, &beacon->source.program));
}

static hg_verdict set(hg_beacon *beacon, const uint8_t *record, size_t n, uint8_t *reply)
{
    hg_program program;
    const hg_verdict verdict = hg_program_read(&program, &beacon->hardware, record, n);
    if (verdict.result == HG_OK) {
        const uint16_t id = beacon->program_id == UINT16_MAX ? 1u : (uint16_t)(beacon->program_id + 1u);
        hg_light_set(beacon, &program, id);
        beacon->saved = false;
        hg_put16(reply + 1, id);
    }
    return verdict;
}

static hg_verdict arm(hg_beacon *beacon, const uint8_t *payload)
{
    const uint32_t lease_ms = hg_get32(payload);
    if (beacon->source.program.protocol == HG_NONE) {
        return verdict_of(HG_NO_PROGRAM);
    }
    if (lease_ms == 0u || lease_ms > HG_LEASE_MOST_MS) {
        return wrong(0);
    }
    hg_light_arm(beacon, lease_ms);
    return verdict_of(HG_OK);
}

static hg_verdict queue(hg_beacon *beacon, const uint8_t *payload, size_t n, uint8_t *reply)
{
    if (n <= QUEUE_HEAD || n > QUEUE_HEAD + HG_MESSAGE_MOST) {
        return verdict_of(HG_LENGTH);
    }
    const hg_program *const program = &beacon->source.program;
    if (!hg_program_carries(program)) {
        return verdict_of(HG_NOT_NOW);
    }
    const bool uart = program->protocol == HG_UART;
    const uint8_t bytes = (uint8_t)(n - QUEUE_HEAD);
    size_t at = 0;
    if (payload[0] > 1u || (uart && payload[0] != 1u)) {
        return wrong(0);
    }
    if (payload[1] == 0u || payload[1] > HG_TIMES_MOST) {
        return wrong(1);
    }
    if (uart && !hg_is_ascii(payload + QUEUE_HEAD, bytes, &at)) {
        return wrong((uint8_t)(QUEUE_HEAD + at));
    }
    const uint16_t id = hg_source_queue(&beacon->source, payload + QUEUE_HEAD, bytes, payload[0] == 1u, payload[1]);
    if (id == 0u) {
        return verdict_of(HG_FULL);
    }
    hg_put16(reply + 1, id);
    reply[3] = hg_source_free(&beacon->source);
    return verdict_of(HG_OK);
}

static uint8_t status(const hg_beacon *beacon, uint8_t *reply)
{
    const uint32_t left_ms = beacon->armed ? beacon->lease_end_ms - beacon->now_ms : 0u;
    const uint32_t counts[6] = {beacon->messages_sent, beacon->messages_dropped, beacon->line.bad,
                                beacon->refused,       beacon->replays,          beacon->late};
    reply[0] = HG_OK;
    reply[1] = (uint8_t)((beacon->armed ? 1u : 0u) | (beacon->saved ? 2u : 0u)
                         | (beacon->on_air_id == beacon->program_id ? 4u : 0u));
    hg_put32(reply + 2, left_ms);
    hg_put32(reply + 6, beacon->now_ms - beacon->boot_ms);
    hg_put16(reply + 10, beacon->program_id);
    hg_put16(reply + 12, beacon->on_air_id);
    reply[14] = hg_source_free(&beacon->source);
    hg_put16(reply + 15, beacon->source.last_id);
    hg_put16(reply + 17, beacon->message_ended);
    for (uint8_t i = 0; i < 6u; i++) {
        hg_put32(reply + 19u + 4u * i, counts[i]);
    }
    return 43;
}

static hg_verdict save(hg_beacon *beacon)
{
    if ((beacon->hardware.capabilities & HG_CAN_SAVE) == 0u) {
        return verdict_of(HG_UNSUPPORTED);
    }
    if (beacon->source.program.protocol == HG_NONE) {
        return verdict_of(HG_NO_PROGRAM);
    }
    if (!beacon->saved && !hg_store_save(&beacon->port, &beacon->source.program)) {
        return verdict_of(HG_STORAGE);
    }
    beacon->saved = true;
    return verdict_of(HG_OK);
}

/* Bytes of payload that a request has, where it always has as many; SET and QUEUE see to their own. */
static bool length_fits(uint8_t type, size_t n)
{
    switch (type) {
    case HG_HELLO:
    case HG_ARM:
        return n == 4u;
    case HG_SET:
    case HG_QUEUE:
        return true;
    default:
        return n == 0u;
    }
}

uint8_t hg_request_carry_out(hg_beacon *beacon, uint8_t type, const uint8_t *payload, size_t n, uint8_t *reply)
{
    hg_verdict verdict = {HG_OK, 0};
    uint8_t length = 1;
    reply[0] = HG_OK;
    if (type == 0u || type > HG_SAVE) {
        return hg_request_refuse(beacon, verdict_of(HG_UNKNOWN), reply);
    }
    if (!length_fits(type, n)) {
        return hg_request_refuse(beacon, verdict_of(HG_LENGTH), reply);
    }
    switch (type) {
    case HG_HELLO:
        return hello(beacon, payload, reply);
    case HG_GET:
        if (beacon->source.program.protocol != HG_NONE) {
            return get(beacon, reply);
        }
        verdict = verdict_of(HG_NO_PROGRAM);
        break;
    case HG_SET:
        verdict = set(beacon, payload, n, reply);
        length = 3;
        break;
    case HG_ARM:
        verdict = arm(beacon, payload);
        break;
    case HG_DISARM:
        hg_light_disarm(beacon);
        break;
    case HG_QUEUE:
        verdict = queue(beacon, payload, n, reply);
        length = 4;
        break;
    case HG_CLEAR:
        reply[1] = hg_light_drop(beacon, HG_END_CLEARED);
        return 2;
    case HG_STATUS:
        return status(beacon, reply);
    default:
        verdict = save(beacon);
        break;
    }
    return verdict.result == HG_OK ? length : hg_request_refuse(beacon, verdict, reply);
}
