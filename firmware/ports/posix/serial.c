#define _XOPEN_SOURCE 700

#include "serial.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

static bool make_raw(int fd)
{
    struct termios settings;
    if (tcgetattr(fd, &settings) != 0) {
        return false;
    }
    settings.c_iflag = 0;
    settings.c_oflag = 0;
    settings.c_lflag = 0;
    settings.c_cflag = (settings.c_cflag & ~(tcflag_t)(CSIZE | PARENB | CSTOPB)) | CS8 | CREAD | CLOCAL;
    settings.c_cc[VMIN] = 1;
    settings.c_cc[VTIME] = 0;
    return tcsetattr(fd, TCSANOW, &settings) == 0;
}

static bool unblocked(int fd)
{
    const int flags = fcntl(fd, F_GETFL);
    return flags != -1 && fcntl(fd, F_SETFL, flags | O_NONBLOCK) == 0;
}

bool serial_open_pty(serial *port, const char *link)
{
    *port = (serial){.listener = -1, .line = posix_openpt(O_RDWR | O_NOCTTY), .slave = -1, .link = link};
    if (port->line < 0 || grantpt(port->line) != 0 || unlockpt(port->line) != 0) {
        return false;
    }
    const char *const name = ptsname(port->line);
    if (name == 0) {
        return false;
    }
    port->slave = open(name, O_RDWR | O_NOCTTY);
    if (port->slave < 0 || !make_raw(port->slave) || !unblocked(port->line)) {
        return false;
    }
    (void)unlink(link);
    if (symlink(name, link) != 0) {
        return false;
    }
    printf("ready pty %s\n", name);
    return fflush(stdout) == 0;
}

bool serial_open_tcp(serial *port, uint16_t number)
{
    *port = (serial){.listener = socket(AF_INET, SOCK_STREAM, 0), .line = -1, .slave = -1, .link = 0};
    const int yes = 1;
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(number)};
    socklen_t length = sizeof address;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (port->listener < 0 || setsockopt(port->listener, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0
        || bind(port->listener, (const struct sockaddr *)&address, length) != 0 || listen(port->listener, 1) != 0
        || getsockname(port->listener, (struct sockaddr *)&address, &length) != 0 || !unblocked(port->listener)) {
        return false;
    }
    printf("ready tcp %u\n", (unsigned)ntohs(address.sin_port));
    return fflush(stdout) == 0;
}

static void welcome(serial *port)
{
    const int yes = 1;
    const int client = accept(port->listener, 0, 0);
    if (client < 0) {
        return;
    }
    (void)setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    (void)unblocked(client);
    port->line = client;
}

size_t serial_read(serial *port, uint8_t *bytes, size_t most, int timeout_ms)
{
    const bool waiting = port->line < 0;
    struct pollfd wanted = {.fd = waiting ? port->listener : port->line, .events = POLLIN};
    if (poll(&wanted, 1, timeout_ms) <= 0) {
        return 0;
    }
    if (waiting) {
        welcome(port);
        return 0;
    }
    const ssize_t n = read(port->line, bytes, most);
    if (n > 0) {
        return (size_t)n;
    }
    const bool later = n < 0 && (errno == EAGAIN || errno == EINTR || errno == EIO);
    if (port->listener >= 0 && !later) {
        (void)close(port->line);
        port->line = -1;
    }
    return 0;
}

bool serial_write(void *context, const uint8_t *bytes, size_t n)
{
    serial *const port = context;
    if (port->line < 0) {
        return true;
    }
    if (port->listener >= 0) {
        (void)send(port->line, bytes, n, MSG_NOSIGNAL);
        return true;
    }
    (void)!write(port->line, bytes, n);
    return true;
}

void serial_close(serial *port)
{
    if (port->link != 0) {
        (void)unlink(port->link);
    }
    const int all[3] = {port->listener, port->line, port->slave};
    for (int i = 0; i < 3; i++) {
        if (all[i] >= 0) {
            (void)close(all[i]);
        }
    }
}
