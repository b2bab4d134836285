"""What somebody with a ticket that is not theirs, an observer's rights, or a page elsewhere tries; none of it works.

Each line of a table is one attempt against the running stack, with the refusal that it must get. At the end the robot
itself, which is watched on its own rosbridge, must not have had one command.
"""

from __future__ import annotations

import asyncio
import base64
import json
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
from attackers import OPEN, UPGRADE, Person, open_ros, raw, refusal_of
from itsdangerous.timed import TimestampSigner
from page_users import release_all
from robotether_server.tickets import Ticket, TicketSigner
from sim_watch import SimWatch
from stack import Stack
from stopwatch import Stopwatch

ROBOT, OTHER = "sim1", "sim2"
TWIST = {"linear": {"x": 1.0}, "angular": {"z": 1.0}}
PUBLISH = json.dumps({"op": "publish", "topic": "/cmd_vel", "msg": TWIST})
API = "/api/v1"
TTL_S = 30
AT_ONCE_S = 2.0
# A connection hears of so many refusals at once.
ANSWERS_PER_S = 10
ELSEWHERE = "https://evil.example"


@pytest.fixture(scope="module")
def ann(stack: Stack) -> Person:
    """A driver of one robot, whose tickets and cookie are stolen or used by a page elsewhere."""
    return Person(stack, "attacked-ann", (ROBOT, "drive"))


@pytest.fixture(scope="module")
def ben(stack: Stack) -> Person:
    """An observer of that robot, who wants more."""
    return Person(stack, "attacker-ben", (ROBOT, "observe"))


@pytest.fixture(scope="module")
def watch(stack: Stack) -> Iterator[SimWatch]:
    """What really reaches the robot, which nobody drives any more, nor is it kept for anybody."""
    stack.wait_until_free(ROBOT)
    with SimWatch(stack, ROBOT) as watching:
        yield watching


@pytest.fixture(autouse=True)
def nothing_moves(watch: SimWatch) -> Iterator[None]:
    """After each attempt the robot has had no command at all but zeros, which a stop makes."""
    begun = time.monotonic()
    yield
    moving = [seen.msg for seen in watch.commands(since=begun) if any(
        value for part in seen.msg.values() for value in part.values()
    )]  # fmt: skip
    assert moving == []


class Forger:
    """Makes tickets out of a good one, with the site's own key where it is stolen, or without."""

    def __init__(self, stack: Stack, owner: Person) -> None:
        self.owner = owner
        key = stack.exec("web", "cat", "/run/secrets/ticket_key").strip()
        self.signer = TicketSigner(key, TTL_S)

    def good(self, mode: str = "drive") -> str:
        return self.owner.ticket(ROBOT, mode)

    def read(self, text: str) -> Ticket:
        return self.signer.verify(text)[0]

    def used(self) -> str:
        ticket = self.good("observe")
        assert open_ros(self.owner.stack, ROBOT, ticket).code == OPEN
        return ticket

    def old(self) -> str:
        """Signed by the site itself, 31 s ago."""
        real = TimestampSigner.get_timestamp
        ticket = self.read(self.good())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(TimestampSigner, "get_timestamp", lambda signer: real(signer) - TTL_S - 1)
            return self.signer.sign(replace(ticket, id="0" * 32))

    def with_another_key(self) -> str:
        return TicketSigner("k" * 64, TTL_S).sign(self.read(self.good()))

    def raised(self) -> str:
        """An observer's ticket whose text says drive, with the signature it had."""
        payload, moment, signature = self.good("observe").rsplit(".", 2)
        packed = payload.startswith(".")
        inner = base64.urlsafe_b64decode(payload.lstrip(".") + "==")
        fields = (zlib.decompress(inner) if packed else inner).replace(b"observe", b"drive")
        text = base64.urlsafe_b64encode(zlib.compress(fields) if packed else fields).decode()
        return "." * packed + ".".join([text.rstrip("="), moment, signature])


@pytest.fixture(scope="module")
def forger(stack: Stack, ann: Person) -> Forger:
    return Forger(stack, ann)


TICKETS: dict[str, tuple[Callable[[Forger], str | None], str, str]] = {
    "none at all": (lambda forger: None, ROBOT, "401 ticket_missing"),
    "empty": (lambda forger: "", ROBOT, "401 ticket_malformed"),
    "used already": (Forger.used, ROBOT, "401 ticket_used"),
    "too old": (Forger.old, ROBOT, "401 ticket_expired"),
    "for another robot": (Forger.good, OTHER, "404 robot_unknown"),
    "signed with another key": (Forger.with_another_key, ROBOT, "401 ticket_forged"),
    "an observer's made a driver's": (Forger.raised, ROBOT, "401 ticket_forged"),
    "cut off": (lambda forger: forger.good()[:-4], ROBOT, "401 ticket_forged"),
    "rubbish": (lambda forger: "x.y.z", ROBOT, "401 ticket_forged"),
    "of no parts": (lambda forger: "rubbish", ROBOT, "401 ticket_malformed"),
    "an API token": (lambda forger: forger.owner.token, ROBOT, "401 ticket_malformed"),
    "twice in the query": (
        lambda forger: f"x&ticket={forger.used()}", ROBOT, "401 ticket_malformed",
    ),
}  # fmt: skip


@pytest.mark.parametrize("attempt", TICKETS)
def test_no_such_ticket_opens_a_robot(stack: Stack, forger: Forger, attempt: str) -> None:
    """Stolen, used, foreign, old and forged tickets are refused before the upgrade."""
    make, robot, expected = TICKETS[attempt]
    assert open_ros(stack, robot, make(forger)).said == expected


def test_a_ticket_ends_with_the_token_that_got_it(stack: Stack) -> None:
    """A ticket that was stolen before the token was deleted opens nothing afterwards."""
    eve = Person(stack, "attacked-eve", (ROBOT, "drive"))
    stolen = [eve.ticket(ROBOT, "drive") for _ in range(24)]
    assert open_ros(stack, ROBOT, stolen.pop()).code == OPEN
    stack.admin.remove("users", "attacked-eve")
    # The relay looks once a second; what it let in until then it ends then.
    refused = {"401 token_invalid", "404 robot_unknown"}
    with Stopwatch() as since:
        while open_ros(stack, ROBOT, stolen.pop()).said not in refused:
            assert since.s < AT_ONCE_S, "a stolen ticket still opens the robot"
            time.sleep(0.2)
    assert open_ros(stack, ROBOT, stolen.pop()).said in refused


ONLY_LOOKS, NO_JSON, NO_NAME = "only subscribes", "not JSON", "no full name"
UNKNOWN, HIDES, NO_VALUE = "no such operation", "its content cannot", "which may not stand here"
OBSERVER_SENDS: dict[str, tuple[str | bytes, str]] = {
    "publish": (PUBLISH, ONLY_LOOKS),
    "publish in a binary frame": (PUBLISH.encode(), ONLY_LOOKS),
    "relative name": (PUBLISH.replace("/cmd_vel", "cmd_vel"), ONLY_LOOKS),
    "private name": (PUBLISH.replace("/cmd_vel", "~cmd_vel"), NO_NAME),
    "doubled slash": (PUBLISH.replace("/cmd_vel", "//cmd_vel"), NO_NAME),
    "slash at the end": (PUBLISH.replace("/cmd_vel", "/cmd_vel/"), NO_NAME),
    "escaped operation": (PUBLISH.replace("publish", "\\u0070ublish"), ONLY_LOOKS),
    "escaped key": (PUBLISH.replace('"op"', '"\\u006fp"'), ONLY_LOOKS),
    "escaped topic": (PUBLISH.replace("/cmd", "\\/\\u0063md"), ONLY_LOOKS),
    "capital letters": (PUBLISH.replace("publish", "Publish"), UNKNOWN),
    "two operations": ('{"op": "subscribe", ' + PUBLISH[1:], ONLY_LOOKS),
    "two operations, one escaped": ('{"op": "subscribe", "\\u006fp": "publish", "topic": "/a"}', ONLY_LOOKS),
    "two messages in one": ('{"op": "subscribe", "topic": "/pose"}' + PUBLISH, NO_JSON),
    "a list of messages": (f"[{PUBLISH}]", NO_JSON),
    "a text in a text": (json.dumps(PUBLISH), NO_JSON),
    "the first half": (PUBLISH[:40], NO_JSON),
    "the second half": (PUBLISH[40:], NO_JSON),
    "rubbish before": ("}" + PUBLISH, NO_JSON),
    "mark of order before": ("\ufeff" + PUBLISH, NO_JSON),
    "no UTF-8": (PUBLISH.encode().replace(b"linear", b"\xff\xfe"), NO_JSON),
    "UTF-16": (PUBLISH.encode("utf-16"), NO_JSON),
    "BSON": (b"\x16\x00\x00\x00\x02op\x00\x08\x00\x00\x00publish\x00\x00", NO_JSON),
    "CBOR": (b"\xa1\x62op\x67publish", NO_JSON),
    "hidden behind NaN": (f'{{"op": "subscribe", "topic": "/pose", "x": NaN, "y": {PUBLISH}}}', NO_JSON),
    "hidden behind depth": (
        f'{{"op": "subscribe", "topic": "/pose", "x": {"[" * 99}{"]" * 99}, "y": {PUBLISH}}}', NO_JSON,
    ),
    "hidden in qos": (f'{{"op": "subscribe", "topic": "/pose", "qos": {PUBLISH}}}', NO_VALUE),
    "hidden in a look-up": (
        f'{{"op": "call_service", "service": "/rosapi/nodes", "args": [{PUBLISH}]}}', "neither a text",
    ),
    "fragment": (json.dumps({"op": "fragment", "id": "1", "num": 0, "total": 1, "data": PUBLISH}), HIDES),
    "png": (json.dumps({"op": "png", "data": base64.b64encode(PUBLISH.encode()).decode()}), HIDES),
    "advertise": ('{"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}', ONLY_LOOKS),
    "unadvertise": ('{"op": "unadvertise", "topic": "/cmd_vel"}', ONLY_LOOKS),
    "call a service": ('{"op": "call_service", "service": "/reset"}', ONLY_LOOKS),
    "set a parameter": ('{"op": "call_service", "service": "/rosapi/set_param", "args": {"name": "a"}}', ONLY_LOOKS),
    "send a goal": ('{"op": "send_action_goal", "action": "/go", "args": {}}', ONLY_LOOKS),
    "serve": ('{"op": "advertise_service", "service": "/a", "type": "std_srvs/Empty"}', ONLY_LOOKS),
    "answer for a service": ('{"op": "service_response", "service": "/a", "result": true}', ONLY_LOOKS),
    "take the control": ('{"op": "robotether.control", "control": {"driver": null}}', UNKNOWN),
    "release": ('{"op": "robotether.release"}', UNKNOWN),
    "lease": ('{"op": "robotether.lease", "fence": 99}', UNKNOWN),
    "no operation": ("{}", "without op"),
}  # fmt: skip


@pytest.mark.parametrize("first", range(0, len(OBSERVER_SENDS), ANSWERS_PER_S))
async def test_an_observer_sends_nothing_that_moves(ben: Person, first: int) -> None:
    """Whatever the spelling, the answer is a refusal, and the connection goes on."""
    attempts = list(OBSERVER_SENDS.items())[first : first + ANSWERS_PER_S]
    async with ben.program.connect(ROBOT, "observe") as socket:
        for attempt, (data, expected) in attempts:
            answer = await refusal_of(socket, data)
            assert answer["level"] == "error", attempt
            assert expected in answer["msg"], attempt
        await socket.send_json({"op": "call_service", "id": "9", "service": "/rosapi/get_time"})
        assert (await asyncio.wait_for(socket.receive_json(), 5))["id"] == "9"


async def test_of_a_key_twice_the_last_counts(ben: Person) -> None:
    """What stands before it never leaves the relay: both are subscriptions."""
    async with ben.program.connect(ROBOT, "observe") as socket:
        await socket.send_str(PUBLISH[:-1] + ', "op": "subscribe"}')
        await socket.send_str('{"op": "subscribe", "topic": "/pose", "topic": "/cmd_vel"}')
        refusal = await refusal_of(socket, PUBLISH)
        assert ONLY_LOOKS in refusal["msg"]


async def test_a_driver_opens_no_other_way_to_the_wheels(ann: Person) -> None:
    """What is neither a drive topic nor in the policy is closed to drivers too; and drive topics take commands only."""
    attempts = {
        '{"op": "publish", "topic": "/motors/raw", "msg": {"data": 1}}': "policy does not let you",
        '{"op": "call_service", "service": "/teleport_absolute", "args": {"x": 1}}': "policy does not let you",
        '{"op": "call_service", "service": "/rosapi/set_param", "args": {}}': "policy does not let you",
        '{"op": "advertise_service", "service": "/reset", "type": "x/Y"}': "policy does not let you",
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"data": "x"}}': "neither a Twist",
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 1e999}}}': "too large",
        '{"op": "publish", "topic": "/cmd_vel", "msg": {}, "robotether": {"fence": 99}}': "no object with t_ms",
    }  # fmt: skip
    async with ann.program.connect(ROBOT, "drive") as socket:
        for data, expected in attempts.items():
            assert expected in (await refusal_of(socket, data))["msg"], data


OBSERVER_ASKS: dict[str, tuple[str, str, object, str]] = {
    "a driver's ticket": ("POST", "/tickets", {"robot": ROBOT, "mode": "drive"}, "403 grant_missing"),
    "another robot's ticket": ("POST", "/tickets", {"robot": OTHER, "mode": "observe"}, "404 robot_unknown"),
    "the control": ("POST", f"/robots/{ROBOT}/lease", {"action": "ask"}, "403 grant_missing"),
    "to take the control": ("POST", f"/robots/{ROBOT}/lease", {"action": "take"}, "403 grant_missing"),
    "to answer for the driver": ("POST", f"/robots/{ROBOT}/lease", {"action": "hand_over"}, "403 grant_missing"),
    "a release": ("POST", f"/robots/{ROBOT}/release", None, "403 grant_missing"),
    "to stop another robot": ("POST", f"/robots/{OTHER}/stop", {}, "404 robot_unknown"),
    "who drives another": ("GET", f"/robots/{OTHER}/control", None, "404 robot_unknown"),
    "to stop all": ("POST", "/stop", {}, "403 grant_missing"),
    "to stop a site": ("POST", "/stop", {"site": "lab"}, "403 grant_missing"),
    "other settings": ("PATCH", f"/robots/{ROBOT}", {"settings": {}}, "403 grant_missing"),
    "more rights": ("PUT", f"/grants/attacker-ben/{ROBOT}", {"level": "manage"}, "403 grant_missing"),
    "a group of its own": ("POST", "/groups", {"name": "mine"}, "403 grant_missing"),
    "the users": ("GET", "/users", None, "403 grant_missing"),
    "the audit log": ("GET", "/audit", None, "403 grant_missing"),
    "a join token": ("POST", "/join-tokens", {"name": "x", "uses": 1, "hours": 1}, "403 grant_missing"),
    "another key for the robot": ("POST", f"/robots/{ROBOT}/rekey", None, "403 grant_missing"),
}  # fmt: skip


@pytest.mark.parametrize("attempt", OBSERVER_ASKS)
def test_an_observer_gets_no_more(ben: Person, attempt: str) -> None:
    """The API refuses with the same words whatever the way."""
    method, path, body, expected = OBSERVER_ASKS[attempt]
    assert ben.ask(method, "/api/v1" + path, body).said == expected


def test_an_observer_sees_no_other_robot(ben: Person) -> None:
    """Neither its video nor its name."""
    path = f"/robots/{OTHER}/video/stream?topic=/camera/image_raw"
    assert raw(ben.stack, "GET", path, headers=ben.bearer).said == "404 robot_unknown"
    listed = ben.ask("GET", "/api/v1/robots")
    assert [robot["name"] for robot in json.loads(listed.body)["robots"]] == [ROBOT]


def test_an_observer_stops_and_only_a_driver_releases(ann: Person, ben: Person) -> None:
    """Everybody who sees the robot may stop it; a stopped one takes no driver, and no observer's release."""
    try:
        assert ben.ask("POST", f"/api/v1/robots/{ROBOT}/stop", {"reason": "test"}).code == OPEN
        assert ben.ask("POST", f"/api/v1/robots/{ROBOT}/release").said == "403 grant_missing"
        control = json.loads(ben.ask("GET", f"/api/v1/robots/{ROBOT}/control").body)
        assert control["stopped"]["by"] == "attacker-ben"
        assert ann.ask("POST", f"/api/v1/robots/{ROBOT}/release").code == OPEN
    finally:
        # A robot that stays stopped would fail all that come after this test.
        release_all(ann.stack, [ROBOT])


# Method, path, headers beside the driver's cookie, body.
Sent = tuple[str, str, dict[str, str], object]
STOP, LEASE = f"{API}/robots/{ROBOT}/stop", f"{API}/robots/{ROBOT}/lease"
VIDEO = f"/robots/{ROBOT}/video/stream?topic=/camera/image_raw"
FROM_ELSEWHERE = {"Origin": ELSEWHERE}
PAGES: dict[str, tuple[Sent, str]] = {
    "events": (("GET", f"{API}/events", FROM_ELSEWHERE, None), "403 origin_refused"),
    "video": (("GET", VIDEO, FROM_ELSEWHERE, None), "403 origin_refused"),
    "video as a script": (("GET", VIDEO, {"Sec-Fetch-Dest": "script"}, None), "403 destination_refused"),
    "stop": (("POST", STOP, FROM_ELSEWHERE, {}), "403 origin_refused"),
    "stop from a sandbox": (("POST", STOP, {"Origin": "null"}, {}), "403 origin_refused"),
    "stop with a token of its own": (
        ("POST", STOP, {**FROM_ELSEWHERE, "X-CSRFToken": "x"}, {}), "403 origin_refused",
    ),
    "stop as text": (("POST", STOP, {**FROM_ELSEWHERE, "Content-Type": "text/plain"}, {}), "403 origin_refused"),
    "stop without an origin": (("POST", STOP, {}, {}), "403 csrf_refused"),
    "stop all": (("POST", f"{API}/stop", FROM_ELSEWHERE, {}), "403 origin_refused"),
    "release": (("POST", f"{API}/robots/{ROBOT}/release", FROM_ELSEWHERE, None), "403 origin_refused"),
    "ask for control": (("POST", LEASE, FROM_ELSEWHERE, {"action": "ask"}), "403 origin_refused"),
    "take without an origin": (("POST", LEASE, {}, {"action": "take"}), "403 csrf_refused"),
    "ticket": (("POST", f"{API}/tickets", {}, {"robot": ROBOT, "mode": "drive"}), "403 csrf_refused"),
    "ticket with a token of its own": (
        ("POST", f"{API}/tickets", {"X-CSRFToken": "x"}, {"robot": ROBOT, "mode": "drive"}), "403 csrf_refused",
    ),
    "key for a shell": (
        ("POST", f"{API}/me/ssh-keys", {}, {"name": "x", "public_key": "ssh-ed25519 AAAA"}), "403 csrf_refused",
    ),
    "token": (("POST", f"{API}/tokens", {}, {"name": "x"}), "403 csrf_refused"),
    "rosbridge with the cookie alone": (("GET", f"/robots/{ROBOT}/ros", UPGRADE, None), "401 ticket_missing"),
}  # fmt: skip


@pytest.mark.parametrize("attempt", PAGES)
def test_a_page_elsewhere_acts_for_nobody(stack: Stack, ann: Person, attempt: str) -> None:
    """The browser adds the driver's cookie; it is not enough, and no answer may be read elsewhere."""
    (method, path, headers, body), expected = PAGES[attempt]
    answer = raw(stack, method, path, headers={**ann.cookie, **headers}, body=body)
    assert answer.said == expected
    assert not any(name.lower().startswith("access-control-") for name in answer.headers)


@pytest.mark.parametrize(
    "origin",
    [ELSEWHERE, "null", "http://localhost:PORT", "https://localhost:PORT.evil.example", "https://localhost",
     "https://evil.example/https://localhost:PORT", "https://localhost:PORT@evil.example"],
)  # fmt: skip
def test_a_good_ticket_opens_nothing_elsewhere(stack: Stack, ann: Person, origin: str) -> None:
    """A page that got hold of a ticket has an origin that gives it away; the ticket stays good."""
    ticket = ann.ticket(ROBOT, "observe")
    origin = origin.replace("PORT", str(stack.https_port))
    assert open_ros(stack, ROBOT, ticket, Origin=origin).said == "403 origin_refused"
    assert open_ros(stack, ROBOT, ticket, Origin=stack.url).code == OPEN


def test_no_browser_is_told_that_it_may(stack: Stack, ann: Person) -> None:
    """The question before a request with a header of its own gets no leave."""
    asks = {
        **FROM_ELSEWHERE,
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "x-csrftoken,content-type",
    }
    for path in (STOP, LEASE, f"{API}/tickets", f"{API}/stop"):
        answer = raw(stack, "OPTIONS", path, headers={**ann.cookie, **asks})
        assert not any(name.lower().startswith("access-control-") for name in answer.headers)
