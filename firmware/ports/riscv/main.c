/* The beacon on QEMU's `virt` machine, RV32IMAC, freestanding: the core on a third instruction set, and nothing else.
 *
 *   line   the 16550 UART at 0x10000000, polled
 *   clock  mtime of the CLINT, 10 MHz; mtimecmp interrupts where a bit begins
 *   LED    none: the interrupt notes level and mtime, the main loop writes "t_ns,level" lines to edges.txt (semihosting)
 *
 * The time noted is the bit clock's own, as in the ports whose timer switches the pin: this port shows that the core computes
 * the same light on a third instruction set, not how late its interrupts are. Nothing can be kept: SAVE is unsupported.
 */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "hg_beacon.h"

#define UART ((volatile uint8_t *)0x10000000u)
#define UART_STATUS 5
#define UART_HAS_BYTE 0x01u
#define UART_HAS_ROOM 0x20u
#define MTIMECMP ((volatile uint32_t *)0x02004000u)
#define MTIME ((volatile uint32_t *)0x0200BFF8u)
#define TICKS_PER_S 10000000u
#define TICKS_PER_MS 10000u
#define TICK_NS 100u
#define EDGES 1024u
#define SYS_OPEN 1
#define SYS_WRITE 5
#define OPEN_TO_WRITE 4
#define MIE_TIMER 0x80u
#define MSTATUS_ENABLED 0x08u

intptr_t semihost(intptr_t operation, const void *arguments);
int main(void);
void trap(void) __attribute__((interrupt("machine"), aligned(4)));

static hg_beacon beacon;
static uint64_t edges[EDGES]; /* time in ticks, level in the lowest bit */
static volatile uint32_t edges_in;
static uint32_t edges_out;
static uint64_t bit_at;
static bool lit;
static intptr_t file;

/* The compiler may call these; there is no library. */
void *memset(void *to, int byte, size_t n)
{
    volatile uint8_t *at = to;
    while (n-- > 0) {
        *at++ = (uint8_t)byte;
    }
    return to;
}

void *memcpy(void *restrict to, const void *restrict from, size_t n)
{
    volatile uint8_t *at = to;
    const uint8_t *source = from;
    while (n-- > 0) {
        *at++ = *source++;
    }
    return to;
}

int memcmp(const void *a, const void *b, size_t n)
{
    const uint8_t *left = a;
    const uint8_t *right = b;
    for (; n > 0; n--, left++, right++) {
        if (*left != *right) {
            return *left - *right;
        }
    }
    return 0;
}

static uint64_t now_ticks(void)
{
    uint32_t high;
    uint32_t low;
    do {
        high = MTIME[1];
        low = MTIME[0];
    } while (MTIME[1] != high);
    return ((uint64_t)high << 32) | low;
}

static uint32_t now_ms(void)
{
    return (uint32_t)(now_ticks() / TICKS_PER_MS);
}

static void alarm_at(uint64_t ticks)
{
    MTIMECMP[1] = UINT32_MAX;
    MTIMECMP[0] = (uint32_t)ticks;
    MTIMECMP[1] = (uint32_t)(ticks >> 32);
}

void trap(void)
{
    const hg_bit bit = hg_pump_next(&beacon.pump);
    if (bit.lit != lit) {
        lit = bit.lit;
        edges[edges_in % EDGES] = (bit_at << 1) | (lit ? 1u : 0u);
        edges_in++;
    }
    bit_at += bit.ticks;
    alarm_at(bit_at);
}

static bool write_line(void *context, const uint8_t *bytes, size_t n)
{
    (void)context;
    for (size_t i = 0; i < n; i++) {
        while ((UART[UART_STATUS] & UART_HAS_ROOM) == 0u) {
        }
        UART[0] = bytes[i];
    }
    return true;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    (void)context;
    (void)bytes;
    (void)n;
    return false;
}

static size_t load(void *context, uint8_t *bytes)
{
    (void)context;
    (void)bytes;
    return 0;
}

static void write_edges(void)
{
    char text[24 * 32];
    size_t n = 0;
    while (edges_out != edges_in && n < sizeof text - 24) {
        char digits[20];
        size_t count = 0;
        const uint64_t edge = edges[edges_out % EDGES];
        for (uint64_t left = (edge >> 1) * TICK_NS; left != 0u || count == 0; left /= 10u) {
            digits[count++] = (char)('0' + (char)(left % 10u));
        }
        while (count > 0) {
            text[n++] = digits[--count];
        }
        text[n++] = ',';
        text[n++] = (edge & 1u) != 0u ? '1' : '0';
        text[n++] = '\n';
        edges_out++;
    }
    if (n > 0) {
        const intptr_t arguments[3] = {file, (intptr_t)text, (intptr_t)n};
        (void)semihost(SYS_WRITE, arguments);
    }
}

int main(void)
{
    static const char name[] = "edges.txt";
    const intptr_t arguments[3] = {(intptr_t)name, OPEN_TO_WRITE, sizeof name - 1};
    const hg_hardware hardware = {
        .uid = {0, 0, 0, 0, 'r', 'v', '3', '2'},
        .capabilities = HG_CAN_SEED11 | HG_CAN_CODE | HG_CAN_UART | HG_CAN_PACKET,
        .rate_least = 50000,
        .rate_most = 10000000,
        .ticks_per_s = TICKS_PER_S,
        .port = "riscv",
    };
    const hg_port port = {.context = 0, .write = write_line, .save = save, .load = load};
    file = semihost(SYS_OPEN, arguments);
    hg_beacon_init(&beacon, &hardware, &port, 1, HG_RESET_POWER, now_ms());
    bit_at = now_ticks() + TICKS_PER_MS;
    alarm_at(bit_at);
    __asm__ volatile("csrs mie, %0; csrs mstatus, %1" ::"r"(MIE_TIMER), "r"(MSTATUS_ENABLED));
    for (;;) {
        while ((UART[UART_STATUS] & UART_HAS_BYTE) != 0u) {
            const uint8_t byte = UART[0];
            hg_beacon_receive(&beacon, &byte, 1, now_ms());
        }
        hg_beacon_poll(&beacon, now_ms());
        write_edges();
    }
}
