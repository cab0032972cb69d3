/* The beacon on an ATmega1284P at 16 MHz. It has run in simavr, cycle by cycle; never on silicon.
 *
 *   PD5 (OC1A)  the LED's driver, lit = high; timer 1 at 2 MHz switches the pin itself, so no interrupt delays an edge
 *   PD0, PD1    the serial line, 115 200 baud, 8N1 (U2X: 2.1 % fast, within what a UART takes)
 *   timer 0     a millisecond
 *   EEPROM      0: number of the boot; 16: the saved program
 *
 * When a bit begins, the interrupt sets whether the pin toggles at its end: so the pump is one bit ahead, and a DISARM has to
 * undo what was set (darken). A bit lasts at most 65 535 ticks: 30.6 bit/s.
 * Toggling, not "set" and "clear" on compare: simavr 1.6 does those wrongly outside of its PWM modes.
 */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <string.h>
#include <util/atomic.h>

#include "hg_beacon.h"

#define TICKS_PER_S 2000000uL
#define RATE_LEAST 50000uL
#define RATE_MOST 10000000uL
#define LED_PIN PD5
#define BAUD_DIVIDER 16u /* 16 MHz / 8 / 115 200 - 1, rounded */
#define RING 256u        /* as far as a byte counts */
#define BOOT_AT ((uint16_t *)0)
#define STORE_LENGTH_AT ((uint8_t *)16)
#define STORE_AT ((uint8_t *)17)
#define UID_AT ((const uint8_t *)4088) /* the last eight bytes of the EEPROM, written once when it is made */

static hg_beacon beacon;
static uint32_t bit_ticks; /* of the bit that begins at the next compare */
static volatile uint32_t clock_ms;
static volatile uint8_t in_ring[RING], out_ring[RING];
static volatile uint8_t in_head, in_tail, out_head, out_tail;

static bool pin_is_lit(void)
{
    return (PIND & _BV(LED_PIN)) != 0;
}

/* Keep the pin as it is until the next compare, and let that toggle it or not. Where the compare unit lets go of the pin
 * (COM = 0), the port's own bit holds it; both are always alike, for the unit's latch changes with the pin alone. */
static void at_next_compare(bool lit)
{
    const bool now = pin_is_lit();
    PORTD = (uint8_t)(now ? PORTD | _BV(LED_PIN) : PORTD & ~_BV(LED_PIN));
    TCCR1A = (uint8_t)(lit != now ? _BV(COM1A0) : 0);
}

ISR(TIMER1_COMPA_vect)
{
    OCR1A = (uint16_t)(OCR1A + (uint16_t)bit_ticks);
    const hg_bit bit = hg_pump_next(&beacon.pump);
    bit_ticks = bit.ticks;
    at_next_compare(bit.lit);
}

ISR(TIMER0_COMPA_vect)
{
    clock_ms++;
}

ISR(USART0_RX_vect)
{
    in_ring[in_tail] = UDR0;
    if ((uint8_t)(in_tail + 1u) != in_head) {
        in_tail++;
    }
}

ISR(USART0_UDRE_vect)
{
    if (out_head == out_tail) {
        UCSR0B = (uint8_t)(UCSR0B & ~_BV(UDRIE0));
        return;
    }
    UDR0 = out_ring[out_head];
    out_head++;
}

static uint32_t now_ms(void)
{
    uint32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        now = clock_ms;
    }
    return now;
}

static bool write_line(void *context, const uint8_t *bytes, size_t n)
{
    (void)context;
    const uint8_t taken = (uint8_t)(out_tail - out_head);
    if (n > RING - 1u - taken) {
        return false;
    }
    for (size_t i = 0; i < n; i++) {
        out_ring[out_tail] = bytes[i];
        out_tail++;
    }
    UCSR0B = (uint8_t)(UCSR0B | _BV(UDRIE0));
    return true;
}

static bool save(void *context, const uint8_t *bytes, size_t n)
{
    (void)context;
    eeprom_update_byte(STORE_LENGTH_AT, (uint8_t)n);
    for (size_t i = 0; i < n; i++) {
        wdt_reset(); /* a byte takes 3.4 ms */
        eeprom_update_byte(STORE_AT + i, bytes[i]);
    }
    return true;
}

static size_t load(void *context, uint8_t *bytes)
{
    (void)context;
    const uint8_t n = eeprom_read_byte(STORE_LENGTH_AT);
    if (n > HG_STORE_MOST) {
        return 0;
    }
    eeprom_read_block(bytes, STORE_AT, n);
    return n;
}

static uint16_t next_boot(void)
{
    uint16_t boot = (uint16_t)(eeprom_read_word(BOOT_AT) + 1u);
    boot = boot == 0u ? 1u : boot;
    eeprom_update_word(BOOT_AT, boot);
    return boot;
}

static void start_hardware(void)
{
    DDRD = _BV(LED_PIN);
    UBRR0 = BAUD_DIVIDER;
    UCSR0A = _BV(U2X0);
    UCSR0B = (uint8_t)(_BV(RXCIE0) | _BV(RXEN0) | _BV(TXEN0));
    UCSR0C = (uint8_t)(_BV(UCSZ01) | _BV(UCSZ00));
    TCCR0A = _BV(WGM01);
    TCCR0B = (uint8_t)(_BV(CS01) | _BV(CS00)); /* 250 kHz */
    OCR0A = 249;
    TIMSK0 = _BV(OCIE0A);
    bit_ticks = beacon.pump.dark_ticks;
    at_next_compare(false);
    OCR1A = (uint16_t)bit_ticks;
    TCCR1B = _BV(CS11);
    TIMSK1 = _BV(OCIE1A);
}

/* Disarmed: dark now. The strobe toggles the compare unit's latch, so that it is dark, too, when it takes the pin again. */
static void darken(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (!hg_beacon_is_armed(&beacon)) {
            if (pin_is_lit()) {
                TCCR1A = _BV(COM1A0);
                TCCR1C = _BV(FOC1A);
            }
            PORTD = (uint8_t)(PORTD & ~_BV(LED_PIN));
            TCCR1A = 0;
        }
    }
}

int main(void)
{
    const uint8_t cause = MCUSR;
    MCUSR = 0;
    wdt_enable(WDTO_1S);
    hg_hardware hardware = {
        .capabilities = HG_CAN_SEED11 | HG_CAN_CODE | HG_CAN_UART | HG_CAN_PACKET | HG_CAN_SAVE,
        .rate_least = RATE_LEAST,
        .rate_most = RATE_MOST,
        .ticks_per_s = TICKS_PER_S,
        .port = "avr",
    };
    eeprom_read_block(hardware.uid, UID_AT, sizeof hardware.uid);
    const hg_port port = {.context = 0, .write = write_line, .save = save, .load = load};
    const enum hg_reset reset = (cause & _BV(WDRF)) != 0   ? HG_RESET_WATCHDOG
                                : (cause & _BV(PORF)) != 0 ? HG_RESET_POWER
                                                           : HG_RESET_RESET;
    hg_beacon_init(&beacon, &hardware, &port, next_boot(), reset, 0);
    start_hardware();
    sei();
    for (;;) {
        wdt_reset();
        while (in_head != in_tail) {
            const uint8_t byte = in_ring[in_head];
            in_head++;
            hg_beacon_receive(&beacon, &byte, 1, now_ms());
        }
        hg_beacon_poll(&beacon, now_ms());
        darken();
    }
}
