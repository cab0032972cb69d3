#include "hg_light.h"

#include "hg_bytes.h"

static uint32_t lease_left_ms(const hg_beacon *beacon)
{
    const uint32_t left = beacon->lease_end_ms - beacon->now_ms;
    return beacon->armed && left <= HG_LEASE_MOST_MS ? left : 0u;
}

static void end_message(hg_beacon *beacon, uint16_t id, enum hg_end why)
{
    uint8_t payload[3];
    hg_put16(payload, id);
    payload[2] = (uint8_t)why;
    beacon->message_ended = id;
    if (why == HG_END_SENT) {
        beacon->messages_sent++;
    } else {
        beacon->messages_dropped++;
    }
    hg_event_say(beacon, HG_EVENT_MESSAGE, payload, sizeof payload);
}

void hg_light_arm(hg_beacon *beacon, uint32_t lease_ms)
{
    beacon->lease_end_ms = beacon->now_ms + lease_ms;
    /* The pump may have ended the last lease a moment before us; then it has to be lit again. */
    beacon->to_light = beacon->to_light || !beacon->armed || hg_pump_is_idle(&beacon->pump);
    beacon->armed = true;
    beacon->renew = true;
    hg_light_poll(beacon);
}

void hg_light_disarm(hg_beacon *beacon)
{
    beacon->armed = false;
    beacon->to_light = false;
    beacon->renew = false;
    hg_pump_darken(&beacon->pump);
}

uint8_t hg_light_drop(hg_beacon *beacon, enum hg_end why)
{
    uint8_t n = 0;
    for (uint16_t id = hg_source_pop(&beacon->source); id != 0u; id = hg_source_pop(&beacon->source)) {
        end_message(beacon, id, why);
        n++;
    }
    hg_source_skip(&beacon->source);
    for (uint8_t i = 0; i < 2u; i++) {
        beacon->origins[i].ends = 0;
        beacon->origins[i].from = beacon->source.cursor;
    }
    return n;
}

void hg_light_set(hg_beacon *beacon, const hg_program *program, uint16_t program_id)
{
    if (program->protocol != beacon->source.program.protocol) {
        (void)hg_light_drop(beacon, HG_END_PROGRAM);
    }
    for (uint8_t i = 0; i < 2u; i++) {
        hg_source_turn(&beacon->source, &beacon->origins[i].from, program);
    }
    hg_source_set(&beacon->source, program, program_id, beacon->hardware.ticks_per_s);
    beacon->program_id = program_id;
}

static uint8_t index_of(const hg_beacon *beacon, const hg_frame *frame)
{
    return (uint8_t)(frame == &beacon->pump.frames[0] ? 0 : 1);
}

static void make(hg_beacon *beacon, hg_frame *frame)
{
    hg_source_next(&beacon->source, frame, &beacon->origins[index_of(beacon, frame)]);
}

static void say_on_air(hg_beacon *beacon)
{
    const uint16_t program = hg_pump_program(&beacon->pump);
    if (program != beacon->on_air_id) {
        uint8_t payload[2];
        beacon->on_air_id = program;
        hg_put16(payload, program);
        hg_event_say(beacon, HG_EVENT_ON_AIR, payload, sizeof payload);
    }
}

/* See whether the pump went over to the frame that waited; then the other has ended. Return the frame to be written. */
static hg_frame *follow(hg_beacon *beacon)
{
    hg_frame *const frame = hg_pump_free(&beacon->pump);
    if (frame != 0 && beacon->waiting) {
        hg_origin *const origin = &beacon->origins[index_of(beacon, frame)];
        beacon->waiting = false;
        if (origin->ends != 0u) {
            end_message(beacon, hg_source_pop(&beacon->source), HG_END_SENT);
            origin->ends = 0;
        }
        say_on_air(beacon);
    }
    return frame;
}

/* The pump is idle and its frames are ours: begin with the item that was cut. */
static void light_up(hg_beacon *beacon)
{
    (void)follow(beacon);
    hg_frame *const first = hg_pump_first(&beacon->pump);
    hg_origin *const origin = &beacon->origins[index_of(beacon, first)];
    hg_source_back(&beacon->source, origin);
    if (beacon->source.program.protocol == HG_UART) {
        hg_source_lead(&beacon->source, first);
        origin->ends = 0;
    } else {
        make(beacon, first);
    }
    beacon->waiting = false;
    beacon->to_light = false;
    say_on_air(beacon);
}

/* Keep the frame that follows ready; a word needs none until the program changes. */
static void feed(hg_beacon *beacon)
{
    hg_frame *const frame = follow(beacon);
    if (frame == 0) {
        return;
    }
    if (hg_program_carries(&beacon->source.program) || hg_pump_program(&beacon->pump) != beacon->program_id) {
        make(beacon, frame);
        hg_pump_ready(&beacon->pump);
        beacon->waiting = true;
    }
}

void hg_light_poll(hg_beacon *beacon)
{
    const uint8_t late = atomic_load_explicit(&beacon->pump.late, memory_order_relaxed);
    beacon->late += (uint8_t)(late - beacon->late_seen);
    beacon->late_seen = late;
    if (!beacon->armed) {
        return;
    }
    const uint32_t left_ms = lease_left_ms(beacon);
    if (left_ms == 0u) {
        hg_light_disarm(beacon);
        hg_event_say(beacon, HG_EVENT_DARK, 0, 0);
        return;
    }
    if (beacon->to_light && hg_pump_is_idle(&beacon->pump)) {
        light_up(beacon);
    }
    if (beacon->to_light) {
        return; /* the pump has not seen yet that it was to be dark */
    }
    if (beacon->renew && hg_pump_lease(&beacon->pump, (uint64_t)left_ms * (beacon->hardware.ticks_per_s / 1000u))) {
        beacon->renew = false;
    }
    feed(beacon);
}
