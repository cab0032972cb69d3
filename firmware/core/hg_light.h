/* What the beacon does to its light: arm, disarm, lease, program, and the frames that the pump is fed with. */
#ifndef HG_LIGHT_H
#define HG_LIGHT_H

#include "hg_beacon.h"

enum hg_event_type { HG_EVENT_BOOT = 0x41, HG_EVENT_DARK = 0x42, HG_EVENT_ON_AIR = 0x43, HG_EVENT_MESSAGE = 0x44 };
enum hg_end { HG_END_SENT = 0, HG_END_CLEARED = 1, HG_END_PROGRAM = 2 };

void hg_light_arm(hg_beacon *beacon, uint32_t lease_ms);
void hg_light_disarm(hg_beacon *beacon);
void hg_light_set(hg_beacon *beacon, const hg_program *program, uint16_t program_id);

/* Drop all messages; return how many. */
uint8_t hg_light_drop(hg_beacon *beacon, enum hg_end why);

/* Feed the pump, follow it, and end the lease. */
void hg_light_poll(hg_beacon *beacon);

/* Say an event as soon as the line has room; where too many wait, the oldest is forgotten. */
void hg_event_say(hg_beacon *beacon, enum hg_event_type type, const uint8_t *payload, uint8_t n);

#endif
