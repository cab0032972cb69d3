#include "hg_store.h"

#include "hg_bytes.h"
#include "hg_check.h"

#define HEAD 4u
#define LAYOUT 1u

bool hg_store_save(const hg_port *port, const hg_program *program)
{
    uint8_t bytes[HG_STORE_MOST] = {'H', 'B', LAYOUT, 0};
    const size_t n = hg_program_write(bytes + HEAD, program);
    bytes[3] = (uint8_t)n;
    hg_put16(bytes + HEAD + n, hg_crc16(bytes, HEAD + n));
    return port->save(port->context, bytes, HEAD + n + HG_CRC_BYTES);
}

bool hg_store_load(const hg_port *port, const hg_hardware *hardware, hg_program *program)
{
    uint8_t bytes[HG_STORE_MOST];
    const size_t length = port->load(port->context, bytes);
    if (length < HEAD + HG_CRC_BYTES || length > HG_STORE_MOST || bytes[0] != 'H' || bytes[1] != 'B'
        || bytes[2] != LAYOUT || length < HEAD + (size_t)bytes[3] + HG_CRC_BYTES) {
        return false;
    }
    const size_t n = bytes[3];
    return hg_crc16(bytes, HEAD + n) == hg_get16(bytes + HEAD + n)
           && hg_program_read(program, hardware, bytes + HEAD, n).result == HG_OK;
}
