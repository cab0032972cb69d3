#include "hg_pump.h"

#include <string.h>

/* While it is dark, the pump looks for a lease a thousand times a second. */
#define DARK_BITS_PER_S 1000u

hg_clock hg_clock_of(uint32_t ticks_per_s, uint32_t rate)
{
    const uint64_t thousandths = (uint64_t)ticks_per_s * 1000u;
    const hg_clock clock = {(uint32_t)(thousandths / rate), (uint32_t)(thousandths % rate), rate};
    return clock;
}

void hg_pump_init(hg_pump *pump, uint32_t ticks_per_s)
{
    memset(pump, 0, sizeof *pump);
    pump->dark_ticks = ticks_per_s / DARK_BITS_PER_S;
    atomic_store(&pump->dark, 1);
    atomic_store(&pump->idle, 1);
}

/* Take the lease that waits, or none; return whether there is light. */
static bool leased(hg_pump *pump)
{
    if (atomic_load_explicit(&pump->dark, memory_order_acquire) != 0u) {
        pump->lease_ticks = 0;
        atomic_store_explicit(&pump->leased, 0, memory_order_release);
    } else if (atomic_load_explicit(&pump->leased, memory_order_acquire) != 0u) {
        pump->lease_ticks = pump->lease_new;
        atomic_store_explicit(&pump->idle, 0, memory_order_relaxed);
        atomic_store_explicit(&pump->leased, 0, memory_order_release);
    }
    return pump->lease_ticks != 0u;
}

/* Go on to the frame that is to be sent now; return whether there is one. */
static bool turned(hg_pump *pump, uint8_t *front)
{
    const hg_frame *const frame = &pump->frames[*front];
    if (pump->at < frame->bits.n) {
        return true;
    }
    if (atomic_load_explicit(&pump->ready, memory_order_acquire) != 0u) {
        *front = (uint8_t)(*front ^ 1u);
        pump->at = 0;
        pump->waiting = false;
        atomic_store_explicit(&pump->front, *front, memory_order_relaxed);
        atomic_store_explicit(&pump->ready, 0, memory_order_release);
        return true;
    }
    if (frame->repeat) {
        pump->at = 0;
        return true;
    }
    if (!pump->waiting) {
        pump->waiting = true;
        atomic_store_explicit(&pump->late, (uint8_t)(atomic_load_explicit(&pump->late, memory_order_relaxed) + 1u),
                              memory_order_relaxed);
    }
    return false;
}

static uint32_t bit_ticks(hg_pump *pump, const hg_clock *clock)
{
    if (pump->rate != clock->rate) {
        pump->rate = clock->rate;
        pump->owed = 0;
    }
    pump->owed += clock->rest;
    if (pump->owed < clock->rate) {
        return clock->base_ticks;
    }
    pump->owed -= clock->rate;
    return clock->base_ticks + 1u;
}

hg_bit hg_pump_next(hg_pump *pump)
{
    hg_bit bit = {pump->dark_ticks, 0, false};
    if (!leased(pump)) {
        pump->at = 0;
        pump->waiting = false;
        atomic_store_explicit(&pump->idle, 1, memory_order_release);
        return bit;
    }
    uint8_t front = atomic_load_explicit(&pump->front, memory_order_relaxed);
    const bool more = turned(pump, &front);
    const hg_frame *const frame = &pump->frames[front];
    if (more) {
        bit.lit = ((frame->bits.bytes[pump->at >> 3] << (pump->at & 7u)) & 0x80) != 0;
        pump->at++;
    } else {
        bit.lit = frame->idle_lit;
    }
    bit.power = frame->power;
    bit.ticks = bit_ticks(pump, &frame->clock);
    pump->lease_ticks = pump->lease_ticks > bit.ticks ? pump->lease_ticks - bit.ticks : 0u;
    return bit;
}

void hg_pump_halt(hg_pump *pump)
{
    pump->lease_ticks = 0;
    pump->at = 0;
    pump->waiting = false;
    atomic_store(&pump->leased, 0);
    atomic_store(&pump->idle, 1);
}

bool hg_pump_is_idle(const hg_pump *pump)
{
    /* In this order: the pump clears `idle` before it clears `leased`. */
    return atomic_load_explicit(&pump->leased, memory_order_acquire) == 0u
           && atomic_load_explicit(&pump->idle, memory_order_acquire) != 0u;
}

bool hg_pump_lease(hg_pump *pump, uint64_t ticks)
{
    if (atomic_load_explicit(&pump->leased, memory_order_acquire) != 0u) {
        return false;
    }
    pump->lease_new = ticks;
    /* In this order: while `dark` stands, the pump throws leases away. */
    atomic_store_explicit(&pump->dark, 0, memory_order_release);
    atomic_store_explicit(&pump->leased, 1, memory_order_release);
    return true;
}

void hg_pump_darken(hg_pump *pump)
{
    atomic_store_explicit(&pump->dark, 1, memory_order_release);
}

hg_frame *hg_pump_free(hg_pump *pump)
{
    if (atomic_load_explicit(&pump->ready, memory_order_acquire) != 0u) {
        return 0;
    }
    return &pump->frames[atomic_load_explicit(&pump->front, memory_order_relaxed) ^ 1u];
}

void hg_pump_ready(hg_pump *pump)
{
    atomic_store_explicit(&pump->ready, 1, memory_order_release);
}

hg_frame *hg_pump_first(hg_pump *pump)
{
    atomic_store_explicit(&pump->ready, 0, memory_order_relaxed);
    return &pump->frames[atomic_load_explicit(&pump->front, memory_order_relaxed)];
}

uint16_t hg_pump_program(const hg_pump *pump)
{
    return pump->frames[atomic_load_explicit(&pump->front, memory_order_acquire)].program;
}
