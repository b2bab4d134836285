"""Who may do what with a request for help; each refusal is an attack or a mistake."""

from datetime import timedelta

import pytest
from granted import give, take
from help_desk import HelpDesk
from robotether_server.db import fleet, migrate, users
from robotether_server.db.audit import Source
from robotether_server.problems import (
    GrantMissingError,
    NotPossibleError,
    RecordMissingError,
    RobotUnknownError,
)
from robotether_server.services import requests


@pytest.fixture
def desk(database, relay_database):
    return HelpDesk(database, relay_database)


def make(desk, name, robot="sim1", **source):
    with desk.transaction() as tx:
        return requests.make(
            tx,
            Source(name, **source),
            users.get(tx, name),
            robot,
            reason="<script>",
            priority=2,
            pool="",
        )


def test_people_ask_for_robots_that_they_may_drive(desk):
    """What they write is data; a page and a program are sources of their own, with one open request each."""
    request, _ = make(desk, "ann")
    assert (request.source, request.reason, request.asked_by) == ("page", "<script>", "ann")
    assert make(desk, "ben")[0].id == request.id
    of_program, _ = make(desk, "ben", api_token=b"x")
    assert of_program.source == "api"
    for name, robot, problem in (
        ("olga", "sim1", GrantMissingError),
        ("olga", "sim2", RobotUnknownError),
        ("zoe", "sim1", RobotUnknownError),
        ("ann", "ghost", RobotUnknownError),
    ):
        with pytest.raises(problem):
            make(desk, name, robot)
    desk.ask()
    desk.ask(source="stop")
    desk.act("cancel", "ben", of_program.id)
    desk.ask(source="battery")
    with pytest.raises(NotPossibleError, match="as many open requests as it may"):
        make(desk, "ann", api_token=b"x")


def test_a_request_of_a_removed_user_is_not_that_of_the_next_of_the_name(desk):
    request_id = make(desk, "ann")[0].id
    with desk.transaction() as tx:
        users.remove(tx, desk.users["ann"])
        give(tx, users.add(tx, "ann", "x", "user"), desk.robots["sim1"], "drive")
    with pytest.raises(GrantMissingError):
        desk.act("cancel", "ann", request_id)


def test_an_offer_is_accepted_by_its_operator_in_time_and_with_the_right(desk):
    request_id = desk.ask()
    desk.poll("ann")
    for name, problem in (
        ("ben", NotPossibleError),
        ("olga", GrantMissingError),
        ("zoe", RecordMissingError),
    ):
        with pytest.raises(problem):
            desk.act("accept", name, request_id)
    with pytest.raises(NotPossibleError):
        desk.act("decline", "ben", request_id)
    with pytest.raises(NotPossibleError):
        desk.act("close", "ann", request_id)
    with desk.transaction() as tx:
        take(tx, desk.users["ann"], desk.robots["sim1"])
    with pytest.raises(RecordMissingError):
        desk.act("accept", "ann", request_id)
    desk.pass_time(1)
    assert desk.poll("ben").offer.id == request_id
    assert [event.details["why"] for event in desk.events("request_passed")] == ["right_ended"]
    desk.pass_time(21)
    with pytest.raises(NotPossibleError, match="or no longer"):
        desk.act("accept", "ben", request_id)
    with pytest.raises(RecordMissingError):
        desk.act("accept", "ben", request_id + 1)


def test_a_supervisor_assigns_by_hand(desk):
    """To who is available or wraps up, past the pool, and also what somebody has accepted."""
    request_id = desk.ask(pool="night")
    for name in ("ann", "ben"):
        with pytest.raises(NotPossibleError, match=f"user {name} is away"):
            desk.act("assign", "mona", request_id, name)
    desk.poll("ann")
    assert desk.act("assign", "mona", request_id, "ann").offered_to == "ann"
    desk.act("accept", "ann", request_id)
    desk.poll("ben")
    desk.act("assign", "mona", request_id, "ben")
    desk.pass_time(1)
    assert desk.poll("ann").state == "available"
    desk.act("accept", "ben", request_id)
    desk.act("close", "ben", request_id)
    assert desk.poll("ben").state == "wrap_up"
    first, second = desk.ask(), desk.ask(source="stop")
    desk.act("assign", "mona", first, "ben")
    with pytest.raises(NotPossibleError, match=f"request {first} of robot sim1 is offered"):
        desk.act("assign", "mona", second, "ann")
    desk.act("accept", "ben", first)
    other = desk.ask("sim2")
    desk.pass_time(1)
    assert desk.poll("ann").offer.id == other
    desk.act("assign", "mona", first, "ann")
    desk.act("assign", "mona", first, "ben")
    [passed] = desk.events("request_passed")
    assert (passed.actor, passed.robot, passed.details["user"]) == ("mona", "sim2", "ann")
    desk.act("accept", "ben", first)
    with pytest.raises(NotPossibleError, match="user ben is busy"):
        desk.act("assign", "mona", other, "ben")
    for name in ("zoe", "olga", "ghost"):
        with pytest.raises(NotPossibleError, match="may drive robot sim2"):
            desk.act("assign", "mona", other, name)
    assert desk.request(other).state == "waiting"


@pytest.mark.parametrize(
    ("action", "values"), [("assign", ("ann",)), ("close", ("",)), ("cancel", ())]
)
def test_what_managers_may_do_drivers_may_not(desk, action, values):
    request_id = desk.ask()
    desk.poll("ann")
    desk.act("accept", "ann", request_id)
    with pytest.raises(GrantMissingError):
        desk.act(action, "ben", request_id, *values)
    assert desk.act(action, "mona", request_id, *values).accepted_by in {"ann", None}
    if action != "assign":
        assert desk.poll("ann").state == "wrap_up"
        with pytest.raises(NotPossibleError):
            desk.act(action, "mona", request_id, *values)


@pytest.mark.parametrize("is_reassigned", [True, False])
def test_a_request_that_was_accepted_waits_anew(desk, is_reassigned):
    """An alert must not come at once, and the figures count no hours in which somebody helped."""
    request_id = desk.ask()
    desk.poll("ann")
    desk.act("accept", "ann", request_id)
    desk.pass_time(3600)
    desk.poll("ben")
    if is_reassigned:
        desk.act("assign", "mona", request_id, "ben")
    else:
        with desk.transaction() as tx:
            take(tx, desk.users["ann"], desk.robots["sim1"])
        desk.pass_time(1)
        desk.poll("ben")
    desk.pass_time(10)
    desk.poll("ben")
    with desk.relay_database.transaction() as tx:
        [waiting] = fleet.read_requests(tx)
    assert 10 <= waiting.waited_s < 20
    assert waiting.age_s > 3600
    desk.act("accept", "ben", request_id)
    with desk.transaction() as tx:
        figures = requests.read_figures(tx, users.get(tx, "mona"), 24)
    assert 10 <= figures.waiting_p95_s < 20


def test_figures_over_time_are_of_what_the_user_may_see(desk, admin_database):
    """A period of which records may be deleted is unknown; one in which nothing happened is not."""

    def periods(name):
        with desk.transaction() as tx:
            return requests.read_periods(tx, users.get(tx, name), "day")

    with desk.transaction() as tx:
        [now_s] = tx.row("SELECT UNIX_TIMESTAMP() AS now_s").values()
    for waits_s, action in ((10, "close"), (30, "close"), (20, "cancel")):
        request_id = desk.ask("sim2")
        desk.pass_time(waits_s)
        desk.poll("ann")
        desk.act("accept", "ann", request_id)
        desk.act(action, "mona", request_id)
        desk.pass_time(40)
    # To the beginning of the period before, whatever time it is.
    length_s, count = requests.PERIODS["day"]
    desk.pass_time(float(now_s) % length_s + length_s - 300)
    desk.ask("sim2")
    *_, before, last = shown = periods("ann")
    assert (len(shown), last.begins_at - before.begins_at) == (count, timedelta(seconds=length_s))
    assert (before.made, before.closed, before.cancelled) == (3, 2, 1)
    assert 20 <= before.waiting_p50_s < 25
    assert 30 <= before.waiting_p95_s < 35
    assert (last.made, last.closed, last.waiting_p50_s, last.waiting_p95_s) == (1, 0, None, None)
    assert periods("olga")[-2].made == periods("zoe")[-2].made == shown[0].made == 0
    with admin_database.transaction() as tx:
        migrate.set_audit_days(tx, 20)
    assert periods("ann")[0].made is None
