/* The bit pump: hands out the light's next bit, in an interrupt, while the main loop prepares the next frame.
 *
 * Two frames: `front` is on the air, the other is the main loop's until it is `ready`; where the front one ends, the pump
 * changes over. Nothing else is shared but single bytes and, behind a flag, the lease; one writer each:
 *
 *   front   pump     which frame is on the air
 *   ready   main 1, pump 0    the other frame is to follow
 *   leased  main 1, pump 0    lease_new is to be taken
 *   dark    main     no light, whatever the lease says
 *   idle    pump     it is dark and reads no frame: both are the main loop's until a lease is taken
 *
 * Bit clock: a bit lasts TICKS / r ticks, r = rate / 1000; the quotient is base, the remainder goes on in `owed` (Bresenham),
 * so an edge is off by less than one tick and the error never grows. No division, no float; the divisions are in
 * hg_clock_of, which the main loop calls.
 */
#ifndef HG_PUMP_H
#define HG_PUMP_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include "hg_frames.h"

typedef struct {
    uint32_t base_ticks; /* whole ticks of a bit */
    uint32_t rest;       /* and this part of `rate` of another tick */
    uint32_t rate;       /* thousandths of a bit/s */
} hg_clock;

typedef struct {
    hg_bits bits;
    hg_clock clock;
    uint16_t power;   /* thousandths */
    uint16_t program; /* whose frame it is */
    bool repeat;      /* again and again, until another is ready */
    bool idle_lit;    /* the level while there should be another, and is none */
} hg_frame;

typedef struct {
    uint32_t ticks;
    uint16_t power;
    bool lit;
} hg_bit;

typedef struct {
    hg_frame frames[2];
    atomic_uchar front, ready, leased, dark, idle;
    uint64_t lease_new;
    /* The pump's own. */
    uint64_t lease_ticks;
    uint32_t owed;
    uint32_t rate;
    uint32_t dark_ticks; /* length of a bit while there is no light: how soon an ARM is seen */
    uint16_t at;
    atomic_uchar late;   /* frames that were not ready in time; wraps: the main loop adds the differences */
    bool waiting;        /* this one was counted */
} hg_pump;

/* The clock of a rate, in thousandths of a bit/s, on so many ticks a second. */
hg_clock hg_clock_of(uint32_t ticks_per_s, uint32_t rate);

/* Make it dark, idle and empty. */
void hg_pump_init(hg_pump *pump, uint32_t ticks_per_s);

/* The next bit: call it when the one before begins (or ahead of it). Safe in an interrupt. */
hg_bit hg_pump_next(hg_pump *pump);

/* Make the pump idle from outside, where it has been stopped and no interrupt can call hg_pump_next. */
void hg_pump_halt(hg_pump *pump);

/* Main loop: whether the frames are its own. */
bool hg_pump_is_idle(const hg_pump *pump);

/* Main loop: grant a lease; false where the last one was not taken yet. */
bool hg_pump_lease(hg_pump *pump, uint64_t ticks);

/* Main loop: no light from the next bit on, and no lease in hand. */
void hg_pump_darken(hg_pump *pump);

/* Main loop: the frame that may be written, or null while one waits. */
hg_frame *hg_pump_free(hg_pump *pump);

/* Main loop: it is written. */
void hg_pump_ready(hg_pump *pump);

/* Main loop, idle only: the frame that will be sent first; what was ready is not. */
hg_frame *hg_pump_first(hg_pump *pump);

/* Main loop: the program of the frame on the air. */
uint16_t hg_pump_program(const hg_pump *pump);

#endif
