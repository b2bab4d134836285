"""What the playbooks ask a server about a robot, as Ansible runs it against the real application."""

import datetime as dt

from ansible_module import run_module
from api_visitor import new_public_key
from robot_signer import RobotSigner
from robotether_server.db.audit import Source
from robotether_server.services import tokens


async def test_a_renamed_robot_is_known_by_its_key(web):
    """The inventory has its old name, which may be another robot's by now."""
    root, robot, mac = web.program("root"), RobotSigner(), "00:1b:44:00:00:01"
    key = robot.line
    report = {"hostname": "pc", "agent_version": "0.1.0"}
    for name, its_mac, its_key in (
        ("turtle", mac, key),
        ("other", "00:1b:44:00:00:02", new_public_key()),
    ):
        body = {"mac": its_mac, "public_key": its_key, **report}
        assert root.ask("PUT", f"/robots/{name}", body).status_code == 201
    for name, new in (("turtle", "renamed"), ("other", "turtle")):
        assert root.ask("PATCH", f"/robots/{name}", {"name": new}).status_code == 200
    arguments = {
        "server": web.address,
        "ca_file": str(web.certificate),
        "token": web.token("root"),
        "name": "turtle",
        "state": "known",
    }
    assert (await run_module("robot", arguments))["robot"]["name"] == "turtle"
    with web.database.transaction() as tx:
        soon = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
        token = tokens.create_join_token(tx, Source("root"), "lab", 1, soon)
    join_token = {**arguments, "token": token, "state": "present", **report}
    proof = {"mac": mac, "public_key": key, "signature": robot.proof(mac)}
    own = await run_module("robot", {**join_token, **proof})
    assert (own["robot"]["name"], own["changed"]) == ("renamed", False)
    # As a file has it.
    own = await run_module("robot", {**arguments, "token": f"{web.token('root')}\n"})
    assert own["failed"] is False
    for name, value in (("token", "rt_of\nroot"), ("token", "rt_of_\u20ac"), ("server", "a" * 64)):
        refused = await run_module("robot", {**arguments, name: value})
        assert refused["msg"].startswith("cannot use ")
        assert "rt_of" not in str(refused["msg"])
    with_key = await run_module("robot", {**arguments, "public_key": key})
    assert with_key["robot"]["name"] == "renamed"
