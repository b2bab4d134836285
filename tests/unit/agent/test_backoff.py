"""When a connection is tried again."""

import errno
from random import Random

import pytest
from robotether_agent.backoff import (
    FAILED_START_S,
    STABLE_S,
    USED_TRIES,
    Backoff,
    before_restart,
    delays,
    keep_going,
    retry_or_give_up,
)
from robotether_agent.problems import (
    LinkLostError,
    NetworkChangedError,
    NoAnswerError,
    NotEnrolledError,
    Retry,
    ServerBusyError,
    ServerSilentError,
    SessionEndedError,
    TlsUntrustedError,
)


class Longest(Random):
    def uniform(self, a, b):
        return b


@pytest.mark.parametrize(
    ("problem", "low", "high"),
    [
        (LinkLostError("x"), 0.5, 1),
        (NoAnswerError("x"), 0, 0.2),
        (NetworkChangedError("x"), 0, 0.2),
        (ServerSilentError("x", retry=Retry.AT_ONCE), 0, 0.2),
        (NotEnrolledError("x"), 5, 15),
        (TlsUntrustedError("x"), 15, 30),
    ],
)
def test_each_problem_has_its_pause(problem, low, high):
    rng = Random(1)
    waits = [retry_or_give_up(problem, delays(rng), rng) for _ in range(100)]
    assert all(low <= wait <= high for wait in waits)


LOST, MOVED = LinkLostError("x"), NetworkChangedError("x")
BUSY, SILENT = ServerBusyError("x"), ServerSilentError("x")
SENT_AWAY = SessionEndedError("x", code="cell_draining", retry=Retry.AT_ONCE)


@pytest.mark.parametrize(
    ("ends", "pauses_s"),
    [
        # They grow while none comes up, and are short again after one that stood.
        ([(LOST, 0)] * 4 + [(LOST, STABLE_S)], [1, 2, 4, 8, 1]),
        # Who has waited for one machine of a server does not wait longer for the next.
        ([(LOST, 0)] * 4 + [(LOST, 1)] * 2 + [(LOST, 0)], [1, 2, 4, 8, 2, 2, 4]),
        # It has room as soon as one log-in ends.
        ([(BUSY, 0)] * 5, [1, 2, 4, 4, 4]),
        # Silence on a connection that stood is the network's; a login that stalls is not.
        ([(SILENT, STABLE_S)] + [(SILENT, 0)] * 3, [0.7, 1, 2, 4]),
        ([(MOVED, STABLE_S), (MOVED, 1)], [0, 0.2]),
        # Machines that are all taken out of service are not logged in at all the time.
        ([(SENT_AWAY, STABLE_S)] + [(SENT_AWAY, 1)] * 3, [0.2, 1, 2, 4]),
    ],
)
def test_pauses_depend_on_how_long_connections_stood(ends, pauses_s):
    backoff = Backoff(Longest())
    assert [backoff.after(problem, uptime_s=uptime_s) for problem, uptime_s in ends] == pauses_s


def test_a_robot_that_somebody_used_goes_before_the_others():
    backoff = Backoff(Longest())
    assert backoff.after(LinkLostError("x"), uptime_s=STABLE_S, was_used=True) == 0.2
    first = [backoff.after(ServerBusyError("x"), uptime_s=0) for _ in range(USED_TRIES - 1)]
    assert {*first, backoff.after(LinkLostError("x"), uptime_s=1)} == {0.6}
    assert backoff.after(LinkLostError("x"), uptime_s=0) == 2
    superseded = SessionEndedError("x", code="superseded", retry=Retry.SLOWLY)
    assert backoff.after(superseded, uptime_s=STABLE_S, was_used=True) == 30
    assert backoff.after(LinkLostError("x"), uptime_s=STABLE_S) == 1


def test_agent_that_fails_at_its_start_pauses_and_one_that_ran_does_not():
    low, high = FAILED_START_S
    assert low <= before_restart(0.1, Random()) <= high
    assert before_restart(STABLE_S - 0.1, Longest()) == high
    assert before_restart(STABLE_S, Longest()) == 0


async def test_a_machine_without_file_descriptors_ends_an_attempt_and_no_agent():
    ends = iter([OSError(errno.EMFILE, "Too many open files"), OSError(errno.EBADF, "a defect")])
    problems = []

    async def attempt(_):
        raise next(ends)

    async def pause(_):
        pass

    with pytest.raises(OSError, match="a defect"):
        await keep_going("session", attempt, Backoff(Random(1)), problems.append, pause)
    assert [problem.message for problem in problems] == [
        "cannot go on: this program has too many files and connections open"
    ]
