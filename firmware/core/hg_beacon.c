#include "hg_beacon.h"

#include <string.h>

#include "hg_bytes.h"
#include "hg_check.h"
#include "hg_light.h"
#include "hg_requests.h"
#include "hg_store.h"

#define BOOT_AGAIN_MS 1000u

/* Frame what stands in body (header and payload) and put it on the line. */
static bool say(hg_beacon *beacon, uint8_t type, uint16_t seq, const uint8_t *payload, size_t n)
{
    beacon->body[0] = HG_VERSION;
    beacon->body[1] = type;
    hg_put16(beacon->body + 2, seq);
    hg_put16(beacon->body + 4, beacon->boot);
    if (n > 0u) {
        memcpy(beacon->body + HG_HEAD_BYTES, payload, n);
    }
    const size_t length = hg_line_frame(beacon->wire, beacon->body, HG_HEAD_BYTES + n);
    return beacon->port.write(beacon->port.context, beacon->wire, length);
}

static void answer(hg_beacon *beacon)
{
    const hg_answered *const answered = &beacon->answered;
    (void)say(beacon, (uint8_t)(answered->type | HG_REPLY_BIT), answered->seq, answered->payload, answered->n);
}

/* The verdict on a request's header: version and boot. HELLO is never refused. */
static enum hg_result envelope(const hg_beacon *beacon, const uint8_t *body)
{
    if (body[1] == HG_HELLO) {
        return HG_OK;
    }
    if (body[0] != HG_VERSION) {
        return HG_WRONG_VERSION;
    }
    return hg_get16(body + 4) == beacon->boot ? HG_OK : HG_WRONG_BOOT;
}

static void take_request(hg_beacon *beacon, const uint8_t *body, size_t n)
{
    hg_answered *const answered = &beacon->answered;
    const uint16_t seq = hg_get16(body + 2);
    const uint16_t crc = hg_get16(body + n); /* it stands behind the body that the line checked */
    if (body[1] == 0u || body[1] > HG_REQUEST_MOST) {
        beacon->line.bad++; /* no request at all: an echo of ours, or another talker */
        return;
    }
    beacon->greeted = true;
    if (answered->any && answered->seq == seq && answered->crc == crc && answered->length == n) {
        beacon->replays++;
        answer(beacon);
        return;
    }
    const hg_verdict verdict = {(uint8_t)envelope(beacon, body), 0};
    answered->any = true;
    answered->seq = seq;
    answered->crc = crc;
    answered->length = (uint8_t)n;
    answered->type = body[1];
    answered->n = verdict.result == HG_OK
                      ? hg_request_carry_out(beacon, body[1], body + HG_HEAD_BYTES, n - HG_HEAD_BYTES,
                                             answered->payload)
                      : hg_request_refuse(beacon, verdict, answered->payload);
    answer(beacon);
}

void hg_event_say(hg_beacon *beacon, enum hg_event_type type, const uint8_t *payload, uint8_t n)
{
    if ((uint8_t)(beacon->events_tail - beacon->events_head) == HG_EVENTS_MOST) {
        beacon->events_head++;
        beacon->events_seq++;
    }
    hg_event *const event = &beacon->events[beacon->events_tail & (HG_EVENTS_MOST - 1u)];
    event->type = (uint8_t)type;
    event->n = n;
    if (n > 0u) {
        memcpy(event->payload, payload, n);
    }
    beacon->events_tail++;
}

static void say_events(hg_beacon *beacon)
{
    while (beacon->events_head != beacon->events_tail) {
        const hg_event *const event = &beacon->events[beacon->events_head & (HG_EVENTS_MOST - 1u)];
        if (!say(beacon, event->type, beacon->events_seq, event->payload, event->n)) {
            return;
        }
        beacon->events_head++;
        beacon->events_seq++;
    }
}

void hg_beacon_init(hg_beacon *beacon, const hg_hardware *hardware, const hg_port *port, uint16_t boot,
                    enum hg_reset reason, uint32_t now_ms)
{
    memset(beacon, 0, sizeof *beacon);
    beacon->hardware = *hardware;
    beacon->port = *port;
    beacon->boot = boot;
    beacon->now_ms = now_ms;
    beacon->boot_ms = now_ms;
    hg_pump_init(&beacon->pump, hardware->ticks_per_s);
    hg_program program;
    if (hg_store_load(port, hardware, &program)) {
        hg_source_set(&beacon->source, &program, 0, hardware->ticks_per_s);
        beacon->saved = true;
    }
    beacon->boot_event.type = HG_EVENT_BOOT;
    beacon->boot_event.n = 9;
    beacon->boot_event.payload[0] = (uint8_t)reason;
    memcpy(beacon->boot_event.payload + 1, hardware->uid, sizeof hardware->uid);
    hg_event_say(beacon, HG_EVENT_BOOT, beacon->boot_event.payload, beacon->boot_event.n);
    beacon->boot_said_ms = now_ms;
}

void hg_beacon_receive(hg_beacon *beacon, const uint8_t *bytes, size_t n, uint32_t now_ms)
{
    beacon->now_ms = now_ms;
    for (size_t i = 0; i < n; i++) {
        const size_t length = hg_line_take(&beacon->line, bytes[i]);
        if (length > 0u) {
            take_request(beacon, beacon->line.body, length);
        }
    }
}

void hg_beacon_poll(hg_beacon *beacon, uint32_t now_ms)
{
    beacon->now_ms = now_ms;
    hg_light_poll(beacon);
    if (!beacon->greeted && now_ms - beacon->boot_said_ms >= BOOT_AGAIN_MS) {
        beacon->boot_said_ms = now_ms;
        hg_event_say(beacon, HG_EVENT_BOOT, beacon->boot_event.payload, beacon->boot_event.n);
    }
    say_events(beacon);
}

bool hg_beacon_is_armed(const hg_beacon *beacon)
{
    return beacon->armed;
}
