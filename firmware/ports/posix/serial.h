/* The line of the virtual beacon: a pseudo-terminal, or one TCP client after another on the loopback. */
#ifndef SERIAL_H
#define SERIAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    int listener; /* -1 for a pseudo-terminal */
    int line;     /* -1 while no client is there */
    int slave;    /* held open, so that a client's leaving is no end of file */
    const char *link;
} serial;

/* Open a pseudo-terminal and make link a symbolic link to it; tell its name on stdout. False: it cannot be. */
bool serial_open_pty(serial *port, const char *link);

/* Listen on a port of 127.0.0.1, 0 for any; tell it on stdout. */
bool serial_open_tcp(serial *port, uint16_t number);

/* Wait for bytes, at most timeout_ms; return how many came. */
size_t serial_read(serial *port, uint8_t *bytes, size_t most, int timeout_ms);

/* As hg_port.write: bytes for a client that is not there are lost, as on any line. */
bool serial_write(void *context, const uint8_t *bytes, size_t n);

void serial_close(serial *port);

#endif
