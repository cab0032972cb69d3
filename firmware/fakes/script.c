/* A machine of pure fiction: the core on a clock that stands still until it is told to run. For tests.
 *
 *   beacon-script [TICKS_PER_S [POLL_NS]]     reads commands on stdin, a line each, and answers each with any number of
 *                                             "tx HEX" and "edge T_NS,LEVEL" lines and a line "."
 *   rx HEX     bytes come on the line          run NS     time passes
 *   line 0|1   the line takes no bytes | does  store 0|1  the store fails | works
 *   kept HEX   what the store holds            reboot     by the watchdog
 *   stall NS   time passes for the interrupt alone: the main loop hangs
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hg_beacon.h"

#define NS_PER_MS 1000000u
#define NS_PER_S 1000000000u
#define LINE_MOST 2048

typedef struct {
    hg_beacon beacon;
    uint32_t ticks_per_s;
    uint64_t poll_ns, now_ns, polled_ns, next_ticks;
    uint8_t kept[HG_STORE_MOST];
    size_t kept_n;
    uint16_t boot;
    bool line, store, lit;
} machine;

static void print_hex(const char *word, const uint8_t *bytes, size_t n)
{
    printf("%s ", word);
    for (size_t i = 0; i < n; i++) {
        printf("%02x", bytes[i]);
    }
    printf("\n");
}

static bool write_line(void *context, const uint8_t *bytes, size_t n)
{
    const machine *const self = context;
    if (self->line) {
        print_hex("tx", bytes, n);
    }
    return self->line;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    machine *const self = context;
    if (self->store) {
        memcpy(self->kept, bytes, n);
        self->kept_n = n;
        print_hex("kept", bytes, n);
    }
    return self->store;
}

static size_t load(void *context, uint8_t *bytes)
{
    const machine *const self = context;
    memcpy(bytes, self->kept, self->kept_n);
    return self->kept_n;
}

static uint32_t now_ms(const machine *self)
{
    return (uint32_t)(self->now_ns / NS_PER_MS);
}

static uint64_t ns_of(const machine *self, uint64_t ticks)
{
    return ticks / self->ticks_per_s * NS_PER_S + ticks % self->ticks_per_s * NS_PER_S / self->ticks_per_s;
}

static void boot_up(machine *self, enum hg_reset reason)
{
    const hg_hardware hardware = {
        .uid = {1, 2, 3, 4, 5, 6, 7, 8},
        .capabilities = HG_CAN_SEED11 | HG_CAN_CODE | HG_CAN_UART | HG_CAN_PACKET | HG_CAN_SAVE,
        .rate_least = 10000,
        .rate_most = 20000000,
        .ticks_per_s = self->ticks_per_s,
        .port = "script",
    };
    const hg_port port = {.context = self, .write = write_line, .save = save, .load = load};
    self->boot++;
    hg_beacon_init(&self->beacon, &hardware, &port, self->boot, reason, now_ms(self));
    hg_beacon_poll(&self->beacon, now_ms(self));
}

static void tell(machine *self, uint64_t t_ns, bool lit)
{
    if (lit != self->lit) {
        printf("edge %" PRIu64 ",%d\n", t_ns, lit ? 1 : 0);
    }
    self->lit = lit;
}

/* Time passes; the main loop polls every poll_ns, or, where it hangs, not at all. */
static void run(machine *self, uint64_t ns, bool hangs)
{
    const uint64_t end_ns = self->now_ns + ns;
    while (self->now_ns < end_ns) {
        const uint64_t bit_ns = ns_of(self, self->next_ticks);
        const uint64_t poll_ns = hangs ? end_ns : self->polled_ns + self->poll_ns;
        if (bit_ns < end_ns && bit_ns <= poll_ns) {
            self->now_ns = bit_ns;
            const hg_bit bit = hg_pump_next(&self->beacon.pump);
            self->next_ticks += bit.ticks;
            tell(self, bit_ns, bit.lit);
        } else {
            self->now_ns = poll_ns < end_ns ? poll_ns : end_ns;
            self->polled_ns = self->now_ns;
            if (!hangs) {
                hg_beacon_poll(&self->beacon, now_ms(self));
            }
        }
    }
}

static size_t read_hex(uint8_t *bytes, size_t most, const char *text)
{
    size_t n = 0;
    unsigned byte;
    while (n < most && sscanf(text + 2 * n, "%2x", &byte) == 1) {
        bytes[n++] = (uint8_t)byte;
    }
    return n;
}

static void obey(machine *self, const char *word, const char *rest)
{
    uint8_t bytes[LINE_MOST / 2];
    if (strcmp(word, "rx") == 0) {
        hg_beacon_receive(&self->beacon, bytes, read_hex(bytes, sizeof bytes, rest), now_ms(self));
        hg_beacon_poll(&self->beacon, now_ms(self));
    } else if (strcmp(word, "run") == 0) {
        run(self, strtoull(rest, 0, 10), false);
    } else if (strcmp(word, "stall") == 0) {
        run(self, strtoull(rest, 0, 10), true);
    } else if (strcmp(word, "line") == 0) {
        self->line = rest[0] == '1';
    } else if (strcmp(word, "store") == 0) {
        self->store = rest[0] == '1';
    } else if (strcmp(word, "kept") == 0) {
        self->kept_n = read_hex(self->kept, sizeof self->kept, rest);
    } else if (strcmp(word, "reboot") == 0) {
        tell(self, self->now_ns, false);
        boot_up(self, HG_RESET_WATCHDOG);
    }
}

int main(int n, char **words)
{
    static machine self = {.line = true, .store = true};
    self.ticks_per_s = n > 1 ? (uint32_t)strtoul(words[1], 0, 10) : NS_PER_S;
    self.poll_ns = n > 2 ? strtoull(words[2], 0, 10) : NS_PER_MS / 10u;
    char line[LINE_MOST];
    boot_up(&self, HG_RESET_POWER);
    printf(".\n");
    (void)fflush(stdout);
    while (fgets(line, sizeof line, stdin) != 0) {
        line[strcspn(line, "\n")] = '\0';
        char *const rest = strchr(line, ' ');
        if (rest != 0) {
            *rest = '\0';
        }
        obey(&self, line, rest != 0 ? rest + 1 : "");
        printf(".\n");
        (void)fflush(stdout);
    }
    return 0;
}
