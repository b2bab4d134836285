/*
 * Answers authorized-keys: the one line that lets an active robot's key in, or that there is none.
 *
 * entrypoint.sh starts it as user `keylookup`, and again whenever it ends; the health check looks at the file that it
 * touches. It must never answer with a line for a key that the database does not hold; only while the database cannot
 * be reached does a key still work that was good in the last 24 hours, from the cache. `authorized-keys cache` brings
 * the cache in line with the database: a robot whose cell dies together with the database is let in at the next cell,
 * where it has never been. A database that answers with an error (too many connections, a wrong password) lets nobody
 * in: a stranger could bring that about.
 *
 * Each of its processes answers one question after the other, by a connection to the database that it keeps. While the
 * database answers, nothing is remembered: a key that was revoked is refused at once.
 */
#include <dirent.h>
#include <err.h>
#include <errmsg.h>
#include <fcntl.h>
#include <mysql.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "key-lookups.h"

#define ALIVE "/run/robotether/key-lookups/alive"
#define ALIVE_EVERY_SECONDS 5
#define OPTIONS_FILE "/run/robotether/keylookup.cnf"
#define OPTIONS_GROUP "key-lookups"
#define PASSWORD_FILE "/run/secrets/mysql_keylookup_password"
/* As connect-timeout in keylookup.cnf, where the library finds none for reads and writes. */
#define DATABASE_SECONDS 2
/* The database may be far away: one process would answer one question each round trip. */
#define PROCESSES 4
#define CACHE "/var/cache/robotether/"
#define CACHE_SECONDS (24 * 3600)
/* Written only when it changed or is half a day old, so that a log-in does not wait for a disk. */
#define RENEW_SECONDS (12 * 3600)
#define HASH "SHA256:"
#define HASH_LENGTH 43
#define BASE64 "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+/"
#define ADDRESS_CHARACTERS "0123456789abcdefABCDEF.:"
#define ADDRESS_SIZE 46
#define PATH_SIZE (sizeof CACHE + HASH_LENGTH)

/* The command gets the ports, too: what a login may listen on stays as it was at the log-in. */
#define LINE                                                                                 \
    "CONCAT('restrict,port-forwarding,permitlisten=\"*:', ros_port, "                 \
    "'\",permitlisten=\"*:', video_port, "                                                   \
    "IFNULL(CONCAT('\",permitlisten=\"*:', shell_port), ''), "                               \
    "'\",command=\"/usr/lib/robotether/session ', robot_id, ' ', fingerprint, ' ', "         \
    "CONCAT_WS(',', ros_port, video_port, shell_port), '\" ', public_key)"
#define LINE_OF_KEY "SELECT " LINE " FROM tunnel_keys WHERE fingerprint = '%s'"
#define ALL_LINES "SELECT fingerprint, " LINE " FROM tunnel_keys"
#define REFUSED_KEY "CALL record_refused_key('%s', '%s')"

enum answer { FOUND, UNKNOWN, UNREACHABLE, FAILED };

/* The database's connection, if there is one, and until when it is not asked for another. */
struct lookups {
    MYSQL *database;
    double away_until;
};

/* Nothing but base64 may reach an SQL statement or a file's name. */
static int is_fingerprint(const char *text)
{
    size_t prefix = strlen(HASH);

    return strncmp(text, HASH, prefix) == 0 && strlen(text) == prefix + HASH_LENGTH &&
           strspn(text + prefix, BASE64) == HASH_LENGTH;
}

/* The first word of the connection, when it is an address; it goes into an SQL statement. */
static void read_address(const char *connection, char into[ADDRESS_SIZE])
{
    size_t length = strspn(connection, ADDRESS_CHARACTERS);

    if (length >= ADDRESS_SIZE || (connection[length] != ' ' && connection[length] != '\0'))
        length = 0;
    memcpy(into, connection, length);
    into[length] = '\0';
}

static int read_password(char *into, int size)
{
    FILE *file = fopen(PASSWORD_FILE, "re");
    int is_read = file != NULL && fgets(into, size, file) != NULL;

    if (file != NULL)
        fclose(file);
    if (is_read)
        into[strcspn(into, "\r\n")] = '\0';
    if (is_read && into[0] != '\0')
        return 1;
    warnx("%s has no password that can be read", PASSWORD_FILE);
    return 0;
}

/* The client library's own errors: no socket, no host, no such name, gone, lost, no TLS with whom we trust. Who can bring
 * the last about can also keep all packets away. */
static enum answer failure(MYSQL *database)
{
    switch (mysql_errno(database)) {
    case CR_CONNECTION_ERROR:
    case CR_CONN_HOST_ERROR:
    case CR_UNKNOWN_HOST:
    case CR_SERVER_GONE_ERROR:
    case CR_SERVER_LOST:
    case CR_SSL_CONNECTION_ERROR:
        return UNREACHABLE;
    default:
        warnx("%s", mysql_error(database));
        return FAILED;
    }
}

static double seconds_now(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

static void drop_database(struct lookups *lookups)
{
    mysql_close(lookups->database);
    lookups->database = NULL;
}

/* FOUND when the database is there. */
static enum answer find_database(struct lookups *lookups)
{
    const unsigned int most = DATABASE_SECONDS;
    char password[256];
    enum answer answer;

    if (lookups->database != NULL)
        return FOUND;
    if (seconds_now() < lookups->away_until)
        return UNREACHABLE;
    if (!read_password(password, sizeof password) || (lookups->database = mysql_init(NULL)) == NULL)
        return FAILED;
    mysql_options(lookups->database, MYSQL_READ_DEFAULT_FILE, OPTIONS_FILE);
    mysql_options(lookups->database, MYSQL_READ_DEFAULT_GROUP, OPTIONS_GROUP);
    mysql_options(lookups->database, MYSQL_OPT_READ_TIMEOUT, &most);
    mysql_options(lookups->database, MYSQL_OPT_WRITE_TIMEOUT, &most);
    if (mysql_real_connect(lookups->database, NULL, NULL, password, NULL, 0, NULL, 0) != NULL)
        return FOUND;
    answer = failure(lookups->database);
    drop_database(lookups);
    return answer;
}

/* Rows are NULL for a statement that has none. */
static enum answer ask_once(struct lookups *lookups, const char *sql, MYSQL_RES **rows)
{
    enum answer answer = find_database(lookups);

    *rows = NULL;
    if (answer != FOUND)
        return answer;
    if (mysql_query(lookups->database, sql) == 0 &&
        ((*rows = mysql_store_result(lookups->database)) != NULL ||
         mysql_field_count(lookups->database) == 0)) {
        /* A procedure has one result more. */
        while (mysql_next_result(lookups->database) == 0)
            mysql_free_result(mysql_store_result(lookups->database));
        return FOUND;
    }
    answer = failure(lookups->database);
    drop_database(lookups);
    return answer;
}

static enum answer ask(struct lookups *lookups, const char *sql, MYSQL_RES **rows)
{
    int is_kept = lookups->database != NULL;
    double began = seconds_now(), ended;
    enum answer answer = ask_once(lookups, sql, rows);

    /* The connection was kept, and the database has ended it since, as in a restart. */
    if (is_kept && answer != FOUND && seconds_now() - began < DATABASE_SECONDS)
        answer = ask_once(lookups, sql, rows);
    /* A database that answers nothing keeps others waiting for half of the time at most. */
    ended = seconds_now();
    if (answer == UNREACHABLE && ended >= lookups->away_until)
        lookups->away_until = ended + (ended - began);
    return answer;
}

static enum answer find_line(struct lookups *lookups, const char *fingerprint, char line[LINE_SIZE])
{
    char sql[1024];
    MYSQL_RES *rows;
    MYSQL_ROW row;
    size_t length;
    enum answer answer;

    snprintf(sql, sizeof sql, LINE_OF_KEY, fingerprint);
    answer = ask(lookups, sql, &rows);
    if (answer != FOUND)
        return answer;
    if (rows == NULL)
        return FAILED;
    row = mysql_fetch_row(rows);
    if (row == NULL) {
        answer = UNKNOWN;
    } else {
        /* A second line would be a second key. */
        length = row[0] == NULL ? 0 : strcspn(row[0], "\r\n");
        if (length == 0 || length >= LINE_SIZE || length != mysql_fetch_lengths(rows)[0]) {
            warnx("the database's line for %s is none", fingerprint);
            answer = FAILED;
        } else
            memcpy(line, row[0], length + 1);
    }
    mysql_free_result(rows);
    return answer;
}

/* One audit line at most. What it takes is no other's matter: it says nothing of whether the database answers. */
static void record_refused_key(struct lookups *lookups, const char *fingerprint, const char *connection)
{
    char address[ADDRESS_SIZE], sql[256];
    MYSQL_RES *rows;

    read_address(connection, address);
    snprintf(sql, sizeof sql, REFUSED_KEY, fingerprint, address);
    if (ask_once(lookups, sql, &rows) == FOUND)
        mysql_free_result(rows);
}

/* Reads the line of a file that is at most so many seconds old. */
static int read_cached(const char *path, time_t seconds, char line[LINE_SIZE])
{
    FILE *file = fopen(path, "re");
    struct stat found;
    int is_read;

    if (file == NULL)
        return 0;
    is_read = fstat(fileno(file), &found) == 0 && time(NULL) - found.st_mtime < seconds &&
              fgets(line, LINE_SIZE, file) != NULL;
    fclose(file);
    if (is_read)
        line[strcspn(line, "\n")] = '\0';
    return is_read;
}

/* Another process may do the same; whatever fails only leaves the cache as it was. */
static void write_cached(const char *path, const char *line)
{
    char known[LINE_SIZE], written[128];
    FILE *file;
    int is_whole;

    if (read_cached(path, RENEW_SECONDS, known) && strcmp(known, line) == 0)
        return;
    snprintf(written, sizeof written, "%s.%d", path, (int)getpid());
    file = fopen(written, "we");
    if (file == NULL)
        return;
    is_whole = fprintf(file, "%s\n", line) > 0;
    if (fclose(file) != 0 || !is_whole || rename(written, path) != 0)
        unlink(written);
}

/* A fingerprint has no '_', and no file's name has a '/'. */
static void path_of(const char *fingerprint, char path[PATH_SIZE])
{
    char *slash;

    snprintf(path, PATH_SIZE, "%s%s", CACHE, fingerprint + strlen(HASH));
    for (slash = path + strlen(CACHE); (slash = strchr(slash, '/')) != NULL;)
        *slash = '_';
}

static int compare(const void *one, const void *other)
{
    return strcmp(*(char *const *)one, *(char *const *)other);
}

/* Removes what the database no longer has; a key that came in meanwhile is there again at the next turn. */
static void forget_others(char **fingerprints, size_t count)
{
    char fingerprint[sizeof HASH + HASH_LENGTH], path[PATH_SIZE], *wanted = fingerprint, *line;
    DIR *folder = opendir(CACHE);
    struct dirent *entry;

    while (folder != NULL && (entry = readdir(folder)) != NULL) {
        if (strlen(entry->d_name) != HASH_LENGTH)
            continue;
        snprintf(fingerprint, sizeof fingerprint, "%s%.*s", HASH, HASH_LENGTH, entry->d_name);
        for (line = fingerprint; (line = strchr(line, '_')) != NULL;)
            *line = '/';
        if (bsearch(&wanted, fingerprints, count, sizeof *fingerprints, compare) != NULL)
            continue;
        path_of(fingerprint, path);
        unlink(path);
    }
    if (folder != NULL)
        closedir(folder);
}

/* Whether it could be done; a database that does not answer, or with an error, leaves the cache as it is. */
static int renew_cache(struct lookups *lookups)
{
    char path[PATH_SIZE], **fingerprints;
    size_t count = 0;
    MYSQL_RES *rows;
    MYSQL_ROW row;

    if (ask(lookups, ALL_LINES, &rows) != FOUND || rows == NULL)
        return 0;
    fingerprints = calloc(mysql_num_rows(rows) + 1, sizeof *fingerprints);
    while (fingerprints != NULL && (row = mysql_fetch_row(rows)) != NULL) {
        if (row[0] == NULL || row[1] == NULL || !is_fingerprint(row[0]) ||
            strlen(row[1]) >= LINE_SIZE || row[1][strcspn(row[1], "\r\n")] != '\0')
            continue;
        fingerprints[count++] = row[0];
        path_of(row[0], path);
        write_cached(path, row[1]);
    }
    if (fingerprints != NULL) {
        qsort(fingerprints, count, sizeof *fingerprints, compare);
        forget_others(fingerprints, count);
    }
    mysql_free_result(rows);
    free(fingerprints);
    return fingerprints != NULL;
}

/* The first letter of the answer; with LET_IN there is a line. */
static char look_up(struct lookups *lookups, const char *fingerprint, char line[LINE_SIZE])
{
    char cached[PATH_SIZE];

    if (!is_fingerprint(fingerprint))
        return KEEP_OUT;
    path_of(fingerprint, cached);
    switch (find_line(lookups, fingerprint, line)) {
    case FOUND:
        write_cached(cached, line);
        return LET_IN;
    case UNKNOWN:
        unlink(cached);
        return KEEP_OUT;
    case UNREACHABLE:
        return read_cached(cached, CACHE_SECONDS, line) && line[0] != '\0' ? LET_IN : CANNOT_TELL;
    default:
        return CANNOT_TELL;
    }
}

/* Answers one question, or waits for none for a while; a client that is gone needs no answer. */
static void serve(struct lookups *lookups, int listener)
{
    char question[QUESTION_SIZE], answer[1 + LINE_SIZE];
    const char *connection = NULL;
    struct sockaddr_un client;
    socklen_t size = sizeof client;
    ssize_t got = recvfrom(listener, question, sizeof question, 0, (struct sockaddr *)&client, &size);
    size_t length = 1;

    if (got <= 0 || question[got - 1] != '\0')
        return;
    if (strcmp(question, RENEW_CACHE) == 0) {
        answer[0] = renew_cache(lookups) ? RENEWED : CANNOT_TELL;
    } else {
        connection = question + strlen(question) + 1;
        if (connection >= question + got)
            return;
        answer[0] = look_up(lookups, question, answer + 1);
    }
    if (answer[0] == LET_IN)
        length += strlen(answer + 1) + 1;
    sendto(listener, answer, length, MSG_NOSIGNAL | MSG_DONTWAIT, (struct sockaddr *)&client, size);
    if (answer[0] == KEEP_OUT && is_fingerprint(question))
        record_refused_key(lookups, question, connection);
}

static int listen_at_socket(void)
{
    struct sockaddr_un here = {.sun_family = AF_UNIX, .sun_path = SOCKET};
    struct timeval most = {.tv_sec = ALIVE_EVERY_SECONDS};
    int listener = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);

    umask(077);
    /* One that ended before left its own. */
    unlink(SOCKET);
    if (listener == -1 || setsockopt(listener, SOL_SOCKET, SO_RCVTIMEO, &most, sizeof most) != 0 ||
        bind(listener, (struct sockaddr *)&here, sizeof here) != 0)
        err(1, "%s", SOCKET);
    return listener;
}

static void serve_for_ever(int listener)
{
    struct lookups lookups = {0};
    int alive = open(ALIVE, O_WRONLY | O_CREAT | O_CLOEXEC, 0600);

    if (alive == -1)
        err(1, "%s", ALIVE);
    for (;;) {
        futimens(alive, NULL);
        serve(&lookups, listener);
    }
}

int main(void)
{
    int listener = listen_at_socket(), count;

    signal(SIGPIPE, SIG_IGN);
    for (count = 0; count < PROCESSES; count++) {
        switch (fork()) {
        case -1:
            err(1, "fork");
        case 0:
            prctl(PR_SET_PDEATHSIG, SIGKILL);
            serve_for_ever(listener);
        }
    }
    /* They end with this one, and all are started again. */
    wait(NULL);
    errx(1, "one of its processes has ended");
}
