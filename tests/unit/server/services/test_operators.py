"""What operators are offered, by the polls of all of them, in the real database."""

import contextlib
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from granted import take
from help_desk import HelpDesk
from robotether_server.db import fleet, robots, users
from robotether_server.problems import GrantMissingError, NotPossibleError
from robotether_server.services import operators
from robotether_server.times import utc_now


@pytest.fixture
def desk(database, relay_database):
    return HelpDesk(database, relay_database)


def kinds(desk):
    return [(event.kind, event.actor) for event in desk.events() if "request" in event.kind]


def test_an_offer_passes_on_when_its_operator_does_not_answer(desk):
    """The longest idle is asked first, then the next. Who lets it end is away, and asked again once back."""
    desk.poll("ann")
    desk.pass_time(3)
    desk.poll("ben")
    desk.pass_time(3)
    request_id = desk.ask()
    view = desk.poll("ben")
    assert (view.offer, view.ahead, view.waiting) == (None, 0, [])
    view = desk.poll("ann", None)
    assert view.offer.id == request_id
    assert 19 < view.offer_left_s <= 20
    for _ in range(3):
        desk.pass_time(7)
        desk.poll("ann")
        view = desk.poll("ben")
    assert view.offer.id == request_id
    desk.pass_time(12)
    view = desk.poll("ben")
    assert view.offer.id == request_id
    desk.pass_time(9)
    desk.poll("ben", None)
    desk.pass_time(3)
    view = desk.poll("ben", None)
    assert (view.state, view.offer) == ("away", None)
    desk.pass_time(1)
    assert desk.poll("ben").offer.id == request_id
    assert kinds(desk) == [
        ("request_made", "sim1"),
        ("request_offered", "planner"),
        ("request_passed", "ann"),
        ("request_offered", "planner"),
        ("request_passed", "ben"),
        ("request_offered", "planner"),
    ]


def test_who_declines_is_not_asked_again_at_once(desk):
    """After a minute, or once back, also where there is nobody else."""
    desk.poll("ann")
    request_id = desk.ask()
    assert desk.poll("ann").offer.id == request_id
    desk.act("decline", "ann", request_id)
    for _ in range(6):
        desk.pass_time(9)
        view = desk.poll("ann")
        assert (view.offer, view.waiting_count) == (None, 1)
    desk.pass_time(7)
    assert desk.poll("ann").offer.id == request_id
    desk.act("decline", "ann", request_id)
    desk.poll("ann", "away")
    desk.pass_time(1)
    assert desk.poll("ann").offer.id == request_id


def test_of_two_pages_of_an_operator_the_choice_counts(desk):
    """A heartbeat without one changes nothing, and who was gone for 10 s has to choose again."""
    assert desk.poll("ann", None).state == "away"
    assert desk.poll("ann").state == "available"
    desk.pass_time(9)
    assert desk.poll("ann", None).state == "available"
    assert desk.poll("ann", "away").state == "away"
    assert desk.poll("ann", None).state == "away"
    desk.poll("ann")
    desk.pass_time(11)
    assert desk.poll("ann", None).state == "away"


def test_an_operator_is_away_since_the_choice_whatever_the_page_says_or_since_it_is_silent(desk):
    def away_for(name):
        with desk.transaction() as tx:
            shown = operators.list_operators(tx, users.get(tx, "mona"))
        (seen,) = (operator for operator in shown if operator.user == name)
        return seen.state, round((utc_now() - seen.since).total_seconds(), -1)

    desk.poll("ann")
    desk.pass_time(40)
    desk.poll("ann", "away")
    desk.poll("ben")
    for _ in range(3):
        desk.pass_time(9)
        desk.poll("ann", None)
    assert [away_for("ann"), away_for("ben")] == [("away", 30), ("away", 30)]


def test_who_drives_is_busy_but_for_the_robot_of_the_offer(desk):
    """Nor does a route of the operator drive in person."""
    desk.poll("ann")
    desk.drive("ann", "sim2", "ann (route)")
    request_id = desk.ask()
    desk.pass_time(1)
    assert desk.poll("ann").offer.id == request_id
    desk.drive("ann", "sim1")
    desk.pass_time(1)
    assert desk.poll("ann").offer.id == request_id
    desk.drive("ann", "sim2")
    desk.pass_time(1)
    view = desk.poll("ann")
    assert (view.state, view.offer) == ("busy", None)
    assert desk.request(request_id).state == "waiting"


def test_a_pool_and_the_right_to_drive_say_who_is_asked(desk):
    """Not even what waits is shown to others; a robot's second request waits for the first."""
    desk.set_pools("ben", "night")
    night, second = desk.ask(pool="night"), desk.ask(source="stop")
    assert desk.poll("ann").offer is None
    assert desk.poll("olga").waiting == desk.poll("zoe").waiting == []
    desk.pass_time(1)
    view = desk.poll("ben")
    assert view.offer.id == night
    view = desk.poll("ann")
    assert ([request.id for request in view.waiting], view.waiting_count) == ([second], 1)
    desk.pass_time(1)
    assert desk.poll("ann").offer is None


@pytest.mark.parametrize("end", ["right", "user"])
def test_a_request_waits_again_when_its_operator_is_gone(desk, end):
    """With the right to drive or altogether, also after accepting it."""
    request_id = desk.ask()
    desk.poll("ann")
    desk.act("accept", "ann", request_id)
    with desk.transaction() as tx:
        if end == "user":
            users.remove(tx, desk.users["ann"])
        else:
            take(tx, desk.users["ann"], desk.robots["sim1"])
    desk.pass_time(1)
    desk.poll("ben")
    assert desk.request(request_id).state == "waiting"
    desk.pass_time(1)
    assert desk.poll("ben").offer.id == request_id
    assert desk.events("request_passed")[0].details["why"] == "right_ended"


def test_requests_go_with_their_robot_and_rest_while_it_is_disabled(desk, relay_database):
    request_id = desk.ask()
    desk.ask("sim2")
    desk.poll("ann")
    with desk.transaction() as tx:
        robots.set_state(tx, desk.robots["sim1"], "disabled")
        robots.remove(tx, desk.robots["sim2"])
    desk.pass_time(1)
    assert desk.poll("ann").offer is None
    assert desk.request(request_id).state == "waiting"
    assert [request.id for request in desk.poll("ann").waiting] == [request_id]
    with relay_database.transaction() as tx:
        # Else an alert would last as long.
        assert fleet.read_requests(tx) == []


def test_polls_at_once_give_no_request_to_two(desk):
    """Each request is offered once and each operator gets one; accepting at once gives it to one."""
    with desk.transaction() as tx:
        names = [f"op{number}" for number in range(6)]
        for name in names:
            users.add(tx, name, "x", "admin")
    for name in names:
        desk.poll(name)
    request_ids = {desk.ask(), desk.ask("sim2")}
    for _ in range(5):
        desk.pass_time(1)
        barrier = threading.Barrier(len(names))

        def poll_and_accept(name, barrier=barrier):
            barrier.wait(60)
            view = desk.poll(name)
            for request_id in request_ids:
                with contextlib.suppress(NotPossibleError):
                    desk.act("accept", name, request_id)
            return view

        with ThreadPoolExecutor(len(names)) as threads:
            list(threads.map(poll_and_accept, names))
    assert len(desk.events("request_offered")) == len(desk.events("request_accepted")) == 2
    holders = {desk.request(request_id).accepted_by for request_id in request_ids}
    assert len(holders - {None}) == 2


def test_a_poll_waits_for_nobody_who_plans(desk):
    """Of two polls at once the second neither plans nor waits, also if the first one's cell hangs."""
    desk.poll("ann")
    desk.poll("ben")
    desk.ask()
    desk.pass_time(1)
    with desk.transaction() as tx:
        first = operators.poll(tx, users.get(tx, "ann"), "available")
        assert first.offer is not None
        assert desk.poll("ben").offer is None
    desk.pass_time(1)
    assert desk.poll("ben").offer is None
    assert len(desk.events("request_offered")) == 1


def test_managers_see_the_operators_of_their_robots(desk):
    desk.set_pools("ann", "night", "crane")
    for name, choice in (("ann", "available"), ("ben", "away"), ("zoe", "available")):
        desk.poll(name, choice)
    request_id = desk.ask()
    desk.pass_time(1)
    desk.poll("ann")
    desk.act("accept", "ann", request_id)
    desk.pass_time(11)
    with desk.transaction() as tx:
        shown = operators.list_operators(tx, users.get(tx, "mona"))
        with pytest.raises(GrantMissingError):
            operators.list_operators(tx, users.get(tx, "ann"))
    assert [(operator.user, operator.state, operator.pools) for operator in shown] == [
        ("ann", "busy", ["crane", "night"]),
        ("ben", "away", []),
    ]
    assert [operator.request and operator.request.id for operator in shown] == [request_id, None]
