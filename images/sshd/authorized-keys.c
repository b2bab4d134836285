/*
 * AuthorizedKeysCommand of the account `tunnel`: prints the one line that lets an active robot's key in, or nothing.
 *
 * sshd starts it as user `keylookup`, twice for every key that a client logs in with:
 * authorized-keys USER FINGERPRINT CONNECTION. It asks key-lookups, which has a connection to the database, and ends
 * with 1 when that cannot tell: sshd then lets the key not in either, and says so in its log.
 * The container's entrypoint starts `authorized-keys cache` each minute, which brings the cache of key-lookups in line
 * with the database.
 *
 * It has no library of the database's: a fleet logs in all at once, and to begin with that library, its TLS and a new
 * connection is much of what a log-in costs.
 */
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "key-lookups.h"

/* A question whose answer does not come was lost with who had it; key-lookups is there again a second later. */
#define ANSWER_SECONDS 4
#define TRY_FOR_SECONDS 12
#define PAUSE_NS 100000000

/* The socket for one question; -1 when nobody can be asked. */
static int connected(void)
{
    struct sockaddr_un there = {.sun_family = AF_UNIX, .sun_path = SOCKET};
    struct sockaddr_un here = {.sun_family = AF_UNIX};
    struct timeval most = {.tv_sec = ANSWER_SECONDS};
    int asking = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);

    if (asking == -1)
        return -1;
    /* Only then it has an address, which the kernel chooses and anybody may read: the answer comes from who is asked. */
    if (connect(asking, (struct sockaddr *)&there, sizeof there) == 0 &&
        bind(asking, (struct sockaddr *)&here, sizeof here.sun_family) == 0 &&
        setsockopt(asking, SOL_SOCKET, SO_SNDTIMEO, &most, sizeof most) == 0 &&
        setsockopt(asking, SOL_SOCKET, SO_RCVTIMEO, &most, sizeof most) == 0)
        return asking;
    close(asking);
    return -1;
}

/* The answer's length; 0 or less when there is none. */
static ssize_t ask_once(const char *question, size_t length, char *answer, size_t size)
{
    ssize_t got = -1;
    int asking = connected();

    if (asking == -1)
        return -1;
    if (send(asking, question, length, MSG_NOSIGNAL) == (ssize_t)length)
        got = recv(asking, answer, size, 0);
    close(asking);
    return got;
}

static ssize_t ask(const char *question, size_t length, char *answer, size_t size)
{
    const struct timespec pause = {.tv_nsec = PAUSE_NS};
    struct timespec began, now;
    ssize_t got;

    clock_gettime(CLOCK_MONOTONIC, &began);
    while ((got = ask_once(question, length, answer, size)) <= 0) {
        clock_gettime(CLOCK_MONOTONIC, &now);
        if (now.tv_sec - began.tv_sec >= TRY_FOR_SECONDS)
            break;
        nanosleep(&pause, NULL);
    }
    return got;
}

int main(int argc, char **argv)
{
    char question[QUESTION_SIZE], answer[1 + LINE_SIZE];
    ssize_t got;
    int length;

    if (argc == 2 && strcmp(argv[1], RENEW_CACHE) == 0)
        length = snprintf(question, sizeof question, "%s", RENEW_CACHE);
    else if (argc == 4 && strcmp(argv[1], "tunnel") == 0)
        length = snprintf(question, sizeof question, "%s%c%s", argv[2], '\0', argv[3]);
    else
        return 0;
    /* No key's fingerprint is so long. */
    if (length < 0 || (size_t)length >= sizeof question)
        return 0;
    got = ask(question, (size_t)length + 1, answer, sizeof answer);
    if (got == 1 && (answer[0] == KEEP_OUT || answer[0] == RENEWED))
        return 0;
    if (got <= 1 || answer[0] != LET_IN || answer[got - 1] != '\0')
        return 1;
    return puts(answer + 1) < 0 || fflush(stdout) != 0;
}
