/* The LED by the RMT peripheral: one endless transmission that an interrupt keeps fed from the pump.
 *
 * A *symbol* is two levels with their lengths in ticks. A bit is cut into symbols of at most SYMBOL_TICKS, both levels alike:
 * so a symbol never reaches beyond a bit, and where the peripheral cannot stop within one (ESP32) it is dark within
 * 200 us, which is one bit at 5 kbit/s. The peripheral holds a memory full of symbols (64 on the ESP32, 48 on
 * C3 and S3) that the pump was asked for ahead: at most 12.8 ms.
 *
 * One transmission without an end, by an encoder that never says it is done: a transmission a frame would leave gaps of some
 * 16 us, and the peripheral's own loop cannot change its data.
 */
#ifndef RMT_LIGHT_H
#define RMT_LIGHT_H

#include <stdbool.h>
#include <stdint.h>

#include "hg_pump.h"

#define RMT_TICKS_PER_S 10000000u

/* Claim the peripheral for a pin, and the pin is dark; false: it cannot be had. */
bool rmt_light_open(hg_pump *pump, int gpio);

/* Make it as it should be: start or stop the transmission, and set the power (thousandths) of what is on the air. */
bool rmt_light_follow(bool armed);

#endif
