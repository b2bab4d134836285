"""When a connection is tried again."""

from __future__ import annotations

from itertools import islice
from random import Random

import pytest
from robotether_agent.backoff import (
    FAILED_START_S,
    STABLE_S,
    USED_TRIES,
    Backoff,
    Repeats,
    Uptime,
    before_restart,
    delays,
    keep_going,
    retry_or_give_up,
)
from robotether_agent.problems import (
    AgentError,
    LinkLostError,
    NetworkChangedError,
    NoAnswerError,
    NotEnrolledError,
    Retry,
    ServerBusyError,
    ServerKeyChangedError,
    ServerSilentError,
    SessionEndedError,
    TlsUntrustedError,
)


class Longest(Random):
    """Always draws the ceiling."""

    def uniform(self, a: float, b: float) -> float:
        return b


def test_ceilings_double_up_to_15_s():
    assert list(islice(delays(Longest()), 6)) == [1, 2, 4, 8, 15, 15]


def test_delays_are_spread_from_half_a_second():
    """Each pause is anywhere from 0.5 s to the ceiling, so that a fleet does not come back as one."""
    drawn = list(islice(delays(Random(1)), 1000))
    assert min(drawn) >= 0.5
    assert max(drawn) <= 15
    assert min(drawn[10:]) < 2
    assert max(drawn) > 14


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


def test_starts_anew_after_a_connection_that_stood():
    """Pauses grow while none comes up, and are short again after one that stood 10 s."""
    backoff = Backoff(Longest())
    assert [backoff.after(LinkLostError("x"), uptime_s=0) for _ in range(4)] == [1, 2, 4, 8]
    assert backoff.after(LinkLostError("x"), uptime_s=STABLE_S) == 1


def test_a_short_connection_ends_what_was_before_it():
    """One machine of a server after the other may fail; who has waited for one does not wait longer for the next."""
    backoff = Backoff(Longest())
    assert [backoff.after(LinkLostError("x"), uptime_s=0) for _ in range(4)] == [1, 2, 4, 8]
    assert [backoff.after(LinkLostError("x"), uptime_s=1) for _ in range(2)] == [2, 2]
    assert backoff.after(LinkLostError("x"), uptime_s=0) == 4


def test_a_busy_server_is_asked_again_soon():
    """It has room as soon as one log-in ends, and the robot would wait longer for its turn than that takes."""
    backoff = Backoff(Longest())
    assert [backoff.after(ServerBusyError("x"), uptime_s=0) for _ in range(5)] == [1, 2, 4, 4, 4]


def test_silence_on_a_connection_that_stood_is_the_networks():
    """It is dialled again at once, and only then; a login that stalls again and again is not."""
    backoff = Backoff(Longest())
    assert backoff.after(ServerSilentError("x"), uptime_s=STABLE_S) == 0.7
    assert [backoff.after(ServerSilentError("x"), uptime_s=0) for _ in range(3)] == [1, 2, 4]


def test_another_address_after_a_connection_that_stood_costs_no_pause():
    """Who drives waits for it; addresses that change all the time do pause."""
    backoff = Backoff(Longest())
    assert backoff.after(NetworkChangedError("x"), uptime_s=STABLE_S) == 0
    assert backoff.after(NetworkChangedError("x"), uptime_s=1) == 0.2


def test_a_robot_that_somebody_used_goes_before_the_others():
    backoff = Backoff(Longest())
    assert backoff.after(LinkLostError("x"), uptime_s=STABLE_S, was_used=True) == 0.2
    first = [backoff.after(ServerBusyError("x"), uptime_s=0) for _ in range(USED_TRIES - 1)]
    assert {*first, backoff.after(LinkLostError("x"), uptime_s=1)} == {0.6}
    assert backoff.after(LinkLostError("x"), uptime_s=0) == 2
    superseded = SessionEndedError("x", code="superseded", retry=Retry.SLOWLY)
    assert backoff.after(superseded, uptime_s=STABLE_S, was_used=True) == 30
    assert backoff.after(LinkLostError("x"), uptime_s=STABLE_S) == 1


def test_who_is_sent_away_at_once_again_and_again_pauses():
    """Machines that are all taken out of service are not logged in at all the time."""
    backoff = Backoff(Longest())
    sent_away = SessionEndedError("x", code="cell_draining", retry=Retry.AT_ONCE)
    assert backoff.after(sent_away, uptime_s=STABLE_S) == 0.2
    assert [backoff.after(sent_away, uptime_s=1) for _ in range(3)] == [1, 2, 4]


def test_agent_that_fails_at_its_start_pauses_and_one_that_ran_does_not():
    """The robot is back at once after a crash, and its processor is left alone by one that never comes up."""
    low, high = FAILED_START_S
    assert low <= before_restart(0.1, Random()) <= high
    assert before_restart(STABLE_S - 0.1, Longest()) == high
    assert before_restart(STABLE_S, Longest()) == 0


class NoPause(Random):
    """Draws no pause."""

    def uniform(self, a: float, b: float) -> float:
        return 0.0


async def test_tries_again_until_nothing_helps():
    problems: list[AgentError] = [
        LinkLostError("one"),
        NotEnrolledError("two"),
        ServerKeyChangedError("three"),
    ]
    told: list[AgentError] = []

    async def attempt(_: Uptime) -> None:
        raise problems[len(told)]

    with pytest.raises(ServerKeyChangedError, match="three"):
        await keep_going("session", attempt, Backoff(NoPause()), told.append)
    assert told == problems[:2]


def test_two_problems_that_take_turns_are_thinned_out_too(caplog):
    """A network that comes and goes for days fills no log; after a success all is told anew."""
    repeats = Repeats()
    for _ in range(8):
        repeats.log_problem("session", LinkLostError("lost it"), 1)
        repeats.log_problem("session", ServerKeyChangedError("changed"))
    assert len(caplog.records) == 8
    repeats.forget()
    repeats.log_problem("session", LinkLostError("lost it"), 1)
    assert len(caplog.records) == 9


def test_uptime_counts_from_when_it_stood():
    now = [10.0]
    uptime = Uptime(lambda: now[0])
    assert uptime.uptime_s == 0
    now[0] = 15
    uptime.is_up()
    now[0] = 18
    uptime.is_up()
    assert uptime.uptime_s == 3
