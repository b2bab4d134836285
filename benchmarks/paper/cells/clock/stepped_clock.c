/*
 * LD_PRELOAD library: the time of day is the machine's and an offset, which a file has, in nanoseconds.
 *
 * What measures durations stays as it is, as on a machine whose clock is set. libfaketime does much more, and with it
 * Python's time.sleep fails after a step.
 */
#include <dlfcn.h>
#include <err.h>
#include <fcntl.h>
#include <stdint.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define OFFSET "/run/clock/offset"
#define NS_PER_S 1000000000

static int (*machine_clock)(clockid_t, struct timespec *);
static const volatile int64_t *offset_ns;

__attribute__((constructor)) static void begin(void)
{
    int file = open(OFFSET, O_RDONLY | O_CLOEXEC);
    void *mapped = mmap(NULL, sizeof *offset_ns, PROT_READ, MAP_SHARED, file, 0);

    if (mapped == MAP_FAILED)
        err(1, "%s", OFFSET);
    close(file);
    offset_ns = mapped;
    machine_clock = dlsym(RTLD_NEXT, "clock_gettime");
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int64_t ns;

    /* Another library's constructor may ask before ours has run. */
    if (machine_clock == NULL)
        begin();
    if (machine_clock(clock, now) != 0)
        return -1;
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) {
        ns = now->tv_sec * NS_PER_S + now->tv_nsec + *offset_ns;
        now->tv_sec = ns / NS_PER_S;
        now->tv_nsec = ns % NS_PER_S;
    }
    return 0;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec exact;

    (void)zone;
    if (clock_gettime(CLOCK_REALTIME, &exact) != 0)
        return -1;
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now)
{
    struct timespec exact;

    if (clock_gettime(CLOCK_REALTIME, &exact) != 0)
        return -1;
    if (now != NULL)
        *now = exact.tv_sec;
    return exact.tv_sec;
}
