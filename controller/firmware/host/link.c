#define _XOPEN_SOURCE 700

#include "link.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

static void never_wait(int descriptor)
{
    fcntl(descriptor, F_SETFL, fcntl(descriptor, F_GETFL, 0) | O_NONBLOCK);
}

const char *link_open_terminal(port_link *link, char *name)
{
    struct termios raw;

    link->listening = link->kept = -1;
    link->terminal = true;
    link->open = posix_openpt(O_RDWR | O_NOCTTY);
    if (link->open < 0 || grantpt(link->open) != 0 || unlockpt(link->open) != 0 || ptsname(link->open) == NULL)
        return "there is none to be had: use --listen HOST:PORT";
    snprintf(name, LINK_NAME, "%s", ptsname(link->open));
    link->kept = open(name, O_RDWR | O_NOCTTY);
    if (link->kept < 0 || tcgetattr(link->kept, &raw) != 0)
        return "it cannot be opened: use --listen HOST:PORT";
    raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
    raw.c_cflag = (raw.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8 | CREAD | CLOCAL;
    raw.c_cc[VMIN] = 1;
    raw.c_cc[VTIME] = 0;
    tcsetattr(link->kept, TCSANOW, &raw);
    never_wait(link->open);
    return NULL;
}

const char *link_listen(port_link *link, const char *address, char *name)
{
    const char *colon = strrchr(address, ':');
    struct addrinfo wanted, *found = NULL;
    struct sockaddr_in bound;
    socklen_t size = sizeof bound;
    char host[LINK_NAME - 32];
    const int yes = 1;
    char *rest;

    link->open = link->kept = link->listening = -1;
    link->terminal = false;
    if (colon == NULL || colon[1] == '\0' || (size_t)(colon - address) >= sizeof host ||
        strtoul(colon + 1, &rest, 10) > 65535 || *rest != '\0')
        return "must be HOST:PORT";
    memcpy(host, address, (size_t)(colon - address));
    host[colon - address] = '\0';
    memset(&wanted, 0, sizeof wanted);
    wanted.ai_family = AF_INET;
    wanted.ai_socktype = SOCK_STREAM;
    wanted.ai_flags = AI_PASSIVE;
    if (getaddrinfo(host[0] != '\0' ? host : NULL, colon + 1, &wanted, &found) != 0)
        return "no such address: name this machine, such as localhost";
    link->listening = socket(found->ai_family, found->ai_socktype, found->ai_protocol);
    setsockopt(link->listening, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    if (link->listening < 0 || bind(link->listening, found->ai_addr, found->ai_addrlen) != 0 ||
        listen(link->listening, 1) != 0 || getsockname(link->listening, (struct sockaddr *)&bound, &size) != 0) {
        freeaddrinfo(found);
        return "in use, or not an address of this machine: choose another port";
    }
    freeaddrinfo(found);
    never_wait(link->listening);
    snprintf(name, LINK_NAME, "socket://%s:%d", host[0] != '\0' ? host : "localhost", ntohs(bound.sin_port));
    return NULL;
}

static void drop(port_link *link)
{
    close(link->open);
    link->open = -1;
}

void link_close(port_link *link)
{
    const int all[] = {link->open, link->kept, link->listening};
    size_t j;

    for (j = 0; j < 3; j++) {
        if (all[j] >= 0)
            close(all[j]);
    }
}

void link_wait(port_link *link, int milliseconds)
{
    /* One host at a time: another one waits until this one has gone. */
    struct pollfd watched = {link->open >= 0 ? link->open : link->listening, POLLIN, 0};
    const int yes = 1;

    if (poll(&watched, 1, milliseconds) <= 0 || link->open >= 0)
        return;
    link->open = accept(link->listening, NULL, NULL);
    if (link->open >= 0) {
        never_wait(link->open);
        setsockopt(link->open, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    }
}

size_t link_receive(port_link *link, uint8_t *bytes, size_t room)
{
    const ssize_t size = link->open >= 0 ? read(link->open, bytes, room) : -1;

    if (size > 0)
        return (size_t)size;
    if (link->open >= 0 && !link->terminal && (size == 0 || (errno != EAGAIN && errno != EINTR)))
        drop(link);
    return 0;
}

size_t link_send(port_link *link, const uint8_t *bytes, size_t size)
{
    ssize_t sent;

    if (link->open < 0)
        return size;
    sent = link->terminal ? write(link->open, bytes, size) : send(link->open, bytes, size, MSG_NOSIGNAL);
    if (sent >= 0)
        return (size_t)sent;
    if (!link->terminal && errno != EAGAIN && errno != EINTR)
        drop(link);
    return 0;
}
