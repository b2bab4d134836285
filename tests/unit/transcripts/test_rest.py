"""The REST API as its clients see it: every path under /api/v1, web's and the relay's, with typical refusals."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import tls_front
from drive_records import add_drive
from drive_settings import DOCK
from relay_server import ANN, BEN, BOB, CARL, EVE, until
from robot_signer import RobotSigner
from robotether_server.db import users
from robotether_server.settings.server import SiteAddressSettings
from robotether_server.web import create_app
from transcripts import Transcript, problem_line
from web_visitor import HASH, Browser, bearer, web_settings_of, write_host_key

HERE = Path(__file__).parent
API = "/api/v1"
# Sent with many answers and the same on each: `test_who_asks` records all of them once.
SHOWN_HEADERS = ("Allow", "Content-Disposition", "Location", "Retry-After", "WWW-Authenticate")
MEASURED_TIMES = (
    "age_s",
    "offer_left_s",
    "wrap_up_left_s",
    "waiting_p50_s",
    "waiting_p95_s",
    "oldest_open_s",
)
# Given one time and random.
SECRETS = ("password", "ticket", "token")
ROBOTS = [RobotSigner(number) for number in range(4)]
KEYS = [robot.line for robot in ROBOTS]
NOBODY = 999_999_999


class Conversation:
    """Asks web as several users, and writes down what is asked and answered."""

    def __init__(self, visitor, database):
        self.transcript = Transcript(measured=["id", *MEASURED_TIMES])
        self.visitor = visitor
        self.headers = {name: bearer(database, name) for name in ("root", "ann", "olga")}

    def ask(self, who, method, path, body=None, **numbers):
        """Send a request; `numbers` are put into the path and not written down."""
        sent = {} if body is None else {"json": body}
        self.note(who, method, path, body)
        headers = self.headers.get(who, {})
        answer = self.visitor.ask(method, API + path.format(**numbers), headers=headers, **sent)
        self.answered(answer, shown_headers(answer))
        return answer.json

    def note(self, who, method, path, body=None):
        if body and "signature" in body:
            self.transcript.name(body["signature"], "signature")
        self.transcript.add(f"> {who}: {method} {API}{path}", *([] if body is None else [body]))

    def answered(self, answer, shown):
        add_answer(self.transcript, answer.status_code, answer.content_type, shown, answer.text)


def shown_headers(answer):
    return {name: answer.headers[name] for name in SHOWN_HEADERS if name in answer.headers}


def add_answer(transcript, status, kind, shown, text):
    """Add an answer of web or of the relay, with the headers that are shown."""
    body = [text.rstrip()] if text else []
    if "Allow" in shown:  # a set, in any order
        shown["Allow"] = ", ".join(sorted(shown["Allow"].split(", ")))
    # The database counts on from one test to the next.
    text = re.sub(r"\b(request|route) \d+", r"\1 <id>", text)
    heading, plain_kind = f"< {status} {kind}", kind.partition(";")[0]
    if plain_kind == "application/problem+json":
        body = [problem_line(status, json.loads(text))]
    elif plain_kind == "application/json":
        said = json.loads(text)
        for name in SECRETS:
            if isinstance(said.get(name), str):
                transcript.name(said[name], name)
        for pin in re.findall(r"sha256//([A-Za-z0-9+/=]{44})", text):
            transcript.name(pin, "pin")
        as_before, changes = transcript.changes(said)
        heading, body = heading + as_before, [changes]
    transcript.add(heading, *[f"{k}: {v}" for k, v in shown.items()], *body)


@pytest.fixture
def talk(mariadb, database, tmp_path):
    """Web's pages and API: root is admin, ann and olga are users, and no robot is known."""
    write_host_key(tmp_path)
    with database.transaction() as tx:
        users.add(tx, "root", HASH, "admin")
        users.add(tx, "ann", HASH, "user")
        users.add(tx, "olga", HASH, "user")
    with tls_front.running(tmp_path) as front:
        settings = replace(
            web_settings_of(mariadb.settings("web"), tmp_path),
            site_address=SiteAddressSettings(None, 443, front.endpoint),
            allowed_origins=("https://lab.example",),
        )
        yield Conversation(Browser(create_app(settings).test_client()), database)


@pytest.fixture
def sim1(talk):
    """Robot sim1, which ann drives and olga manages, and sim2, which neither may see."""
    begun, talk.transcript = talk.transcript, Transcript()
    for number, name in enumerate(("sim1", "sim2"), 1):
        body = {"mac": f"02:00:00:00:51:0{number}", "public_key": KEYS[number]}
        talk.ask("root", "PUT", f"/robots/{name}", body)
    talk.ask("root", "PUT", "/grants/ann/sim1", {"level": "drive"})
    talk.ask("root", "PUT", "/grants/olga/sim1", {"level": "manage"})
    talk.transcript = begun


def test_who_asks(talk, recorded):
    """Credentials, headers of answers to this and to other sites, and what no path takes.

    All headers of the first answer stand there, and of later ones those that are others.
    """
    for header in ("Bearer rt_wrong", "Basic YTpi"):
        talk.note(header, "GET", "/me")
        answer = talk.visitor.ask("GET", f"{API}/me", headers={"Authorization": header})
        talk.answered(answer, {})
    talk.ask("ann", "GET", "/me")
    talk.ask("root", "GET", "/me")
    first = {}
    origins = ("https://lab.example", "https://other.example")
    asks = {"Access-Control-Request-Method": "POST"}
    for what, method, sent in (
        ("ann", "GET", talk.headers["ann"]),
        ("nobody", "GET", {}),
        ("a page of an allowed site", "OPTIONS", {"Origin": origins[0]} | asks),
        ("ann's page of an allowed site", "GET", {"Origin": origins[0]} | talk.headers["ann"]),
        ("ann's page of another site", "GET", {"Origin": origins[1]} | talk.headers["ann"]),
    ):
        talk.note(what, method, "/robots")
        answer = talk.visitor.ask(method, f"{API}/robots", headers=sent)
        headers = dict(sorted(answer.headers.items()))
        shown = {name: value for name, value in headers.items() if first.get(name) != value}
        shown |= {name: "<none>" for name in first if name not in headers}
        first = first or headers
        talk.answered(answer, shown)
    talk.visitor.log_in("ann")
    talk.ask("login of ann", "GET", "/me")
    talk.ask("login of ann, without the page's token", "POST", "/tokens", {"name": "laptop"})
    talk.ask("ann", "GET", "/nothing")
    talk.ask("ann", "DELETE", "/me")
    talk.ask("ann", "POST", "/tokens", [1])
    talk.note("ann", "POST", "/tokens", "no JSON")
    broken = {"Content-Type": "application/json"} | talk.headers["ann"]
    answer = talk.visitor.ask("POST", f"{API}/tokens", headers=broken, data="no JSON")
    talk.answered(answer, {})
    assert talk.transcript == recorded


def test_people(talk, recorded):
    talk.ask("ann", "GET", "/users")
    talk.ask("root", "GET", "/users")
    talk.ask("root", "POST", "/users", {"name": "ben", "role": "user"})
    talk.ask("root", "POST", "/users", {"name": "ben", "role": "user"})
    talk.ask("root", "POST", "/users", {"name": "eve", "role": "king"})
    talk.ask("root", "POST", "/users", {"name": "eve", "role": "user", "password": "short"})
    talk.ask("root", "POST", "/users", {"name": 7, "role": "user"})
    talk.ask("root", "POST", "/users", {"name": "eve", "role": "user", "age": 7})
    talk.ask("root", "GET", "/users/ben")
    talk.ask("root", "PATCH", "/users/ben", {"role": "admin", "disabled": True})
    talk.ask("root", "PATCH", "/users/ben", {})
    talk.ask("root", "PATCH", "/users/root", {"role": "user"})
    talk.ask("root", "DELETE", "/users/ben/logins")
    talk.ask("root", "POST", "/groups", {"name": "lab"})
    talk.ask("root", "POST", "/groups", {"name": "lab"})
    talk.ask("root", "PUT", "/groups/lab/members/ann")
    talk.ask("root", "PUT", "/groups/lab/members/nobody")
    talk.ask("root", "GET", "/groups")
    talk.ask("root", "GET", "/groups/lab")
    talk.ask("root", "DELETE", "/groups/lab/members/ann")
    talk.ask("root", "DELETE", "/groups/lab")
    talk.ask("root", "DELETE", "/groups/lab")
    talk.ask("root", "DELETE", "/users/ben")
    talk.ask("ann", "POST", "/tokens", {"name": "laptop", "days": 30})
    talk.visitor.log_in("ann")
    talk.headers["login of ann"] = {"X-CSRFToken": talk.visitor.csrf_of("/profile")}
    made = talk.ask("login of ann", "POST", "/tokens", {"name": "laptop", "days": 30})["id"]
    talk.ask("login of ann", "POST", "/tokens", {"name": "x", "days": 0})
    talk.ask("login of ann", "POST", "/tokens", {"name": "x", "user": "root"})
    talk.ask("ann", "GET", "/tokens")
    talk.ask("ann", "DELETE", f"/tokens/{NOBODY}")
    talk.ask("ann", "DELETE", "/tokens/{token_id}", token_id=made)
    made = talk.ask("ann", "POST", "/me/ssh-keys", {"name": "laptop", "public_key": KEYS[0]})["id"]
    talk.ask("ann", "POST", "/me/ssh-keys", {"name": "laptop", "public_key": "wrong"})
    talk.ask("ann", "GET", "/me/ssh-keys")
    talk.ask("ann", "DELETE", "/me/ssh-keys/{key_id}", key_id=made)
    assert talk.transcript == recorded


def test_grants(talk, sim1, recorded):
    talk.ask("root", "POST", "/sites", {"name": "lab"})
    talk.ask("root", "POST", "/sites", {"name": ""})
    talk.ask("root", "PATCH", "/robots/sim2", {"site": "lab"})
    talk.ask("root", "PATCH", "/robots/sim2", {"site": "nowhere"})
    talk.ask("root", "GET", "/sites")
    talk.ask("root", "GET", "/sites/lab")
    soon = (datetime.now(UTC) + timedelta(days=30)).strftime("%Y-%m-%dT%H:%M:%SZ")
    body = {"user": "ann", "site": "lab", "level": "observe"}
    made = talk.ask("root", "POST", "/grants", body)["id"]
    talk.ask("root", "POST", "/grants", body | {"level": "drive"})
    whole = {"user": "olga", "all": True, "level": "observe", "ends_at": soon}
    talk.ask("root", "POST", "/grants", whole)
    talk.ask("root", "POST", "/grants", body | {"group": "lab"})
    talk.ask("root", "POST", "/grants", body | {"level": "own"})
    talk.ask("root", "POST", "/grants", body | {"ends_at": "tomorrow"})
    of_another = {"user": "ann", "robot": "sim2", "mac": "02:00:00:00:51:99", "level": "drive"}
    talk.ask("root", "POST", "/grants", of_another)
    talk.ask("root", "POST", "/grants", body | {"mac": of_another["mac"]})
    talk.ask("ann", "GET", "/grants")
    talk.ask("root", "GET", "/grants")
    talk.ask("root", "DELETE", "/grants/{grant_id}", grant_id=made)
    talk.ask("root", "DELETE", f"/grants/{NOBODY}")
    talk.ask("root", "DELETE", "/sites/lab")
    talk.ask("root", "PUT", "/grants/ann/sim2", {"level": "manage"})
    talk.ask("root", "PUT", "/grants/ann/nowhere", {"level": "manage"})
    talk.ask("root", "DELETE", "/grants/ann/sim2")
    talk.ask("root", "DELETE", "/grants/ann/sim2")
    assert talk.transcript == recorded


def test_robots(talk, sim1, admin_database, recorded):
    """Robots as users see them and as admins change them, their pages, and tickets to connect to them."""
    for who in ("nobody", "ann"):
        talk.ask(who, "GET", "/robots")
    talk.ask("ann", "GET", "/robots/sim2")
    for mode in ("drive", "manage"):
        talk.ask("ann", "POST", "/tickets", {"robot": "sim1", "mode": mode})
    talk.ask("ann", "POST", "/tickets", {"robot": "sim2", "mode": "observe"})
    talk.ask("ann", "POST", "/tickets/app", {"app": "joy"})
    talk.ask("ann", "POST", "/tickets/app", {"app": "<b>"})
    new = {"mac": "02:00:00:00:51:03", "public_key": KEYS[3], "hostname": "turtle"}
    talk.ask("ann", "PUT", "/robots/sim3", new)
    talk.ask("root", "PUT", "/robots/sim3", new | {"agent_version": "0.1.0"})
    talk.ask("root", "PUT", "/robots/sim4", new)
    for change in (
        {"name": "turtle", "state": "disabled", "settings": {"guard": {"max_age_ms": 400}}},
        {"name": "sim1"},
        {"state": "lost"},
        {"settings": {"guard": {"max_age_ms": "long"}}},
        {"settings": {"colour": "red"}},
        {},
    ):
        talk.ask("root", "PATCH", "/robots/sim3", change)
        if change.get("name") == "turtle":
            talk.ask("root", "PATCH", "/robots/turtle", {"name": "sim3"})
    talk.ask("root", "DELETE", "/robots/sim3")
    with admin_database.transaction() as tx:
        tx.insert(
            "INSERT INTO robot_sessions (robot_id, address, agent_version, started_at, ended_at, end_code) "
            "SELECT id, '198.51.100.7', '0.1.0', '2026-01-31 12:00:00', '2026-01-31 12:10:00', 'timeout' "
            "FROM robots WHERE name = 'sim1'"
        )
    talk.ask("root", "GET", "/robots/sim1/sessions?limit=5")
    policy = {"drive": {"call": ["/dock"]}}
    talk.ask("root", "PATCH", "/robots/sim1", {"shell": True, "settings": {"policy": policy}})
    talk.ask("olga", "GET", "/ssh-config")
    talk.ask("ann", "PUT", "/robots/sim1/page", {})
    talk.ask("olga", "PUT", "/robots/sim1/page", {})
    talk.ask("olga", "PUT", "/robots/sim1/page", {"colour": "red"})
    talk.ask("olga", "PUT", "/robots/sim1/buttons", {"buttons": [DOCK]})
    talk.ask("olga", "PUT", "/robots/sim1/buttons", {"buttons": [{"label": 7}]})
    assert talk.transcript == recorded


def test_enrolment(talk, sim1, recorded):
    """Joining, join tokens, and what admins do about waiting and rejected keys and about ports."""
    mac, other_mac = "02:00:00:00:52:01", "02:00:00:00:52:02"
    name = talk.ask("nobody", "POST", "/join", ROBOTS[3].join(mac))["robot"]
    talk.ask("nobody", "POST", "/join", ROBOTS[1].join(mac))
    talk.ask("nobody", "GET", "/ssh")
    waiting = talk.ask("root", "GET", "/pending")["pending"]
    key = {"fingerprint": waiting[0]["fingerprint"]}
    talk.ask("root", "POST", f"/robots/{name}/approve", {"fingerprint": "SHA256:wrong"})
    talk.ask("root", "POST", f"/robots/{name}/approve", key)
    talk.ask("nobody", "POST", "/join", ROBOTS[3].join(mac))
    for action in ("rotate-key", "move-ports", "rekey"):
        talk.ask("root", "POST", f"/robots/sim1/{action}")
    name = talk.ask("nobody", "POST", "/join", ROBOTS[0].join(other_mac))["robot"]
    waiting = talk.ask("root", "GET", "/pending")["pending"]
    for key in [item["fingerprint"] for item in waiting if item["robot"] == name]:
        talk.ask("root", "POST", f"/robots/{name}/reject", {"fingerprint": key})
    talk.ask("nobody", "POST", "/join", ROBOTS[0].join(other_mac))
    rejected = talk.ask("root", "GET", "/rejected-keys")["rejected_keys"]
    talk.ask("root", "DELETE", "/rejected-keys/{key_id}", key_id=rejected[0]["id"])
    token = talk.ask("root", "POST", "/join-tokens", {"name": "lab", "uses": 2, "hours": 24})
    talk.ask("nobody", "POST", "/join", ROBOTS[0].join(other_mac, token["token"]))
    talk.ask("root", "GET", "/join-tokens")
    talk.ask("root", "DELETE", "/join-tokens/{token_id}", token_id=token["id"])
    assert talk.transcript == recorded


def test_history(talk, sim1, admin_database, recorded):
    """Drives and the audit log, in each format."""
    add_drive(admin_database, "sim1", "ann", id=4242)
    for path in ("/drives?format=csv", "/drives?format=jsonl"):
        talk.ask("ann", "GET", path)
    talk.ask("ann", "GET", "/drives/4242")
    talk.ask("ann", "GET", f"/drives/{NOBODY}")
    talk.ask("ann", "GET", "/audit")
    for path in ("/audit?limit=1", "/audit?colour=red"):
        talk.ask("root", "GET", path)
    for name in ("ann", "olga"):
        talk.ask(name, "GET", "/robots/sim1/controller?at=2020-01-01T00:00:00Z")
    assert talk.transcript == recorded


@pytest.mark.usefixtures("sim1")
def test_recordings(talk, recorded):
    """A recording that ann asks for, and that olga, who manages the robot, deletes."""
    talk.ask("ann", "POST", "/robots/sim2/recordings")
    number = talk.ask("ann", "POST", "/robots/sim1/recordings")["id"]
    talk.ask("ann", "POST", "/robots/sim1/recordings")
    talk.ask("ann", "GET", "/recordings?robot=sim1")
    talk.ask("ann", "GET", "/recordings/{number}", number=number)
    talk.ask("ann", "POST", "/recordings/{number}/stop", number=number)
    talk.ask("olga", "GET", "/recordings/{number}/file", number=number)
    talk.ask("ann", "DELETE", f"/recordings/{NOBODY}")
    talk.ask("olga", "DELETE", "/recordings/{number}", number=number)
    assert talk.transcript == recorded


def test_metrics(talk, recorded):
    """Admins alone are led to the relay's numbers, and get web's and how the site is."""
    talk.ask("root", "GET", "/metrics")
    for path in ("/metrics", "/metrics/web", "/health", "/health/history"):
        talk.ask("ann", "GET", path)
    talk.ask("root", "GET", "/health/history?range=year")
    assert talk.transcript == recorded


def test_routes(talk, sim1, recorded):
    """Routes of an admin, who manages all robots, and what others may not."""
    route = {
        "source": "sim1",
        "source_topic": "/cmd_vel",
        "target": "sim2",
        "target_topic": "cmd_vel",
        "type": "a/B",
    }
    made = talk.ask("root", "POST", "/routes", route)["id"]
    talk.ask("ann", "POST", "/routes", route)
    talk.ask("ann", "POST", "/routes", route | {"source": "app:joy"})
    talk.ask("root", "POST", "/routes", route | {"source": "app:joy"})
    talk.ask("ann", "GET", "/routes")
    talk.ask("root", "GET", "/routes")
    talk.ask("ann", "DELETE", "/routes/{route_id}", route_id=made)
    talk.ask("root", "DELETE", "/routes/{route_id}", route_id=made)
    assert talk.transcript == recorded


def test_requests(talk, sim1, recorded):
    """A request that ann asks for, declines, is assigned and answers; and one that olga, a manager, cancels."""
    talk.ask("root", "PUT", "/users/ann/pools", {"pools": ["night", "arms"]})
    talk.ask("root", "GET", "/users/ann/pools")
    asked = {"reason": "stuck at the gate", "priority": 1, "pool": "night"}
    number = talk.ask("ann", "POST", "/robots/sim1/requests", asked)["id"]
    talk.ask("ann", "POST", "/robots/sim1/requests", asked | {"reason": ""})
    talk.ask("ann", "POST", "/robots/sim2/requests", asked)
    talk.ask("ann", "PUT", "/queue/me", {"state": "available"})
    talk.ask("olga", "POST", "/requests/{number}/accept", number=number)
    talk.ask("ann", "POST", "/requests/{number}/decline", number=number)
    talk.ask("ann", "POST", "/requests/{number}/assign", {"user": "ann"}, number=number)
    talk.ask("olga", "POST", "/requests/{number}/assign", {"user": "ann"}, number=number)
    talk.ask("ann", "POST", "/requests/{number}/accept", number=number)
    talk.ask("olga", "GET", "/operators")
    talk.ask("ann", "GET", "/operators")
    talk.ask("ann", "POST", "/requests/{number}/close", {"note": "pushed it"}, number=number)
    talk.ask("ann", "GET", "/requests?state=closed&robot=sim1")
    other = talk.ask("ann", "POST", "/robots/sim1/requests", {"reason": "stuck again"})["id"]
    talk.ask("olga", "POST", "/requests/{other}/cancel", other=other)
    talk.ask("ann", "GET", "/requests")
    talk.ask("ann", "GET", "/requests/figures?hours=1")
    talk.ask("ann", "GET", "/requests/periods?by=week")
    assert talk.transcript == recorded


async def test_relay(world, recorded):
    """Stop, release, lease, topics, services, and the events of the fleet."""
    server, transcript = world.relay, Transcript(measured=["rtt_ms"])
    headers = {user.name: world.database.bearer(user) for user in (ANN, BEN, BOB, CARL, EVE)}

    async def ask(who, method, path, body=None):
        transcript.add(f"> {who}: {method} {API}{path}", *([] if body is None else [body]))
        options = {"headers": headers.get(who, {})} | ({} if body is None else {"json": body})
        async with world.http.request(method, server.url + API + path, **options) as answer:
            kind, text = answer.headers["Content-Type"], await answer.text()
            add_answer(transcript, answer.status, kind, shown_headers(answer), text)

    await _refusals(ask)
    robot = await world.robot()
    await until(lambda: _is_well(server, world.sim1.id), "sim1 is well")
    transcript.add(f"> bob: GET {API}/events")
    async with world.http.get(f"{server.url}{API}/events", headers=headers["bob"]) as answer:
        transcript.add(*await _first_event(answer))
    await _stops(ask)
    async with world.connect() as socket:
        await until(lambda: server.relay.control.driver(world.sim1.id), "ann drives")
        robot.has_topics = False
        await ask("bob", "GET", "/robots/sim1/topics/%2Fodom")
        await ask("carl", "GET", "/robots/sim1/topics/odom?since=")
        await ask("carl", "POST", "/robots/sim1/services/move?timeout_s=9", {"x": 1})
        await _lease(ask)
        await socket.close()
    assert transcript == recorded


async def _first_event(answer):
    event = (await answer.content.readuntil(b"\n\n")).decode().strip()
    name, data = event.split("\ndata: ")
    kind = answer.headers["Content-Type"]
    return f"< {answer.status} {kind}", name, "data:", json.loads(data)


def _is_well(server, robot_id):
    presence = server.relay.registry.presence(robot_id)
    states = (presence.guard, presence.ros, presence.video)
    is_well = states == ("ready", "ok", "ok") and presence.rtt_ms is not None
    return is_well and server.relay.control.describe(robot_id).stopped.confirmed


async def _refusals(ask):
    """While the robot is offline."""
    for who in ("nobody", "eve", "ann"):
        await ask(who, "GET", "/robots/sim1/control")
        await ask(who, "GET", "/robots/sim1/uplink")
        await ask(who, "GET", "/robots/sim1/topics/odom")
        await ask(who, "POST", "/robots/sim1/services/move", {})
    await ask("nobody", "GET", "/events")
    for who in ("nobody", "ann"):
        await ask(who, "GET", "/routes/live")
    await ask("eve", "POST", "/robots/sim1/stop")
    await ask("ann", "GET", "/robots/sim1/stop")
    await ask("ann", "POST", "/robots/sim1/stop", [])
    await ask("ann", "POST", "/robots/sim1/stop", {"reason": 7})
    await ask("ann", "POST", "/robots/sim1/stop", {"reason": "smoke"})
    await ask("ann", "POST", "/robots/sim1/release")


async def _stops(ask):
    await ask("bob", "POST", "/robots/sim1/release")
    await ask("ann", "POST", "/robots/sim1/release", {"by": "eve"})
    await ask("ann", "POST", "/robots/sim1/release", {"by": "eve", "at": "2026-01-31T12:00:00Z"})
    await ask("ann", "POST", "/robots/sim1/release")
    await ask("bob", "POST", "/robots/sim1/stop")
    await ask("bob", "GET", "/robots/sim1/control")
    await ask("bob", "GET", "/robots/sim1/uplink")
    await ask("ann", "POST", "/robots/sim1/release")
    await ask("carl", "POST", "/stop", {"site": "nowhere"})
    await ask("carl", "POST", "/stop", {"reason": "fire"})
    await ask("carl", "POST", "/robots/sim1/release")
    await ask("ann", "POST", "/robots/sim1/lease", {"action": "ask"})


async def _lease(ask):
    lease = "/robots/sim1/lease"
    for who, action in (
        ("bob", "ask"),
        ("ben", "take"),
        ("ben", "ask"),
        ("carl", "ask"),
        ("ben", "hand_over"),
        ("ann", "refuse"),
        ("ben", "withdraw"),
        ("ben", "own"),
        ("ben", "ask"),
        ("ann", "hand_over"),
    ):
        await ask(who, "POST", lease, {"action": action})


def test_every_path_is_recorded(talk):
    """Each method of each path of the description stands in a transcript."""
    described = talk.visitor.ask("GET", f"{API}/openapi.json").json["paths"]
    files = (HERE / "__snapshots__" / "test_rest").glob("*.txt")
    asked = re.findall(
        r"^> .*?: ([A-Z]+) ([^\s?]+)", "\n".join(file.read_text() for file in files), re.MULTILINE
    )
    missing = [
        f"{method.upper()} {path}"
        for path, methods in described.items()
        for method in {"get", "put", "post", "patch", "delete"} & methods.keys()
        if not any(
            method.upper() == verb and re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", path), given)
            for verb, given in asked
        )
    ]
    assert missing == [f"GET {API}/openapi.json"]
