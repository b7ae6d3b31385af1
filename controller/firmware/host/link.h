/* The bytes' way to the host: a pseudo-terminal or a TCP socket, never waiting. POSIX. */
#ifndef LINK_H
#define LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    int listening, open; /* file descriptors, -1 for none */
    int kept;            /* the terminal's own end, so that it stays when a host leaves */
    bool terminal;
} port_link;

/* NULL, or one line that says what failed. `name` is what a host opens; its room is LINK_NAME. */
#define LINK_NAME 128
const char *link_open_terminal(port_link *link, char *name);
const char *link_listen(port_link *link, const char *address, char *name); /* HOST:PORT; port 0: any */
void link_close(port_link *link);

/* Wait for bytes, a host or so many milliseconds. */
void link_wait(port_link *link, int milliseconds);

/* What has arrived, at most `room`; 0 for nothing. A host that left is noticed here. */
size_t link_receive(port_link *link, uint8_t *bytes, size_t room);

/* How much of it went out; what nobody takes is lost as on a wire. */
size_t link_send(port_link *link, const uint8_t *bytes, size_t size);

#endif
