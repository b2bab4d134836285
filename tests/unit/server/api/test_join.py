"""Joining, answer by answer as docs/reference/protocols.md has it."""

import datetime as dt
from contextlib import ExitStack

import pytest
from relay_server import cell_settings
from robot_signer import RobotSigner
from robotether_common.join import ROTATION_NAMESPACE, join_message
from robotether_server.api.join import MAX_AT_ONCE, _places, ssh_of
from robotether_server.api.operations import plain
from robotether_server.db import audit, cells, fleet, robots
from robotether_server.db.robots import Report
from robotether_server.problems import StoreUnavailableError
from robotether_server.services import pending
from robotether_server.services.joining import PresentedKey
from robotether_server.settings.server import JoinSettings
from web_visitor import bearer

MAC = "02:00:00:00:61:01"


@pytest.fixture
def robot():
    return RobotSigner()


def activate(database):
    with database.transaction() as tx:
        robots.set_state(tx, robots.get(tx, "robot-006101").id, "active")


def join(program, robot, **said):
    return program.ask("POST", "/api/v1/join", json=robot.join(MAC, **said))


@pytest.mark.parametrize(
    "forge",
    [
        lambda robot, _: {"signature": None},
        lambda robot, _: {"signature": "x"},
        lambda robot, thief: {"signature": thief.join(MAC)["signature"]},
        lambda robot, thief: {"public_key": thief.line},
        lambda robot, _: {"mac": "00:1b:44:11:3a:b7"},
        lambda robot, _: {"token": "rj_of-somebody-else"},
        lambda robot, _: {
            "signature": robot.sign(ROTATION_NAMESPACE, join_message(None, MAC, robot.key.line))
        },
    ],
)
def test_nobody_joins_with_the_key_of_another(program, database, robot, forge):
    """The signature is by the key that joins, over this token and MAC, and for no other purpose."""
    body = robot.join(MAC) | forge(robot, RobotSigner())
    answer = program.ask("POST", "/api/v1/join", json=body)
    assert (answer.status_code, answer.json["code"]) == (403, "key_unproven")
    with database.transaction() as tx:
        assert robots.find_by_key(tx, robot.key.fingerprint) is None


def test_robot_that_is_in_needs_no_proof(program, database, robot):
    """An agent that is older than the server goes on asking where its tunnel goes."""
    body = robot.join(MAC)
    program.ask("POST", "/api/v1/join", json=body)
    activate(database)
    del body["signature"]
    assert program.ask("POST", "/api/v1/join", json=body).status_code == 200


def test_joins_at_once_leave_threads_to_others(program, database, robot):
    """Unknown robots wait for each other in four threads; one that is in waits for none of them."""
    join(program, robot)
    activate(database)
    body = RobotSigner().join("00:1b:44:11:3a:b7")
    with ExitStack() as held:
        for _ in range(MAX_AT_ONCE):
            held.enter_context(_places)
        refused = program.ask("POST", "/api/v1/join", json=body)
        assert (refused.status_code, refused.json["code"]) == (429, "throttled")
        assert refused.headers["Retry-After"] == "1"
        assert join(program, robot).status_code == 200
    assert program.ask("POST", "/api/v1/join", json=body).status_code == 202


def test_robot_learns_the_tunnels_address_only_when_sshd_has_its_keys(tmp_path):
    settings = JoinSettings("approve", 3, "robots.example", (2222, 443), tmp_path, False)
    (tmp_path / "empty.pub").write_text("")
    with pytest.raises(StoreUnavailableError, match="host keys"):
        ssh_of(settings)
    (tmp_path / "ssh_host_ed25519_key.pub").write_text("ssh-ed25519 AAAA root@sshd\n")
    assert plain(ssh_of(settings))["host_keys"] == ["ssh-ed25519 AAAA"]


def test_robot_is_sent_to_the_emptiest_cell_first(program, database, relay_database, robot):
    with relay_database.transaction() as tx:
        for name, count, region in (("a", 2, "eu"), ("b", 1, "us"), ("c", 3, "eu")):
            cell = cell_settings(name, f"{name}.example", region=region)
            cells.write_heartbeat(tx, cell, cells.CellCounts(count), dt.datetime.now(dt.UTC))
    assert "ssh" not in join(program, robot).json
    activate(database)
    body, admin = {"mac": MAC, "public_key": robot.line}, bearer(database, "root")

    def cells_of_both():
        registered = program.ask("PUT", "/api/v1/robots/robot-006101", json=body, headers=admin)
        return [answer.json["ssh"]["cells"] for answer in (join(program, robot), registered)]

    for first, *others in cells_of_both():
        assert first == {"host": "b.example", "ports": [2222, 443]}
        assert {item["host"] for item in others} == {"a.example", "c.example"}
    # The doctor of a robot that waits asks so, and no cell is anybody's business.
    ssh = join(program, robot).json["ssh"]
    del ssh["cells"]
    assert program.ask("GET", "/api/v1/ssh").json == {"ssh": ssh}
    with database.transaction() as tx:
        robots.set_settings(tx, robots.get(tx, "robot-006101").id, {"region": "eu"})
    for items in cells_of_both():
        assert [item["host"] for item in items] == ["a.example", "c.example", "b.example"]


def refused(database):
    with database.transaction() as tx:
        return robots.list_refusals(tx)


def test_a_refused_join_is_kept_until_it_is_let_in(program, database, robot):
    """A machine has one record with the newest reason, and the audit log has none."""
    for _ in range(3):
        program.ask("POST", "/api/v1/join", json=robot.join(MAC, "rj_wrong"))
    (found,) = refused(database)
    assert (found.mac, found.report.hostname, found.times) == (MAC, "turtle", 3)
    assert (found.code, "cannot accept the join token" in found.detail) == ("token_invalid", True)
    with database.transaction() as tx:
        assert audit.find(tx) == []
    assert join(program, robot).status_code == 202
    assert refused(database) == []


def test_refused_joins_of_one_network_push_out_its_own_alone(database, robot):
    """The newest stay, so that the machine somebody waits for is among them."""
    joins = [("aa", "192.0.2.1"), *((f"{number:02x}", "192.0.2.2") for number in range(16))]
    for end, address in joins:
        report = Report("turtle", "0.1.0", address)
        presented = PresentedKey(f"02:00:00:00:00:{end}", robot.key, report)
        with database.transaction() as tx:
            pending.record_refusal(tx, presented, "token_invalid", "why")
    macs = [item.mac for item in refused(database)]
    assert len(macs) == 1 + robots.MAX_REFUSED_OF_NETWORK
    assert (macs[0], macs[-1]) == ("02:00:00:00:00:0f", "02:00:00:00:00:aa")


def test_a_robot_that_refuses_the_host_key_is_shown_as_such(
    program, database, relay_database, robot
):
    join(program, robot)
    activate(database)
    versions = []
    for said, code, other_key in (
        ({}, [], None),
        ({"host_key_refused": True}, ["host_key_changed"], "host_key"),
        ({}, [], None),
    ):
        assert join(program, robot, **said).status_code == 200
        assert [item.code for item in refused(database)] == code
        with relay_database.transaction() as tx:
            snapshot = fleet.load(tx)
        assert snapshot.by_name["robot-006101"].other_key == other_key
        versions.append(snapshot.rights)
    assert versions[0] == versions[2] != versions[1]
