"""What happened, as admins read it."""

import csv
import io
import json
import re
from http import HTTPStatus
from urllib.parse import quote

import pytest
from api_visitor import Program, in_person, new_public_key
from drive_settings import DOCK
from robot_signer import RobotSigner


def test_events_are_chosen_and_paged(root):
    """Sim1 gets a shell, sim2 gets one, sim1 loses it; the newest first."""
    for robot, shell in (("sim1", True), ("sim2", True), ("sim1", False)):
        root.ask("PATCH", f"/robots/{robot}", {"shell": shell})
    events = root.get("/audit")["events"]
    assert root.get("/audit?robot=sim1&actor=root")["events"] == [events[0], events[2]]
    assert root.get(f"/audit?kind={events[0]['kind']}&robot=sim2&actor=ann")["events"] == []
    assert root.get("/audit?limit=2")["events"] == events[:2]
    assert root.get(f"/audit?before={events[1]['id']}")["events"] == [events[2]]
    assert len(root.get("/audit?since=2020-01-01T00:00:00Z")["events"]) >= len(events)
    assert root.get("/audit?until=2020-01-01T00:00:00Z")["events"] == []
    assert root.get("/audit?since=2100-01-01T01:00:00%2B01:00")["events"] == []
    for wrong in ("since=2026-01-31", "limit=0", "kind=robot_shell", "kind=x&format=csv"):
        assert root.refused("GET", f"/audit?{wrong}") == (422, "field_invalid")
    lines = root.ask("GET", "/audit?format=jsonl").text.splitlines()
    assert [json.loads(text) for text in lines] == events
    text = root.ask("GET", f"/audit?format=csv&before={events[0]['id']}&robot=sim1").text
    [row] = csv.DictReader(io.StringIO(text))
    assert json.loads(row["details"]) == events[2]["details"]
    assert root.refused("GET", "/audit?format=pdf") == (422, "field_invalid")


KEY, OTHER_ROBOT, REJECTED_ROBOT = new_public_key(), RobotSigner(), RobotSigner()
MAC = "00:1b:44:11:3a:b7"
PASSWORD = "a password that nobody shall read"
# A ticket changes nothing; what it opens the relay writes down, and what becomes of a recording the recorder does. Who
# deletes one is in test_recordings.py. What a heartbeat of the queue makes the planner do is the planner's.
NO_CHANGE = {
    ("POST", "/tickets"),
    ("POST", "/tickets/app"),
    ("PUT", "/queue/me"),
    ("POST", "/robots/sim9/recordings"),
    ("POST", "/recordings/{recording_id}/stop"),
    ("DELETE", "/recordings/{recording_id}"),
}
# Where the newest number of each kind is found.
LISTS = {
    "grants": "/grants",
    "tokens": "/tokens",
    "join_tokens": "/join-tokens",
    "ssh_keys": "/me/ssh-keys",
    "rejected_keys": "/rejected-keys",
    "requests": "/requests",
    "routes": "/routes",
}


def finger(robot):
    return {"fingerprint": robot.key.fingerprint}


# Every change that the API can make, one after the other: method, path, body, kind of the line that it leaves.
ZOE = {"name": "zoe", "role": "user", "password": PASSWORD}
POLICY = {"policy": {"drive": {"call": ["/dock"]}}}
ROUTE = {
    "source": "sim9",
    "source_topic": "/odom",
    "target": "sim1",
    "target_topic": "/odom",
    "type": "nav_msgs/Odometry",
}
STEPS = (
    ("POST", "/users", ZOE, "user_added"),
    ("PATCH", "/users/zoe", {"role": "admin"}, "user_role_set"),
    ("PATCH", "/users/zoe", {"disabled": True}, "user_disabled"),
    ("PATCH", "/users/zoe", {"password": PASSWORD}, "password_set"),
    ("PUT", "/users/zoe/pools", {"pools": ["night"]}, "user_pools_set"),
    ("DELETE", "/users/zoe/logins", None, "logins_ended"),
    ("POST", "/groups", {"name": "crew"}, "group_added"),
    ("PUT", "/groups/crew/members/zoe", None, "group_member_added"),
    ("POST", "/sites", {"name": "lab"}, "site_added"),
    ("PATCH", "/robots/sim2", {"site": "lab"}, "robot_site_set"),
    ("PATCH", "/robots/sim2", {"site": None}, "robot_site_set"),
    ("PATCH", "/robots/sim2", {"name": "sim9"}, "robot_renamed"),
    ("PATCH", "/robots/sim9", {"mac": "00:1b:44:11:3a:b9"}, "robot_mac_set"),
    ("PATCH", "/robots/sim9", {"state": "disabled"}, "robot_disabled"),
    ("PATCH", "/robots/sim9", {"state": "active"}, "robot_enabled"),
    ("POST", "/routes", ROUTE, "route_made"),
    ("DELETE", "/routes/{routes}", None, "route_removed"),
    ("PATCH", "/robots/sim9", {"shell": True}, "robot_shell_set"),
    ("PATCH", "/robots/sim9", {"settings": POLICY}, "robot_settings_set"),
    ("PUT", "/robots/sim9/page", {"fps": 10}, "robot_page_set"),
    ("PUT", "/robots/sim9/buttons", {"buttons": [DOCK]}, "robot_buttons_set"),
    ("POST", "/grants", {"group": "crew", "site": "lab", "level": "drive"}, "grant_given"),
    ("DELETE", "/grants/{grants}", None, "grant_taken"),
    ("PUT", "/grants/zoe/sim1", {"level": "drive"}, "grant_given"),
    ("DELETE", "/grants/zoe/sim1", None, "grant_taken"),
    ("DELETE", "/groups/crew/members/zoe", None, "group_member_removed"),
    ("DELETE", "/groups/crew", None, "group_removed"),
    ("DELETE", "/sites/lab", None, "site_removed"),
    ("POST", "/tokens", {"name": "script"}, "token_created"),
    ("DELETE", "/tokens/{tokens}", None, "token_deleted"),
    ("POST", "/join-tokens", {"name": "line", "uses": 1, "hours": 1}, "join_token_created"),
    ("DELETE", "/join-tokens/{join_tokens}", None, "join_token_deleted"),
    ("POST", "/me/ssh-keys", {"name": "desk", "public_key": KEY}, "ssh_key_added"),
    ("DELETE", "/me/ssh-keys/{ssh_keys}", None, "ssh_key_deleted"),
    ("PUT", "/robots/turtle", {"mac": MAC, "public_key": KEY}, "robot_approved"),
    ("POST", "/robots/turtle/requests", {"reason": "stuck"}, "request_made"),
    ("POST", "/requests/{requests}/assign", {"user": "root"}, "request_assigned"),
    ("POST", "/requests/{requests}/decline", None, "request_declined"),
    ("POST", "/requests/{requests}/assign", {"user": "root"}, "request_assigned"),
    ("POST", "/requests/{requests}/accept", None, "request_accepted"),
    ("POST", "/requests/{requests}/close", {"note": "freed"}, "request_closed"),
    ("POST", "/robots/turtle/requests", {"reason": "stuck"}, "request_made"),
    ("POST", "/requests/{requests}/cancel", None, "request_cancelled"),
    ("POST", "/robots/turtle/rotate-key", None, "robot_rotation_requested"),
    ("POST", "/robots/turtle/move-ports", None, "robot_ports_moved"),
    ("POST", "/robots/turtle/rekey", None, "robot_rekeyed"),
    ("POST", "/join", OTHER_ROBOT.join(MAC), "robot_pending"),
    ("POST", "/robots/turtle/approve", finger(OTHER_ROBOT), "robot_approved"),
    ("POST", "/join", REJECTED_ROBOT.join(MAC), "key_claimed"),
    ("POST", "/robots/turtle/reject", finger(REJECTED_ROBOT), "key_rejected"),
    ("DELETE", "/rejected-keys/{rejected_keys}", None, "key_forgiven"),
    ("DELETE", "/robots/turtle", None, "robot_removed"),
    ("DELETE", "/users/zoe", None, "user_removed"),
)


def lines_in(database):
    with database.transaction() as tx:
        rows = tx.rows("SELECT kind, actor, details FROM audit_events ORDER BY id")
    return [(row["kind"], row["actor"], row["details"]) for row in rows]


def numbered(root, path):
    """The path with the newest number of each kind; what is assigned to root finds it available."""
    if path.endswith("/assign"):
        root.ask("PUT", "/queue/me", {"state": "available"})
    numbers = {name: newest(root, name) for name in re.findall(r"{(\w+)}", path)}
    return path.format(**numbers)


def newest(root, name):
    """The newest number of a kind; of requests, that of an open one if there is any."""
    found = root.get(LISTS[name])[name] or root.get(f"{LISTS[name]}?state=closed")[name]
    return max(item["id"] for item in found)


@pytest.mark.usefixtures("site_certificate")
def test_every_change_leaves_its_line(program, browser, root, database):
    in_browser = in_person(browser, "root")
    for step in STEPS:
        method, path, body, kind = step
        at = numbered(root, path)
        before = len(lines_in(database))
        # No token makes another one.
        who = Program(program, {}) if path == "/join" else in_browser if path == "/tokens" else root
        answer = who.ask(method, at, body)
        assert answer.status_code in {200, 201, 202, 204}, (step, answer.text)
        left = lines_in(database)[before:]
        assert kind in [item for item, *_ in left], (step, left)
        assert {actor for _, actor, _ in left} == {"robot" if path == "/join" else "root"}, step
    everything = json.dumps(lines_in(database))
    assert PASSWORD not in everything
    assert not re.search(r"\br[tj]_[A-Za-z0-9_-]{20}", everything)


ODD_TEXTS = ("x" * 300, "\N{ROBOT FACE}", "a\x00b", "\ud800", "'", " ")
# What the database says of a value.
DATABASES_WORDS = re.compile(r"column|constraint|data too|incorrect|row \d|sql|`", re.IGNORECASE)


def oddly_spelt(value, odd):
    """The value with this text in the place of one of its own, for each of them."""
    if isinstance(value, str):
        yield odd
    elif isinstance(value, dict | list):
        for place, inner in list(value.items() if isinstance(value, dict) else enumerate(value)):
            for changed in oddly_spelt(inner, odd):
                copy = value.copy()
                copy[place] = changed
                yield copy


@pytest.mark.usefixtures("site_certificate")
def test_no_odd_text_is_answered_in_the_databases_words(program, browser, root):
    in_browser = in_person(browser, "root")
    for method, path, body, _ in STEPS:
        who = Program(program, {}) if path == "/join" else in_browser if path == "/tokens" else root
        now = numbered(root, path)
        for odd in ODD_TEXTS:
            asked = [(now, changed) for changed in oddly_spelt(body, odd)]
            parts = now.split("/")[2:] if odd.isprintable() else []
            asked += [(now.replace(f"/{part}", f"/{quote(odd)}"), body) for part in parts]
            for at, sent in asked:
                answer = who.ask(method, at, sent)
                assert answer.status_code < 500, (method, at, sent, answer.text)
                # Another answer has random texts, which spell anything, as a key's fingerprint does.
                is_refused = answer.status_code >= HTTPStatus.BAD_REQUEST
                said = re.sub(r"SHA256:[A-Za-z0-9+/]{43}", "", answer.text) if is_refused else ""
                assert not DATABASES_WORDS.search(said), (method, at, sent, said)
        # 409: one of them was accepted.
        done = who.ask(method, numbered(root, path), body)
        assert done.status_code in {200, 201, 202, 204, 409}, (method, path, done.text)


def test_no_change_is_forgotten(app):
    """Whoever adds a path that changes something says here which line it leaves."""
    changes = {"POST", "PUT", "PATCH", "DELETE"}
    served = {
        (method, rule.endpoint)
        for rule in app.url_map.iter_rules()
        if rule.rule.startswith("/api/v1")
        for method in changes & (rule.methods or set())
    }
    paths = app.url_map.bind("robots.example")
    asked = {
        (method, paths.match(re.sub(r"{\w+}", "1", f"/api/v1{path}"), method)[0])
        for method, path in {step[:2] for step in STEPS} | NO_CHANGE
    }
    assert served == asked
