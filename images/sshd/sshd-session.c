/*
 * Starts sshd's own program for one connection at a lower priority than sshd itself.
 *
 * sshd_config names it (SshdSessionPath). When a fleet returns, a hundred such programs want a processor. sshd, which
 * accepts or refuses what comes next, would have one turn among them: its queue overflows, and robots that get no
 * answer at all ask twice a second. All that it starts are equals still: log-ins, tunnels and sessions.
 */
#include <err.h>
#include <unistd.h>

#define PROGRAM "/usr/lib/openssh/sshd-session"
#define NICE 15

int main(int argc, char **argv)
{
    (void)argc;
    if (nice(NICE) == -1)
        warn("nice");
    execv(PROGRAM, argv);
    err(1, "%s", PROGRAM);
}
