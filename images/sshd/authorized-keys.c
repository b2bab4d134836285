/*
 * AuthorizedKeysCommand of the account `tunnel`: prints the one line that lets an active robot's key in, or nothing.
 *
 * sshd starts it as user `keylookup` for every key that a client offers: authorized-keys USER FINGERPRINT CONNECTION.
 * It must never print a line for a key that the database does not hold; only while the database cannot be reached
 * does a key that worked in the last 24 hours still work, from the cache. A database that answers with an error
 * (too many connections, a wrong password) lets nobody in: a stranger could bring that about.
 * It ends with 1 when it cannot tell: sshd then lets the key not in either, and says so in its log.
 *
 * One small C program, not a shell with the database's client: a fleet logs in all at once, and the programs that a
 * script starts were two fifths of what a log-in costs.
 */
#include <errmsg.h>
#include <mysql.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define OPTIONS_FILE "/run/robotether/keylookup.cnf"
#define OPTIONS_GROUP "authorized-keys"
#define PASSWORD_FILE "/run/secrets/mysql_keylookup_password"
#define CACHE "/var/cache/robotether/"
#define CACHE_SECONDS (24 * 3600)
/* Written only when it changed or is half a day old, so that a log-in does not wait for a disk. */
#define RENEW_SECONDS (12 * 3600)
#define HASH "SHA256:"
#define HASH_LENGTH 43
#define BASE64 "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+/"
#define ADDRESS_CHARACTERS "0123456789abcdefABCDEF.:"
#define ADDRESS_SIZE 46
#define LINE_SIZE 4096

/* The command gets the ports, too: what a login may listen on stays as it was at the log-in. */
#define LINE_OF_KEY                                                                          \
    "SELECT CONCAT('restrict,port-forwarding,permitlisten=\"*:', ros_port, "                 \
    "'\",permitlisten=\"*:', video_port, "                                                   \
    "IFNULL(CONCAT('\",permitlisten=\"*:', shell_port), ''), "                               \
    "'\",command=\"/usr/lib/robotether/session ', robot_id, ' ', fingerprint, ' ', "         \
    "CONCAT_WS(',', ros_port, video_port, shell_port), '\" ', public_key) "                  \
    "FROM tunnel_keys WHERE fingerprint = '%s'"
#define REFUSED_KEY "CALL record_refused_key('%s', '%s')"

enum answer { FOUND, UNKNOWN, UNREACHABLE, FAILED };

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
    return is_read && into[0] != '\0';
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
        return FAILED;
    }
}

static enum answer find_line(MYSQL *database, const char *fingerprint, char line[LINE_SIZE])
{
    char password[256], sql[1024];
    MYSQL_RES *rows;
    MYSQL_ROW row;
    size_t length;

    if (!read_password(password, sizeof password))
        return FAILED;
    mysql_options(database, MYSQL_READ_DEFAULT_FILE, OPTIONS_FILE);
    mysql_options(database, MYSQL_READ_DEFAULT_GROUP, OPTIONS_GROUP);
    if (mysql_real_connect(database, NULL, NULL, password, NULL, 0, NULL, 0) == NULL)
        return failure(database);
    snprintf(sql, sizeof sql, LINE_OF_KEY, fingerprint);
    if (mysql_query(database, sql) != 0 || (rows = mysql_store_result(database)) == NULL)
        return failure(database);
    row = mysql_fetch_row(rows);
    if (row == NULL)
        return UNKNOWN;
    /* A second line would be a second key. */
    length = row[0] == NULL ? 0 : strcspn(row[0], "\r\n");
    if (length == 0 || length >= LINE_SIZE || length != mysql_fetch_lengths(rows)[0])
        return FAILED;
    memcpy(line, row[0], length + 1);
    return FOUND;
}

/* One audit line at most; without it the key is refused just the same. */
static void record_refused_key(MYSQL *database, const char *fingerprint, const char *connection)
{
    char address[ADDRESS_SIZE], sql[256];

    read_address(connection, address);
    snprintf(sql, sizeof sql, REFUSED_KEY, fingerprint, address);
    mysql_query(database, sql);
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

/* A log-in beside this one may do the same; whatever fails only leaves the cache as it was. */
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

int main(int argc, char **argv)
{
    char cached[sizeof CACHE + HASH_LENGTH], line[LINE_SIZE], *slash;
    MYSQL *database;

    if (argc != 4 || strcmp(argv[1], "tunnel") != 0 || !is_fingerprint(argv[2]))
        return 0;
    snprintf(cached, sizeof cached, "%s%s", CACHE, argv[2] + strlen(HASH));
    for (slash = cached + strlen(CACHE); (slash = strchr(slash, '/')) != NULL;)
        *slash = '_';
    database = mysql_init(NULL);
    if (database == NULL)
        return 1;
    switch (find_line(database, argv[2], line)) {
    case FOUND:
        write_cached(cached, line);
        break;
    case UNKNOWN:
        unlink(cached);
        record_refused_key(database, argv[2], argv[3]);
        line[0] = '\0';
        break;
    case UNREACHABLE:
        if (!read_cached(cached, CACHE_SECONDS, line))
            return 1;
        break;
    case FAILED:
        return 1;
    }
    mysql_close(database);
    return line[0] != '\0' && (puts(line) < 0 || fflush(stdout) != 0);
}
