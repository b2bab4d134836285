"""What the playbooks ask a server about a robot, as Ansible runs it against the real application."""

import datetime as dt
import json

from ansible_module import play
from api_visitor import new_public_key
from robot_signer import RobotSigner
from robotether_server.db.audit import Source
from robotether_server.services import tokens


def results_of(folder, *calls):
    """What the module `robot` returned for each of these arguments, in one run of Ansible."""
    names = [f"call_{number}" for number in range(len(calls))]
    tasks = [
        {"robotether.robotether.robot": call, "register": name, "ignore_errors": True}
        for name, call in zip(names, calls, strict=True)
    ]
    results = {"content": f"{{{{ [{', '.join(names)}] | to_json }}}}", "dest": f"{folder}/results"}
    done = play(folder, [*tasks, {"ansible.builtin.copy": results}])
    assert done.returncode == 0, done.stdout
    return json.loads((folder / "results").read_text())


def test_a_renamed_robot_is_known_by_its_key(web, tmp_path):
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
    known = {
        "server": web.address,
        "ca_file": str(web.certificate),
        "token": web.token("root"),
        "name": "turtle",
        "state": "known",
    }
    with web.database.transaction() as tx:
        soon = dt.datetime.now(dt.UTC) + dt.timedelta(hours=1)
        token = tokens.create_join_token(tx, Source("root"), "lab", 1, soon)
    proof = {"mac": mac, "public_key": key, "signature": robot.proof(mac)}
    wrong = (("token", "rt_of\nroot"), ("token", "rt_of_\u20ac"), ("server", "a" * 64))
    by_name, own, from_a_file, with_key, *refused = results_of(
        tmp_path,
        known,
        {**known, "token": token, "state": "present", **report, **proof},
        # As a file has it.
        {**known, "token": f"{web.token('root')}\n"},
        {**known, "public_key": key},
        *({**known, name: value} for name, value in wrong),
    )
    assert by_name["robot"]["name"] == from_a_file["robot"]["name"] == "turtle"
    assert (own["robot"]["name"], own["changed"]) == ("renamed", False)
    assert with_key["robot"]["name"] == "renamed"
    for result in refused:
        assert result["msg"].startswith("cannot use ")
        assert "rt_of" not in str(result["msg"])
