/* libFuzzer on the whole core: what comes on the line, and when, is the fuzzer's; ASan and UBSan watch.
 *
 * The input is a row of steps, each a byte of kind and what follows it:
 *   0..99     so many bytes come on the line as they are
 *   100..179  a request of type (kind - 100) / 8, with a sound CRC, sequence number kind % 8, and a payload of the next
 *             byte's length
 *   180..229  (kind - 179) milliseconds pass; the pump and the main loop take turns
 *   230..249  time passes for the pump alone, as if the main loop hung
 *   250..255  the line takes no bytes (even) or does (odd); 254 reboots
 *
 * Checked at each step: dark unless armed, no bit without a length, and no more light than a lease and a bit's.
 */
#include <stdlib.h>
#include <string.h>

#include "hg_beacon.h"
#include "hg_bytes.h"

#define TICKS_PER_S 1000000u

typedef struct {
    hg_beacon beacon;
    uint8_t kept[HG_STORE_MOST];
    size_t kept_n;
    uint64_t now_ticks, next_ticks;
    bool line;
    uint16_t boot;
} machine;

static void demand(bool truth)
{
    if (!truth) {
        abort();
    }
}

static bool write_line(void *context, const uint8_t *bytes, size_t n)
{
    const machine *const self = context;
    demand(n <= HG_WIRE_MOST && bytes[0] == 0 && bytes[n - 1] == 0 && memchr(bytes + 1, 0, n - 2) == 0);
    return self->line;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    machine *const self = context;
    demand(n <= HG_STORE_MOST);
    memcpy(self->kept, bytes, n);
    self->kept_n = n;
    return n % 2 == 0;
}

static size_t load(void *context, uint8_t *bytes)
{
    const machine *const self = context;
    memcpy(bytes, self->kept, self->kept_n);
    return self->kept_n;
}

static uint32_t now_ms(const machine *self)
{
    return (uint32_t)(self->now_ticks / 1000u);
}

static void boot_up(machine *self)
{
    const hg_hardware hardware = {.capabilities = 0x30F,
                                  .rate_least = 50000,
                                  .rate_most = 20000000,
                                  .ticks_per_s = TICKS_PER_S,
                                  .port = "fuzz"};
    const hg_port port = {.context = self, .write = write_line, .save = save, .load = load};
    hg_beacon_init(&self->beacon, &hardware, &port, ++self->boot, HG_RESET_POWER, now_ms(self));
}

static void run(machine *self, uint32_t ms, bool hangs)
{
    const uint64_t end = self->now_ticks + 1000u * (uint64_t)ms;
    while (self->next_ticks < end) {
        self->now_ticks = self->next_ticks > self->now_ticks ? self->next_ticks : self->now_ticks;
        const bool was_armed = hg_beacon_is_armed(&self->beacon);
        const hg_bit bit = hg_pump_next(&self->beacon.pump);
        demand(bit.ticks >= TICKS_PER_S / 20000u && bit.ticks <= TICKS_PER_S / 50u + 1u);
        demand(was_armed || !bit.lit);
        self->next_ticks += bit.ticks;
        if (!hangs) {
            hg_beacon_poll(&self->beacon, now_ms(self));
        }
    }
    self->now_ticks = end;
    hg_beacon_poll(&self->beacon, now_ms(self));
}

static void request(machine *self, uint8_t type, uint8_t seq, const uint8_t *payload, size_t n)
{
    uint8_t body[HG_BODY_MOST] = {HG_VERSION, type, 0, seq};
    uint8_t wire[HG_WIRE_MOST];
    hg_put16(body + 4, self->boot);
    n = n < HG_PAYLOAD_MOST ? n : HG_PAYLOAD_MOST;
    if (n > 0) {
        memcpy(body + HG_HEAD_BYTES, payload, n);
    }
    hg_beacon_receive(&self->beacon, wire, hg_line_frame(wire, body, HG_HEAD_BYTES + n), now_ms(self));
}

static size_t step(machine *self, const uint8_t *data, size_t size)
{
    const uint8_t kind = data[0];
    size_t used = 1;
    if (kind < 100) {
        used += kind < size - 1 ? kind : size - 1;
        hg_beacon_receive(&self->beacon, data + 1, used - 1, now_ms(self));
    } else if (kind < 180 && size > 1) {
        const size_t n = data[1] < size - 2 ? data[1] : size - 2;
        request(self, (uint8_t)((kind - 100) / 8), kind % 8, data + 2, n);
        used = 2 + n;
    } else if (kind < 230) {
        run(self, kind >= 180 ? kind - 179u : 1u, false);
    } else if (kind < 250) {
        run(self, kind - 229u, true);
    } else if (kind == 254) {
        boot_up(self);
    } else {
        self->line = kind % 2 != 0;
    }
    return used;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static machine self;
    memset(&self, 0, sizeof self);
    self.line = true;
    boot_up(&self);
    while (size > 0) {
        const size_t used = step(&self, data, size);
        data += used;
        size -= used;
    }
    return 0;
}
