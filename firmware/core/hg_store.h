/* The saved program, as the port keeps it:   "HB"  1  n  record of n bytes (PROTOCOL.md, SET)  CRC-16 of all before it
 * What does not read back so, or holds what this hardware cannot send, is no program. */
#ifndef HG_STORE_H
#define HG_STORE_H

#include "hg_beacon.h"

bool hg_store_save(const hg_port *port, const hg_program *program);
bool hg_store_load(const hg_port *port, const hg_hardware *hardware, hg_program *program);

#endif
