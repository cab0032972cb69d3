/* A virtual beacon: the firmware's core on a pseudo-terminal or a TCP port, with the LED's edges as lines of text.
 * README.md of the firmware has its options and its output.
 *
 * A tick is a nanosecond. The pump is run up to the present before any byte is looked at, so a command takes effect when it
 * came, and edges carry the bit clock's own times, however late this process is woken.
 */
#define _XOPEN_SOURCE 700

#include <errno.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "hg_beacon.h"
#include "serial.h"

#define NS_PER_MS 1000000u
#define NS_PER_S 1000000000u
#define WAKE_MS 2
#define NOTE_NS (5u * NS_PER_MS)
#define RATE_LEAST 1000u
#define RATE_MOST 100000000u

typedef struct {
    const char *pty, *edges, *store;
    long tcp;
    uint8_t uid[8];
    bool realtime;
} options;

typedef struct {
    hg_beacon beacon;
    serial line;
    options options;
    FILE *edges;
    uint64_t start_ns, offset_ns, next_ns, noted_ns;
    bool lit;
    uint16_t boot;
} machine;

static volatile sig_atomic_t stop;
static volatile sig_atomic_t reboot;

static void on_signal(int number)
{
    if (number == SIGUSR1) {
        reboot = 1;
    } else {
        stop = 1;
    }
}

static uint64_t clock_ns(clockid_t clock)
{
    struct timespec now;
    (void)clock_gettime(clock, &now);
    return (uint64_t)now.tv_sec * NS_PER_S + (uint64_t)now.tv_nsec;
}

static uint64_t now_ns(const machine *self)
{
    return clock_ns(CLOCK_MONOTONIC) - self->start_ns;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    const machine *const self = context;
    char beside[4096];
    if (snprintf(beside, sizeof beside, "%s.new", self->options.store) >= (int)sizeof beside) {
        return false;
    }
    FILE *const file = fopen(beside, "wb");
    if (file == 0) {
        return false;
    }
    const bool written = fwrite(bytes, 1, n, file) == n;
    return fclose(file) == 0 && written && rename(beside, self->options.store) == 0;
}

static size_t load(void *context, uint8_t *bytes)
{
    const machine *const self = context;
    FILE *const file = self->options.store != 0 ? fopen(self->options.store, "rb") : 0;
    if (file == 0) {
        return 0;
    }
    const size_t n = fread(bytes, 1, HG_STORE_MOST, file);
    (void)fclose(file);
    return n;
}

static bool write_line(void *context, const uint8_t *bytes, size_t n)
{
    machine *const self = context;
    return serial_write(&self->line, bytes, n);
}

static uint16_t other_boot(uint16_t before)
{
    uint16_t boot = (uint16_t)(before + 1u);
    FILE *const random = before == 0u ? fopen("/dev/urandom", "rb") : 0;
    if (random != 0) {
        if (fread(&boot, sizeof boot, 1, random) != 1u) {
            boot = 1;
        }
        (void)fclose(random);
    }
    return boot == 0u ? 1u : boot;
}

static void boot_up(machine *self, enum hg_reset reason)
{
    hg_hardware hardware = {
        .capabilities = HG_CAN_SEED11 | HG_CAN_CODE | HG_CAN_UART | HG_CAN_PACKET | HG_CAN_POWER
                        | (self->options.store != 0 ? HG_CAN_SAVE : 0u),
        .rate_least = RATE_LEAST,
        .rate_most = RATE_MOST,
        .ticks_per_s = NS_PER_S,
        .port = "posix",
    };
    const hg_port port = {.context = self, .write = write_line, .save = save, .load = load};
    memcpy(hardware.uid, self->options.uid, sizeof hardware.uid);
    self->boot = other_boot(self->boot);
    hg_beacon_init(&self->beacon, &hardware, &port, self->boot, reason, (uint32_t)(self->next_ns / NS_PER_MS));
}

static void tell(machine *self, uint64_t t_ns, bool lit)
{
    if (lit != self->lit && self->edges != 0) {
        fprintf(self->edges, "%" PRIu64 ",%d\n", self->offset_ns + t_ns, lit ? 1 : 0);
    }
    self->lit = lit;
}

static void run_to(machine *self, uint64_t until_ns)
{
    while (self->next_ns <= until_ns) {
        const hg_bit bit = hg_pump_next(&self->beacon.pump);
        tell(self, self->next_ns, bit.lit);
        hg_beacon_poll(&self->beacon, (uint32_t)(self->next_ns / NS_PER_MS));
        self->next_ns += bit.ticks;
    }
    if (self->edges != 0 && until_ns - self->noted_ns >= NOTE_NS) {
        self->noted_ns = until_ns;
        fprintf(self->edges, "# until %" PRIu64 "\n", self->offset_ns + until_ns);
        (void)fflush(self->edges);
    }
}

static void run(machine *self)
{
    uint8_t bytes[256];
    while (stop == 0) {
        const size_t n = serial_read(&self->line, bytes, sizeof bytes, WAKE_MS);
        const uint64_t present_ns = now_ns(self);
        run_to(self, present_ns);
        if (reboot != 0) {
            reboot = 0;
            tell(self, self->next_ns, false);
            boot_up(self, HG_RESET_RESET);
        }
        hg_beacon_receive(&self->beacon, bytes, n, (uint32_t)(present_ns / NS_PER_MS));
        hg_beacon_poll(&self->beacon, (uint32_t)(present_ns / NS_PER_MS));
    }
    tell(self, self->next_ns, false);
}

static bool read_uid(const char *text, uint8_t *uid)
{
    char *end;
    errno = 0;
    const unsigned long long value = strtoull(text, &end, 16);
    if (strlen(text) != 16u || *end != '\0' || errno != 0) {
        return false;
    }
    for (int i = 0; i < 8; i++) {
        uid[i] = (uint8_t)(value >> (56 - 8 * i));
    }
    return true;
}

static bool read_port(const char *text, long *port)
{
    char *end;
    *port = strtol(text, &end, 10);
    return *text != '\0' && *end == '\0' && *port >= 0 && *port <= 65535;
}

static bool read_options(options *chosen, int n, char **words)
{
    *chosen = (options){.tcp = -1, .uid = {0, 0, 0, 0, 'p', 'o', 's', 'x'}};
    for (int i = 1; i < n; i++) {
        const char *const value = i + 1 < n ? words[i + 1] : 0;
        if (strcmp(words[i], "--realtime") == 0) {
            chosen->realtime = true;
            continue;
        }
        i++;
        if (value == 0) {
            return false;
        }
        const char *const word = words[i - 1];
        if (strcmp(word, "--pty") == 0) {
            chosen->pty = value;
        } else if (strcmp(word, "--edges") == 0) {
            chosen->edges = value;
        } else if (strcmp(word, "--store") == 0) {
            chosen->store = value;
        } else if (strcmp(word, "--uid") == 0 ? !read_uid(value, chosen->uid)
                                              : strcmp(word, "--tcp") != 0 || !read_port(value, &chosen->tcp)) {
            return false;
        }
    }
    return (chosen->pty != 0) != (chosen->tcp >= 0);
}

static bool open_all(machine *self)
{
    if (self->options.edges != 0) {
        self->edges = strcmp(self->options.edges, "-") == 0 ? stdout : fopen(self->options.edges, "w");
        if (self->edges == 0) {
            fprintf(stderr, "beacon-posix: cannot write %s: %s\n", self->options.edges, strerror(errno));
            return false;
        }
    }
    const bool opened = self->options.pty != 0 ? serial_open_pty(&self->line, self->options.pty)
                                               : serial_open_tcp(&self->line, (uint16_t)self->options.tcp);
    if (!opened) {
        fprintf(stderr, "beacon-posix: cannot open the line: %s\n", strerror(errno));
    }
    return opened;
}

int main(int n, char **words)
{
    static machine self;
    if (!read_options(&self.options, n, words)) {
        fputs("usage: beacon-posix (--pty LINK | --tcp PORT) [--edges FILE] [--store FILE] [--uid 16 HEX DIGITS] "
              "[--realtime]\n",
              stderr);
        return 2;
    }
    struct sigaction action = {.sa_handler = on_signal};
    (void)sigaction(SIGTERM, &action, 0);
    (void)sigaction(SIGINT, &action, 0);
    (void)sigaction(SIGUSR1, &action, 0);
    if (!open_all(&self)) {
        return 1;
    }
    self.start_ns = clock_ns(CLOCK_MONOTONIC);
    self.offset_ns = self.options.realtime ? clock_ns(CLOCK_REALTIME) : 0u;
    boot_up(&self, HG_RESET_POWER);
    run(&self);
    serial_close(&self.line);
    return self.edges != 0 && fflush(self.edges) != 0 ? 1 : 0;
}
