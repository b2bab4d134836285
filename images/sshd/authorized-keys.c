/*
 * AuthorizedKeysCommand of the account `tunnel`: prints the one line that lets an active robot's key in, or nothing.
 *
 * sshd starts it as user `keylookup` for every key that a client offers: authorized-keys USER FINGERPRINT CONNECTION.
 * It must never print a line for a key that the database does not hold; only while the database cannot be reached
 * does a key still work that was good in the last 24 hours, from the cache. The container's entrypoint starts
 * `authorized-keys cache` each minute, which brings the cache in line with the database: a robot whose cell dies together
 * with the database is let in at the next cell, where it has never been. A database that answers with an error
 * (too many connections, a wrong password) lets nobody in: a stranger could bring that about.
 * It ends with 1 when it cannot tell: sshd then lets the key not in either, and says so in its log.
 *
 * One small C program, not a shell with the database's client: a fleet logs in all at once, and the programs that a
 * script starts were two fifths of what a log-in costs.
 */
#include <dirent.h>
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

/* FOUND when the database is there. */
static enum answer find_database(MYSQL *database)
{
    char password[256];

    if (!read_password(password, sizeof password))
        return FAILED;
    mysql_options(database, MYSQL_READ_DEFAULT_FILE, OPTIONS_FILE);
    mysql_options(database, MYSQL_READ_DEFAULT_GROUP, OPTIONS_GROUP);
    if (mysql_real_connect(database, NULL, NULL, password, NULL, 0, NULL, 0) == NULL)
        return failure(database);
    return FOUND;
}

static enum answer find_line(MYSQL *database, const char *fingerprint, char line[LINE_SIZE])
{
    char sql[1024];
    enum answer connected = find_database(database);
    MYSQL_RES *rows;
    MYSQL_ROW row;
    size_t length;

    if (connected != FOUND)
        return connected;
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

/* A database that does not answer, or with an error, leaves the cache as it is. */
static int renew_cache(MYSQL *database)
{
    char path[PATH_SIZE], **fingerprints;
    size_t count = 0;
    MYSQL_RES *rows;
    MYSQL_ROW row;

    if (find_database(database) != FOUND || mysql_query(database, ALL_LINES) != 0 ||
        (rows = mysql_store_result(database)) == NULL)
        return 1;
    fingerprints = calloc(mysql_num_rows(rows) + 1, sizeof *fingerprints);
    if (fingerprints == NULL)
        return 1;
    while ((row = mysql_fetch_row(rows)) != NULL) {
        if (row[0] == NULL || row[1] == NULL || !is_fingerprint(row[0]) ||
            strlen(row[1]) >= LINE_SIZE || row[1][strcspn(row[1], "\r\n")] != '\0')
            continue;
        fingerprints[count++] = row[0];
        path_of(row[0], path);
        write_cached(path, row[1]);
    }
    qsort(fingerprints, count, sizeof *fingerprints, compare);
    forget_others(fingerprints, count);
    free(fingerprints);
    return 0;
}

static int look_up(MYSQL *database, const char *fingerprint, const char *connection)
{
    char cached[PATH_SIZE], line[LINE_SIZE];

    path_of(fingerprint, cached);
    switch (find_line(database, fingerprint, line)) {
    case FOUND:
        write_cached(cached, line);
        break;
    case UNKNOWN:
        unlink(cached);
        record_refused_key(database, fingerprint, connection);
        line[0] = '\0';
        break;
    case UNREACHABLE:
        if (!read_cached(cached, CACHE_SECONDS, line))
            return 1;
        break;
    case FAILED:
        return 1;
    }
    return line[0] != '\0' && (puts(line) < 0 || fflush(stdout) != 0);
}

int main(int argc, char **argv)
{
    int is_for_cache = argc == 2 && strcmp(argv[1], "cache") == 0, status;
    MYSQL *database;

    if (!is_for_cache && (argc != 4 || strcmp(argv[1], "tunnel") != 0 || !is_fingerprint(argv[2])))
        return 0;
    database = mysql_init(NULL);
    if (database == NULL)
        return 1;
    status = is_for_cache ? renew_cache(database) : look_up(database, argv[2], argv[3]);
    mysql_close(database);
    return status;
}
