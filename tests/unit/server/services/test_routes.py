"""Routes: who may make and remove them, and which the server refuses."""

import datetime as dt
import itertools

import pytest
from granted import give
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.db import fleet, robots, routes, users
from robotether_server.db.audit import Source
from robotether_server.db.routes import RouteEnd
from robotether_server.problems import (
    FieldInvalidError,
    GrantMissingError,
    NotPossibleError,
    RecordExistsError,
    RecordMissingError,
    RobotUnknownError,
)
from robotether_server.services import routes as route_service
from robotether_server.services.routes import RouteRequest, loop_with

OTHER_MAC = "02:00:00:00:51:03"
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture
def fleet_of_four(site):
    """Ann manages sim1 to sim3, and drives sim4; ben sees sim1 and sim2."""
    with site.database.transaction() as tx:
        names = {"sim1": robots.get(tx, "sim1").id}
        names |= {
            f"sim{number}": robots.add(tx, f"02:00:00:00:51:0{number}", f"sim{number}")
            for number in (2, 3, 4)
        }
        ann, ben = users.get(tx, "ann").id, users.add(tx, "ben", "x", "user")
        for name, robot_id in names.items():
            give(tx, ann, robot_id, "drive" if name == "sim4" else "manage")
        for name in ("sim1", "sim2"):
            give(tx, ben, names[name], "drive")
    return site


def made(site, start, end, topic="/cmd_vel", by="ann", **more):
    with site.database.transaction() as tx:
        route_request = RouteRequest(start, topic, end, topic, TWIST, **more)
        return route_service.make(tx, Source(by), users.get(tx, by), route_request)


def removed(site, route_id, by):
    with site.database.transaction() as tx:
        return route_service.remove(tx, Source(by), users.get(tx, by), route_id)


def test_the_relay_ends_a_route_once(fleet_of_four, relay_database):
    route = made(fleet_of_four, "sim1", "sim2")
    end = RouteEnd(route.id, dt.datetime.now(dt.UTC), "robot_stopped", "ann", "sim1", "sim2")
    for _ in range(2):
        with relay_database.transaction() as tx:
            fleet.write(tx, [end])
    assert len(fleet_of_four.events("route_ended")) == 1
    with fleet_of_four.database.transaction() as tx:
        assert routes.get(tx, route.id).end_code == "robot_stopped"
    with relay_database.transaction() as tx:
        assert routes.read_lasting(tx) == ()
    # It is no route any more, so there may be another.
    made(fleet_of_four, "sim1", "sim2")


@pytest.mark.parametrize(
    ("start", "end", "by", "refusal"),
    [
        ("sim1", "sim4", "ann", GrantMissingError),
        ("sim4", "sim1", "ann", GrantMissingError),
        ("sim1", "sim2", "ben", GrantMissingError),
        ("sim3", "sim1", "ben", RobotUnknownError),
        ("sim1", "sim9", "ann", RobotUnknownError),
        ("sim1", "sim1", "ann", FieldInvalidError),
        ("app:joy", "sim4", "ann", GrantMissingError),
        ("app:joy", "sim9", "ann", RobotUnknownError),
        ("sim4", "app:joy", "ann", GrantMissingError),
        ("app:joy", "app:map", "ann", FieldInvalidError),
        ("app:<b>", "sim1", "ann", FieldInvalidError),
        ("app:", "sim1", "ann", FieldInvalidError),
    ],
)
def test_who_does_not_manage_its_robots_makes_none(fleet_of_four, start, end, by, refusal):
    with pytest.raises(refusal):
        made(fleet_of_four, start, end, by=by)
    with fleet_of_four.database.transaction() as tx:
        assert routes.list_all(tx) == []


@pytest.mark.parametrize("macs", [(OTHER_MAC, None), (None, OTHER_MAC)])
def test_robots_that_have_got_the_names_get_no_route(fleet_of_four, macs):
    with pytest.raises(RobotUnknownError, match="another robot has this name now"):
        made(fleet_of_four, "sim1", "sim2", macs=macs)
    with pytest.raises(FieldInvalidError, match="an app has none"):
        made(fleet_of_four, "app:joy", "sim2", macs=(OTHER_MAC, None))


def test_what_is_no_topic_or_rate_or_one_too_many_is_refused(
    fleet_of_four, relay_database, monkeypatch
):
    """One that has ended gives way."""
    for more in ({"topic": "/a b"}, {"topic": "<b>"}, {"rate_hz": 0}, {"rate_hz": float("nan")}):
        with pytest.raises(FieldInvalidError):
            made(fleet_of_four, "sim1", "sim2", **more)
    monkeypatch.setattr(route_service, "MAX_ROUTES", 1)
    route = made(fleet_of_four, "sim1", "sim2")
    with pytest.raises(NotPossibleError, match="you have 1"):
        made(fleet_of_four, "sim1", "sim3")
    with relay_database.transaction() as tx:
        ended_at = dt.datetime.now(dt.UTC)
        fleet.write(tx, [RouteEnd(route.id, ended_at, "robot_stopped", "ann", "sim1", "sim2")])
    other = made(fleet_of_four, "sim1", "sim3")
    with fleet_of_four.database.transaction() as tx:
        assert [each.id for each in routes.list_all(tx)] == [other.id]


def test_a_loop_is_found_before_it_is_saved(fleet_of_four):
    for start, end in (("sim1", "sim2"), ("sim2", "sim3")):
        made(fleet_of_four, start, end)
    with pytest.raises(
        NotPossibleError, match="sim1 /cmd_vel, sim2 /cmd_vel, sim3 /cmd_vel, sim1 /cmd_vel"
    ):
        made(fleet_of_four, "sim3", "sim1")
    with pytest.raises(RecordExistsError):
        made(fleet_of_four, "sim1", "sim2")
    made(fleet_of_four, "sim3", "sim1", topic="/map")


def test_a_loop_names_no_robot_that_the_user_may_not_see(fleet_of_four):
    for start, end in (("sim2", "sim3"), ("sim3", "sim1")):
        made(fleet_of_four, start, end)
    with fleet_of_four.database.transaction() as tx:
        for name in ("sim1", "sim2"):
            give(tx, users.get(tx, "ben").id, robots.get(tx, name).id, "manage")
    with pytest.raises(NotPossibleError, match="sim2 /cmd_vel, a robot or app that") as refusal:
        made(fleet_of_four, "sim1", "sim2", by="ben")
    assert "sim3" not in refusal.value.detail


def test_a_loop_through_an_app_is_found(fleet_of_four):
    """Another user's app of the same name is another."""
    made(fleet_of_four, "sim1", "app:joy")
    made(fleet_of_four, "app:joy", "sim2", by="root")
    made(fleet_of_four, "sim2", "sim1")
    with pytest.raises(NotPossibleError, match="sim1 /cmd_vel, ann/app:joy /cmd_vel, sim2"):
        made(fleet_of_four, "app:joy", "sim2")


NODES = st.tuples(st.sampled_from("abcd"), st.sampled_from(("/x", "/y")))


@given(st.lists(st.tuples(NODES, NODES), max_size=12))
def test_edges_that_close_no_loop_leave_an_order(edges):
    """Whatever is added in which order, what was accepted has no loop, and what was refused would have made one."""
    accepted = []
    for start, end in edges:
        loop = loop_with(accepted, start, end)
        if loop:
            assert (loop[0], loop[-1]) == (end, end)
            assert set(itertools.pairwise(loop)) <= {*accepted, (start, end)}
        else:
            accepted.append((start, end))
    left = set(accepted)
    while left:
        starts = {start for start, _ in left}
        last = {edge for edge in left if edge[1] not in starts}
        assert last
        left -= last


def test_only_its_maker_or_a_manager_removes_a_route(fleet_of_four):
    """To whom a robot is hidden, the route is, too."""
    near, far = made(fleet_of_four, "sim1", "sim2"), made(fleet_of_four, "sim1", "sim3")
    with fleet_of_four.database.transaction() as tx:
        assert route_service.list_seen(tx, users.get(tx, "ben")) == [near]
    with pytest.raises(GrantMissingError):
        removed(fleet_of_four, near.id, "ben")
    with pytest.raises(RecordMissingError):
        removed(fleet_of_four, far.id, "ben")
    removed(fleet_of_four, far.id, "root")


def test_a_route_goes_with_its_robot_and_its_maker(fleet_of_four):
    made(fleet_of_four, "sim1", "sim2")
    made(fleet_of_four, "sim2", "sim3", by="root")
    with fleet_of_four.database.transaction() as tx:
        robots.remove(tx, robots.get(tx, "sim1").id)
        assert [route.source for route in routes.list_all(tx)] == ["sim2"]
        users.remove(tx, users.get(tx, "root").id)
        assert routes.list_all(tx) == []
