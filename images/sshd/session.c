/*
 * What a robot's SSH connection runs on the server, and the only thing it can run.
 *
 * It is the login shell of the account `tunnel`, so that no shell stands behind that account at all:
 * sshd starts it as `session -c "/usr/lib/robotether/session ROBOT_ID FINGERPRINT PORTS"`, the forced command of
 * the key. It tells the relay which robot and key this is and which ports this login may listen on, and joins the
 * robot's stdin and stdout to that TCP connection.
 * When either side ends it ends its own sshd, because only that releases the robot's forwarded ports:
 * the next connection of the same robot must find them free.
 *
 * One small C program, not a shell with socat: a server holds three of these for every robot.
 * docs/reference/protocols.md, "The session", says what passes.
 */
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define RELAY_HOST "relay"
#define RELAY_PORT "8091"
#define KEY_FILE "/run/secrets/session_key"
#define FORCED "/usr/lib/robotether/session "
#define FINGERPRINT_CHARACTERS "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+/:"
#define BUFFER_SIZE 16384
/* The session is a few lines a second, which a robot that lives takes at once. */
#define STUCK_SECONDS 8
/* What a robot hears from a relay that ends without a bye: by it, it knows that another cell serves it sooner. */
#define RELAY_LOST "{\"type\": \"bye\", \"code\": \"relay_lost\", \"detail\": \"the relay has ended\"}\n"
#define ENDED (POLLRDHUP | POLLHUP | POLLERR)

/* Who connects, as the forced command says. */
struct robot {
    unsigned long id;
    char fingerprint[64];
    char ports[64];
};

/* One direction of the join; at most one buffer is ever in flight, so a slow reader slows the writer. */
struct flow {
    int from;
    int to;
    size_t start;
    size_t end;
    char data[BUFFER_SIZE];
};

/* Only signals its own parent: 1 would be the container's init, after sshd has already gone. */
static void end_connection(int status)
{
    pid_t parent = getppid();

    if (parent > 1)
        kill(parent, SIGTERM);
    exit(status);
}

static void refuse(const char *sentence)
{
    fprintf(stderr, "robotether: %s\n", sentence);
    end_connection(1);
}

/* Reads one more word, which goes into JSON: nothing but these characters may pass. Returns what follows it. */
static const char *read_word(const char *rest, const char *allowed, char *into, size_t size)
{
    size_t length = *rest == ' ' ? strspn(++rest, allowed) : 0;

    if (length == 0 || length >= size)
        refuse("cannot start the session: the robot's line in authorized_keys is broken");
    memcpy(into, rest, length);
    into[length] = '\0';
    return rest + length;
}

static struct robot forced_robot(int argc, char **argv)
{
    struct robot robot = {0};
    const char *rest;
    char *after_id;

    if (argc != 3 || strcmp(argv[1], "-c") != 0 || strncmp(argv[2], FORCED, strlen(FORCED)) != 0)
        refuse("cannot run that: this account serves robots' tunnels only");
    if (!isdigit((unsigned char)argv[2][strlen(FORCED)]))
        refuse("cannot start the session: the robot's number is missing in authorized_keys");
    robot.id = strtoul(argv[2] + strlen(FORCED), &after_id, 10);
    rest = read_word(after_id, FINGERPRINT_CHARACTERS, robot.fingerprint, sizeof robot.fingerprint);
    rest = read_word(rest, "0123456789,", robot.ports, sizeof robot.ports);
    if (*rest != '\0')
        refuse("cannot start the session: the robot's line in authorized_keys is broken");
    return robot;
}

static const char *wanted_kind(void)
{
    static const char *const kinds[] = {"session", "media", "shell"};
    const char *asked = getenv("SSH_ORIGINAL_COMMAND");
    size_t each;

    for (each = 0; asked != NULL && each < sizeof kinds / sizeof *kinds; each++)
        if (strcmp(asked, kinds[each]) == 0)
            return kinds[each];
    refuse("cannot run that: a robot's key opens 'session', 'media' and 'shell', nothing else");
    return NULL;
}

/* The first word of SSH_CONNECTION, which goes into JSON: nothing but an address may pass. */
static void client_address(char *into, size_t size)
{
    const char *connection = getenv("SSH_CONNECTION");
    size_t used = 0;

    while (connection != NULL && used + 1 < size &&
           (isxdigit((unsigned char)connection[used]) || strchr(".:", connection[used])) &&
           connection[used] != '\0') {
        into[used] = connection[used];
        used++;
    }
    into[used] = '\0';
}

/* The second word of SSH_CONNECTION, by which sshd's log names the connection, too; 0: there is none. */
static unsigned long client_port(void)
{
    const char *connection = getenv("SSH_CONNECTION");
    const char *space = connection == NULL ? NULL : strchr(connection, ' ');

    return space == NULL ? 0 : strtoul(space + 1, NULL, 10);
}

static void session_key(char *into, size_t size)
{
    FILE *file = fopen(KEY_FILE, "re");

    if (file == NULL || fgets(into, (int)size, file) == NULL)
        refuse("cannot start the session: the server's session key is not readable");
    fclose(file);
    into[strcspn(into, "\r\n\"\\")] = '\0';
}

static int connect_relay(void)
{
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM};
    struct addrinfo *found, *each;
    int on = 1, fd = -1;

    if (getaddrinfo(RELAY_HOST, RELAY_PORT, &hints, &found) != 0)
        refuse("cannot reach the relay: its name is not known; the server is starting or broken");
    for (each = found; each != NULL; each = each->ai_next) {
        fd = socket(each->ai_family, each->ai_socktype | SOCK_CLOEXEC, each->ai_protocol);
        if (fd >= 0 && connect(fd, each->ai_addr, each->ai_addrlen) == 0)
            break;
        if (fd >= 0)
            close(fd);
        fd = -1;
    }
    freeaddrinfo(found);
    if (fd < 0)
        refuse("cannot reach the relay: it does not answer; the server is starting or broken");
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return fd;
}

static void write_all(int fd, const char *text, size_t length)
{
    while (length > 0) {
        ssize_t written = write(fd, text, length);
        if (written < 0 && errno == EINTR)
            continue;
        if (written <= 0)
            end_connection(1);
        text += written;
        length -= (size_t)written;
    }
}

static void send_preface(int relay, const struct robot *robot)
{
    char line[512], key[128], address[64];
    int length;

    session_key(key, sizeof key);
    client_address(address, sizeof address);
    length = snprintf(line, sizeof line,
                      "{\"type\": \"preface\", \"kind\": \"%s\", \"robot_id\": %lu, \"fingerprint\": \"%s\", "
                      "\"ports\": [%s], \"address\": \"%s\", \"port\": %lu, \"session_key\": \"%s\"}\n",
                      wanted_kind(), robot->id, robot->fingerprint, robot->ports, address, client_port(), key);
    write_all(relay, line, (size_t)length);
}

/*
 * The relay's last line, its bye, says why it ends the connection. It is in sshd's pipe now; a moment later, when sshd
 * has taken it and sent it on, sshd may go. A robot that reads nothing gets no more than that moment.
 */
static void let_sshd_deliver(void)
{
    int unread, patience;

    for (patience = 20; patience > 0; patience--) {
        if (ioctl(STDOUT_FILENO, FIONREAD, &unread) < 0 || unread == 0)
            break;
        poll(NULL, 0, 10);
    }
    poll(NULL, 0, 20);
}

/* Moves what poll() said can be moved; false when the flow has ended. */
static int pump(struct flow *flow, short from_events, short to_events)
{
    if (flow->end == 0 && (from_events & (POLLIN | POLLHUP | POLLERR))) {
        ssize_t got = read(flow->from, flow->data, BUFFER_SIZE);
        if (got == 0 || (got < 0 && errno != EINTR && errno != EAGAIN))
            return 0;
        if (got > 0) {
            flow->start = 0;
            flow->end = (size_t)got;
            return 1;
        }
    }
    if (flow->end > 0 && (to_events & (POLLOUT | POLLHUP | POLLERR))) {
        ssize_t put = write(flow->to, flow->data + flow->start, flow->end - flow->start);
        if (put < 0 && errno != EINTR && errno != EAGAIN)
            return 0;
        if (put > 0 && (flow->start += (size_t)put) == flow->end)
            flow->start = flow->end = 0;
    }
    return 1;
}

static time_t seconds_now(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec;
}

/*
 * poll() calls a pipe writable that has one page free, and a larger write would then wait for the rest: a robot that
 * reads nothing would stop this program for good.
 */
static void never_wait_in(int fd)
{
    int flags = fcntl(fd, F_GETFL);

    if (flags < 0 || fcntl(fd, F_SETFL, flags | O_NONBLOCK) < 0)
        end_connection(1);
}

static void join(int relay)
{
    static struct flow up, down;
    struct pollfd set[4];
    time_t taken_at = seconds_now();

    never_wait_in(relay);
    never_wait_in(STDOUT_FILENO);
    up.from = STDIN_FILENO, up.to = relay;
    down.from = relay, down.to = STDOUT_FILENO;
    for (;;) {
        /*
         * A flow waits either for input or for room, never for both; -1 takes an entry out. A source that must wait
         * is still watched for its end.
         */
        set[0] = (struct pollfd){.fd = up.from, .events = up.end ? POLLRDHUP : POLLIN};
        set[1] = (struct pollfd){.fd = up.end ? up.to : -1, .events = POLLOUT};
        set[2] = (struct pollfd){.fd = down.from, .events = down.end ? POLLRDHUP : POLLIN};
        set[3] = (struct pollfd){.fd = down.end ? down.to : -1, .events = POLLOUT};
        if (poll(set, 4, down.end ? 1000 : -1) < 0 && errno != EINTR)
            return;
        /*
         * A robot that stops reading must not keep what the relay has ended: the relay's end stands behind the
         * lines that nobody takes, where it cannot be seen.
         */
        if (down.end == 0)
            taken_at = seconds_now();
        else if (seconds_now() - taken_at > STUCK_SECONDS)
            return;
        if (up.end && (set[0].revents & ENDED))
            return;
        /* What the relay said last, its bye, goes on as long as there is room for it. */
        if (down.end && (set[2].revents & ENDED) && !(set[3].revents & POLLOUT))
            return;
        if (!pump(&up, set[0].revents, set[1].revents))
            return;
        if (!pump(&down, set[2].revents, set[3].revents)) {
            /* After a bye of the relay, robots read no more. */
            if (write(STDOUT_FILENO, RELAY_LOST, strlen(RELAY_LOST)) < 0)
                return;
            let_sshd_deliver();
            return;
        }
    }
}

int main(int argc, char **argv)
{
    struct robot robot = forced_robot(argc, argv);
    int relay;

    signal(SIGPIPE, SIG_IGN);
    wanted_kind(); /* refuse before the relay learns of it */
    relay = connect_relay();
    send_preface(relay, &robot);
    join(relay);
    end_connection(0);
}
