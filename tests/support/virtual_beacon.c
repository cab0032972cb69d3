/* The firmware's core as a library for tests: many beacons in one process, in a time that the test makes. */
#include <stdlib.h>
#include <string.h>

#include "hg_beacon.h"

#define NS_PER_MS 1000000u
#define OUT_MOST 65536u
#define EDGES_MOST 65536u

typedef struct {
    hg_beacon beacon;
    uint8_t uid[8];
    uint64_t now_ns, next_ns;
    bool lit;
    uint8_t out[OUT_MOST];
    size_t out_n;
    uint64_t edge_ns[EDGES_MOST];
    uint8_t edge_level[EDGES_MOST];
    size_t edges_n;
    uint8_t stored[HG_STORE_MOST];
    size_t stored_n;
} machine;

static bool put(void *context, const uint8_t *bytes, size_t n)
{
    machine *const self = context;
    if (self->out_n + n > OUT_MOST) {
        return false;
    }
    memcpy(self->out + self->out_n, bytes, n);
    self->out_n += n;
    return true;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    machine *const self = context;
    memcpy(self->stored, bytes, n);
    self->stored_n = n;
    return true;
}

static size_t load(void *context, uint8_t *bytes)
{
    const machine *const self = context;
    memcpy(bytes, self->stored, self->stored_n);
    return self->stored_n;
}

void vb_boot(machine *self, uint16_t boot)
{
    hg_hardware hardware = {
        .capabilities = HG_CAN_SEED11 | HG_CAN_CODE | HG_CAN_UART | HG_CAN_PACKET | HG_CAN_POWER | HG_CAN_SAVE,
        .rate_least = 1000u,
        .rate_most = 100000000u,
        .ticks_per_s = 1000000000u,
        .port = "test",
    };
    const hg_port port = {.context = self, .write = put, .save = save, .load = load};
    memcpy(hardware.uid, self->uid, sizeof hardware.uid);
    hg_beacon_init(&self->beacon, &hardware, &port, boot, HG_RESET_POWER, (uint32_t)(self->now_ns / NS_PER_MS));
}

machine *vb_new(const uint8_t *uid, uint16_t boot)
{
    machine *const self = calloc(1, sizeof *self);
    if (self != 0) {
        memcpy(self->uid, uid, sizeof self->uid);
        vb_boot(self, boot);
    }
    return self;
}

void vb_free(machine *self)
{
    free(self);
}

void vb_run(machine *self, uint64_t until_ns)
{
    while (self->next_ns <= until_ns) {
        const hg_bit bit = hg_pump_next(&self->beacon.pump);
        if (bit.lit != self->lit && self->edges_n < EDGES_MOST) {
            self->edge_ns[self->edges_n] = self->next_ns;
            self->edge_level[self->edges_n++] = bit.lit;
        }
        self->lit = bit.lit;
        hg_beacon_poll(&self->beacon, (uint32_t)(self->next_ns / NS_PER_MS));
        self->next_ns += bit.ticks;
    }
    self->now_ns = until_ns;
    hg_beacon_poll(&self->beacon, (uint32_t)(until_ns / NS_PER_MS));
}

void vb_receive(machine *self, const uint8_t *bytes, size_t n)
{
    hg_beacon_receive(&self->beacon, bytes, n, (uint32_t)(self->now_ns / NS_PER_MS));
    hg_beacon_poll(&self->beacon, (uint32_t)(self->now_ns / NS_PER_MS));
}

size_t vb_take(machine *self, uint8_t *bytes)
{
    const size_t n = self->out_n;
    memcpy(bytes, self->out, n);
    self->out_n = 0;
    return n;
}

size_t vb_edges(machine *self, uint64_t *t_ns, uint8_t *level)
{
    const size_t n = self->edges_n;
    memcpy(t_ns, self->edge_ns, n * sizeof *t_ns);
    memcpy(level, self->edge_level, n);
    self->edges_n = 0;
    return n;
}

/* What it does, read off its memory: asking it would be a request, which it remembers. */
void vb_look(const machine *self, uint32_t *seen)
{
    const hg_beacon *const beacon = &self->beacon;
    seen[0] = self->lit;
    seen[1] = hg_beacon_is_armed(beacon);
    seen[2] = beacon->program_id;
    seen[3] = beacon->source.program.payload;
    seen[4] = beacon->source.program.rate;
    seen[5] = beacon->source.last_id;
    seen[6] = beacon->messages_sent;
}
