/* The AVR port's firmware in simavr, cycle by cycle, driven like fakes/script.c:
 *
 *   simavr_run FIRMWARE.elf      reads commands on stdin, a line each, and answers each with any number of "tx HEX" (whole
 *                                frames), "edge T_NS,LEVEL" and "now T_NS" lines and a line "."
 *   rx HEX    bytes come on the line, at its pace; time passes until a reply is there, at most 300 ms
 *   run NS    time passes
 *   flip NS   like rx of nothing: nothing comes, time passes until the next edge, at most NS
 *
 * An edge's time is that of the cycle in which the pin changes.
 */
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

#define FREQUENCY_HZ 16000000u
#define NS_PER_S 1000000000u
#define LED_PIN 5
#define BYTE_CYCLES (FREQUENCY_HZ / 11520u)
#define REPLY_CYCLES (FREQUENCY_HZ / 1000u * 300u)
#define LINE_MOST 4096
#define REPLY_BIT 0x80

typedef struct {
    avr_t *avr;
    avr_irq_t *input;
    uint8_t heard[LINE_MOST];
    size_t heard_n;
    bool replied, flipped, lit;
} machine;

static uint64_t ns_of(avr_cycle_count_t cycle)
{
    return cycle / FREQUENCY_HZ * NS_PER_S + cycle % FREQUENCY_HZ * NS_PER_S / FREQUENCY_HZ;
}

static void on_pin(struct avr_irq_t *irq, uint32_t value, void *context)
{
    (void)irq;
    machine *const self = context;
    const bool lit = (value & 1u) != 0; /* above it, simavr has marks of its own */
    if (lit != self->lit) {
        printf("edge %" PRIu64 ",%d\n", ns_of(self->avr->cycle), lit ? 1 : 0);
        self->lit = lit;
        self->flipped = true;
    }
}

/* Tell whole frames only; a frame's third byte, behind the code byte of COBS, is its TYPE. */
static void on_byte(struct avr_irq_t *irq, uint32_t value, void *context)
{
    (void)irq;
    machine *const self = context;
    if (self->heard_n < sizeof self->heard) {
        self->heard[self->heard_n++] = (uint8_t)value;
    }
    if (value != 0 || self->heard_n == 1) {
        self->heard_n = value == 0 ? 0 : self->heard_n;
        return;
    }
    self->replied = self->replied || (self->heard_n > 3 && (self->heard[2] & REPLY_BIT) != 0);
    printf("tx 00");
    for (size_t i = 0; i < self->heard_n; i++) {
        printf("%02x", self->heard[i]);
    }
    printf("\n");
    self->heard_n = 0;
}

static bool run_to(machine *self, avr_cycle_count_t end, const bool *enough)
{
    while (self->avr->cycle < end && !(enough != 0 && *enough)) {
        const int state = avr_run(self->avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            fprintf(stderr, "simavr_run: the firmware crashed at cycle %" PRIu64 "\n", self->avr->cycle);
            return false;
        }
    }
    return true;
}

static bool receive(machine *self, const char *text)
{
    unsigned byte;
    self->replied = false;
    while (sscanf(text, "%2x", &byte) == 1) {
        avr_raise_irq(self->input, byte);
        if (!run_to(self, self->avr->cycle + BYTE_CYCLES, 0)) {
            return false;
        }
        text += 2;
    }
    return run_to(self, self->avr->cycle + REPLY_CYCLES, &self->replied);
}

static avr_cycle_count_t cycles_of(uint64_t ns)
{
    return ns / NS_PER_S * FREQUENCY_HZ + ns % NS_PER_S * (FREQUENCY_HZ / 1000000u) / 1000u;
}

static bool obey(machine *self, const char *line)
{
    if (strncmp(line, "rx ", 3) == 0) {
        return receive(self, line + 3);
    }
    if (strncmp(line, "flip ", 5) == 0) {
        self->flipped = false;
        return run_to(self, self->avr->cycle + cycles_of(strtoull(line + 5, 0, 10)), &self->flipped);
    }
    return strncmp(line, "run ", 4) != 0 || run_to(self, self->avr->cycle + cycles_of(strtoull(line + 4, 0, 10)), 0);
}

static bool load(machine *self, const char *path)
{
    elf_firmware_t firmware = {0};
    self->avr = avr_make_mcu_by_name("atmega1284p");
    if (self->avr == 0 || elf_read_firmware(path, &firmware) != 0) {
        fprintf(stderr, "simavr_run: cannot load %s\n", path);
        return false;
    }
    avr_init(self->avr);
    avr_load_firmware(self->avr, &firmware);
    self->avr->frequency = FREQUENCY_HZ;
    self->avr->log = LOG_ERROR;
    uint32_t flags = 0; /* neither echo on stdout nor real time */
    avr_ioctl(self->avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    self->input = avr_io_getirq(self->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(self->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, self);
    avr_irq_register_notify(avr_io_getirq(self->avr, AVR_IOCTL_IOPORT_GETIRQ('D'), LED_PIN), on_pin, self);
    return true;
}

int main(int n, char **words)
{
    static machine self;
    char line[LINE_MOST];
    if (n != 2 || !load(&self, words[1])) {
        return 2;
    }
    printf(".\n");
    (void)fflush(stdout);
    while (fgets(line, sizeof line, stdin) != 0) {
        if (!obey(&self, line)) {
            return 1;
        }
        printf("now %" PRIu64 "\n.\n", ns_of(self.avr->cycle));
        (void)fflush(stdout);
    }
    avr_terminate(self.avr);
    return 0;
}
