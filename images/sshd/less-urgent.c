/*
 * Starts a program that sshd has for one connection at a lower priority than the one that starts it.
 *
 * sshd_config names it in both programs' places: sshd starts sshd-session so, which starts sshd-auth so for the time
 * until the log-in. When a fleet returns, a hundred of them want a processor. sshd goes first: with one turn among them
 * it could not even refuse who comes next, its queue would overflow, and robots that get no answer at all ask twice a
 * second. Then come the tunnels that are up, as commands for robots that move must not wait for log-ins.
 */
#include <err.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#define PROGRAMS "/usr/lib/openssh"
#define LOWER 10

int main(int argc, char **argv)
{
    const char *name = argc > 0 ? strrchr(argv[0], '/') : NULL;
    char path[64];

    if (name == NULL)
        errx(1, "must be started by its path");
    if (nice(LOWER) == -1)
        warn("nice");
    (void)snprintf(path, sizeof path, PROGRAMS "%s", name);
    execv(path, argv);
    err(1, "%s", path);
}
