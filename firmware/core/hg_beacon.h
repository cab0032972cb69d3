/* The beacon: bytes from the line in; replies, events and light out. PROTOCOL.md is its contract.
 *
 *            SET, SAVE, QUEUE ...                     ARM
 *   boot --> dark <-----------------------------------> lit       dark always after a boot
 *                 DISARM, end of the lease (two clocks)
 *
 * The port calls hg_beacon_receive with what came on the line, and hg_beacon_poll often: at least once a frame of light
 * (2.2 ms for a character of `uart` at 5 kbit/s). Its interrupt calls hg_pump_next(&beacon->pump). Time comes in as milliseconds
 * that wrap; everything but the pump runs in one thread.
 */
#ifndef HG_BEACON_H
#define HG_BEACON_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hg_limits.h"
#include "hg_line.h"
#include "hg_program.h"
#include "hg_pump.h"
#include "hg_source.h"

enum hg_reset { HG_RESET_POWER = 0, HG_RESET_RESET = 1, HG_RESET_WATCHDOG = 2, HG_RESET_UNKNOWN = 3 };

/* What the port lends. */
typedef struct {
    void *context;
    /* Put bytes on the line; where it has no room for all of them: none, and false. The reply is asked for again. */
    bool (*write)(void *context, const uint8_t *bytes, size_t n);
    /* Keep n bytes, at most HG_STORE_MOST; false: it failed. Never called without HG_CAN_SAVE. */
    bool (*save)(void *context, const uint8_t *bytes, size_t n);
    /* Fetch what was kept, at most HG_STORE_MOST bytes; 0: nothing. */
    size_t (*load)(void *context, uint8_t *bytes);
} hg_port;

typedef struct {
    uint8_t type;
    uint8_t n;
    uint8_t payload[9];
} hg_event;

/* The request that was carried out last, and its reply. */
typedef struct {
    bool any;
    uint16_t seq, crc;
    uint8_t length;
    uint8_t type;
    uint8_t n; /* bytes of the reply's payload */
    uint8_t payload[HG_REPLY_MOST];
} hg_answered;

typedef struct {
    hg_hardware hardware;
    hg_port port;
    uint16_t boot;
    uint32_t now_ms;
    uint32_t boot_ms;
    hg_line line;
    hg_answered answered;
    uint8_t body[HG_BODY_MOST];
    uint8_t wire[HG_WIRE_MOST];

    hg_event events[HG_EVENTS_MOST];
    uint8_t events_head, events_tail;
    uint16_t events_seq;
    hg_event boot_event;
    bool greeted; /* a valid request came: BOOT need not be said again */
    uint32_t boot_said_ms;

    hg_pump pump;
    hg_source source;
    hg_origin origins[2]; /* of the pump's frames */
    bool armed;
    bool to_light; /* armed, and the pump is still to be given its frames */
    uint32_t lease_end_ms;
    bool renew; /* a lease is still to be handed to the pump */
    uint16_t program_id;
    uint16_t on_air_id;
    bool waiting; /* the pump's other frame was ready when we last looked */
    bool saved;

    uint16_t message_ended;
    uint32_t messages_sent, messages_dropped, refused, replays, late;
    uint8_t late_seen;
} hg_beacon;

/* Boot: dark, with the saved program if there is one. boot: a number unlike the last boots', not 0. */
void hg_beacon_init(hg_beacon *beacon, const hg_hardware *hardware, const hg_port *port, uint16_t boot,
                    enum hg_reset reason, uint32_t now_ms);

/* Take n bytes from the line. */
void hg_beacon_receive(hg_beacon *beacon, const uint8_t *bytes, size_t n, uint32_t now_ms);

/* Do what time and the pump ask for. */
void hg_beacon_poll(hg_beacon *beacon, uint32_t now_ms);

/* Whether there should be light: for ports that start and stop their timer. */
bool hg_beacon_is_armed(const hg_beacon *beacon);

#endif
