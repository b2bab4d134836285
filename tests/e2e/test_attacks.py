"""What somebody with a ticket that is not theirs, an observer's rights, or a page elsewhere tries; none of it works.

One attempt of each kind goes through nginx, web and relay; the unit tests of tickets, message_validator, operations
and of the API have every spelling. The robot itself, which is watched on its own rosbridge, must not have had one
command.
"""

import asyncio
import base64
import json
import time
import zlib

import pytest
from attackers import OPEN, UPGRADE, Person, open_ros, raw, refusal_of
from sim_watch import SimWatch

ROBOT, OTHER = "sim1", "sim2"
API = "/api/v1"
PUBLISH = json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 1.0}}})
ELSEWHERE = "https://evil.example"


@pytest.fixture(scope="module")
def ann(stack):
    """A driver of one robot, whose tickets and cookie are stolen or used by a page elsewhere."""
    return Person(stack, "attacked-ann", (ROBOT, "drive"))


@pytest.fixture(scope="module")
def ben(stack):
    """An observer of that robot, who wants more."""
    return Person(stack, "attacker-ben", (ROBOT, "observe"))


@pytest.fixture(autouse=True)
def nothing_moves(stack):
    """After each attempt the robot, which nobody drives, has had no command."""
    stack.wait_until_free(ROBOT)
    with SimWatch(stack, ROBOT) as watch:
        begun = time.monotonic()
        yield
        assert watch.commands(since=begun) == []


def _raised(ticket):
    """An observer's ticket whose text says drive, with the signature it had."""
    payload, timestamp, signature = ticket.rsplit(".", 2)
    packed = payload.startswith(".")
    inner = base64.urlsafe_b64decode(payload.lstrip(".") + "==")
    fields = (zlib.decompress(inner) if packed else inner).replace(b"observe", b"drive")
    text = base64.urlsafe_b64encode(zlib.compress(fields) if packed else fields).decode()
    return "." * packed + ".".join([text.rstrip("="), timestamp, signature])


def test_no_such_ticket_opens_a_robot(stack, ann):
    used = ann.ticket(ROBOT)
    assert open_ros(stack, ROBOT, used, Origin=ELSEWHERE).said == "403 origin_refused"
    assert open_ros(stack, ROBOT, used, Origin=stack.url).code == OPEN
    for ticket, robot, refusal in (
        (None, ROBOT, "401 ticket_missing"),
        (used, ROBOT, "401 ticket_used"),
        (ann.ticket(ROBOT), OTHER, "404 robot_unknown"),
        (_raised(ann.ticket(ROBOT)), ROBOT, "401 ticket_forged"),
        (ann.token, ROBOT, "401 ticket_malformed"),
    ):
        assert open_ros(stack, robot, ticket).said == refusal


async def test_an_observer_sends_nothing_that_moves(ben):
    attempts = {
        PUBLISH: "only subscribes",
        PUBLISH.encode(): "only subscribes",
        '{"op": "subscribe", ' + PUBLISH[1:]: "only subscribes",
        PUBLISH.replace("publish", "Publish"): "no such operation",
        PUBLISH[:40]: "not JSON",
        json.dumps({"op": "fragment", "num": 0, "total": 1, "data": PUBLISH}): "its content cannot",
        '{"op": "call_service", "service": "/reset"}': "only subscribes",
        '{"op": "robotether.release"}': "no such operation",
    }
    async with ben.program.connect(ROBOT, "observe") as socket:
        for data, refusal in attempts.items():
            assert refusal in await refusal_of(socket, data), data
        await socket.send_json({"op": "call_service", "id": "9", "service": "/rosapi/get_time"})
        assert (await asyncio.wait_for(socket.receive_json(), 5))["id"] == "9"


def test_an_observer_gets_no_more(ben):
    for method, path, body, refusal in (
        ("POST", "/tickets", {"robot": ROBOT, "mode": "drive"}, "403 grant_missing"),
        ("POST", "/tickets", {"robot": OTHER, "mode": "observe"}, "404 robot_unknown"),
        ("POST", f"/robots/{ROBOT}/lease", {"action": "take"}, "403 grant_missing"),
        ("POST", f"/robots/{ROBOT}/release", None, "403 grant_missing"),
        ("POST", f"/robots/{OTHER}/stop", {}, "404 robot_unknown"),
        ("PUT", f"/grants/{ben.name}/{ROBOT}", {"level": "manage"}, "403 grant_missing"),
    ):
        assert ben.ask(method, API + path, body).said == refusal, path
    video = f"/robots/{OTHER}/video/stream?topic=/camera/image_raw"
    assert raw(ben.stack, "GET", video, headers=ben.bearer).said == "404 robot_unknown"
    listed = json.loads(ben.ask("GET", f"{API}/robots").body)["robots"]
    assert [robot["name"] for robot in listed] == [ROBOT]


def test_a_page_elsewhere_acts_for_nobody(stack, ann):
    """The browser adds the driver's cookie; it is not enough, and no answer may be read elsewhere."""
    origin, stop = {"Origin": ELSEWHERE}, f"{API}/robots/{ROBOT}/stop"
    video = f"/robots/{ROBOT}/video/stream?topic=/camera/image_raw"
    script = {"Sec-Fetch-Dest": "script"}
    for method, path, headers, refusal in (
        ("GET", f"{API}/events", origin, "403 origin_refused"),
        ("GET", video, origin, "403 origin_refused"),
        ("GET", video, script, "403 destination_refused"),
        ("POST", stop, origin, "403 origin_refused"),
        ("POST", stop, {"Origin": "null"}, "403 origin_refused"),
        ("POST", stop, {}, "403 csrf_refused"),
        ("POST", f"{API}/tickets", {"X-CSRFToken": "x"}, "403 csrf_refused"),
        ("GET", f"/robots/{ROBOT}/ros", UPGRADE, "401 ticket_missing"),
    ):
        body = {"robot": ROBOT, "mode": "drive"} if method == "POST" else None
        answer = raw(stack, method, path, headers={**ann.cookie, **headers}, body=body)
        assert answer.said == refusal, path
        assert not any(name.lower().startswith("access-control-") for name in answer.headers)
