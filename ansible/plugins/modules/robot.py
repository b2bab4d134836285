#!/usr/bin/python
"""Ansible module: a robot's row on a Robotether server. Runs on the controller; the robot never sees the token."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from ansible.module_utils.basic import AnsibleModule
from ansible_collections.robotether.robotether.plugins.module_utils.rows import (
    ForeignRowError,
    fingerprint_of,
    own_row,
)
from ansible_collections.robotether.robotether.plugins.module_utils.server import (
    ARGUMENTS,
    OK,
    Server,
    ServerError,
    refusal,
)

DOCUMENTATION = r"""
module: robot
short_description: Creates or removes a robot's row on a Robotether server
description:
  - C(present) registers MAC and public key under a name and makes the robot active; asking again changes nothing.
  - C(absent) removes the row of that MAC, or of that name when no MAC is given, which ends the robot's tunnel. A row
    of that MAC with another name must have that key. It needs an API token of an admin.
  - C(known) only asks, so that a wrong token is found before anything is changed, and finds the row of that key,
    else of that name. A join token may not ask.
options:
  server: {description: HOST or HOST:PORT of the server's https, type: str, required: true}
  tls_fingerprint: {description: SHA-256 of the server's certificate; empty asks authorities, type: str, default: ""}
  ca_file: {description: A file of certificates in PEM to trust in place of the system's, type: path}
  token: {description: A join token (rj_) or an API token of an admin (rt_), type: str, required: true}
  name: {description: The robot's name, type: str, required: true}
  mac: {description: The robot's MAC address, type: str}
  public_key: {description: The robot's public key, one line, type: str}
  signature: {description: "What `robotether-agent key --prove` prints; a join token needs it", type: str}
  hostname: {description: What the robot calls itself, type: str}
  agent_version: {description: The version of its agent, type: str}
  state: {description: Whether there is such a row, type: str, choices: [present, absent, known], default: present}
author: ["Robotether"]
"""

EXAMPLES = r"""
- name: Register a robot
  robotether.robotether.robot:
    server: robots.example.com
    token: "{{ lookup('ansible.builtin.env', 'ROBOTETHER_TOKEN') }}"
    name: turtle
    mac: b8:27:eb:12:34:56
    public_key: "{{ lookup('ansible.builtin.file', 'turtle.pub') }}"
  delegate_to: localhost

- name: Remove a robot
  robotether.robotether.robot:
    server: robots.example.com
    token: "{{ lookup('ansible.builtin.env', 'ROBOTETHER_TOKEN') }}"
    name: turtle
    state: absent
  delegate_to: localhost
"""

RETURN = r"""
created: {description: whether the server had no such robot before, type: bool, returned: present}
robot: {description: the robot's object as the server answers it, type: dict, returned: present}
"""

CREATED = 201
NO_CONTENT = 204
NOT_FOUND = 404
JOIN_TOKEN = "rj_"  # noqa: S105  the beginning of every join token, no secret


def main() -> None:
    """Do what `state` says and tell whether that changed anything."""
    module = AnsibleModule(
        argument_spec={
            **ARGUMENTS,
            "name": {"type": "str", "required": True},
            "mac": {"type": "str"},
            "public_key": {"type": "str"},
            "signature": {"type": "str"},
            "hostname": {"type": "str"},
            "agent_version": {"type": "str"},
            "state": {"type": "str", "choices": list(ACTIONS), "default": "present"},
        },
        required_if=[("state", "present", ("mac", "public_key"))],
        supports_check_mode=True,
    )
    act = ACTIONS[module.params["state"]]
    try:
        result = act(Server.of(module.params), module.params, check_mode=module.check_mode)
    except ServerError as problem:
        module.fail_json(msg=str(problem), code=problem.code)
    module.exit_json(**result)


def _present(server: Server, params: dict[str, Any], *, check_mode: bool) -> dict[str, Any]:
    before = _row(server, params["name"])
    if check_mode:
        return {"changed": before is None, "created": False, "robot": before or {}}
    fields = ("mac", "public_key", "signature", "hostname", "agent_version")
    body = {field: params[field] for field in fields if params[field]}
    status, answer = server.ask("PUT", _path(params["name"]), body)
    if status not in {OK, CREATED}:
        raise refusal(f"enrol robot {params['name']}", status, answer)
    created = status == CREATED
    # 200 is also the answer when a row that was announced, or waited, took the key.
    has_new_key = before is not None and any(
        before.get(key) != answer.get(key) for key in ("state", "fingerprint")
    )
    return {"changed": created or has_new_key, "created": created, "robot": answer}


def _absent(server: Server, params: dict[str, Any], *, check_mode: bool) -> dict[str, Any]:
    row = _row_now(server, params) if params["mac"] else _row(server, params["name"])
    if row is None:
        return {"changed": False}
    if not check_mode:
        # Another robot may have got the name since.
        status, answer = server.ask("DELETE", f"{_path(row['name'])}?mac={row['mac']}")
        if status not in {OK, NO_CONTENT}:
            raise refusal(f"remove robot {row['name']}", status, answer)
    return {"changed": True}


def _check(server: Server, params: dict[str, Any], *, check_mode: bool) -> dict[str, Any]:
    del check_mode  # it changes nothing
    if server.token.startswith(JOIN_TOKEN):
        server.connect().close()
        return {"changed": False, "robot": {}}
    status, answer = server.ask("GET", "/api/v1/join-tokens")
    if status != OK:
        raise refusal(f"ask {server.address} as an admin", status, answer)
    row = _row_of_key(server, params["public_key"]) or _row(server, params["name"])
    return {"changed": False, "robot": row or {}}


def _row(server: Server, name: str) -> dict[str, Any] | None:
    """Return the robot as it is; None when it is unknown, or when a join token asks, which may not."""
    if server.token.startswith(JOIN_TOKEN):
        return None
    status, answer = server.ask("GET", _path(name))
    if status not in {OK, NOT_FOUND}:
        raise refusal(f"ask for robot {name}", status, answer)
    return answer if status == OK else None


def _row_of_key(server: Server, public_key: str | None) -> dict[str, Any] | None:
    fingerprint = fingerprint_of(public_key or "")
    rows = _rows(server) if fingerprint else []
    return next((row for row in rows if row.get("fingerprint") == fingerprint), None)


def _rows(server: Server) -> list[dict[str, Any]]:
    status, answer = server.ask("GET", "/api/v1/robots")
    if status != OK:
        raise refusal("list the robots", status, answer)
    rows: list[dict[str, Any]] = answer["robots"]
    return rows


def _row_now(server: Server, params: dict[str, Any]) -> Mapping[str, Any] | None:
    """Return the row of the robot that this machine is: an admin may have renamed it since."""
    try:
        return own_row(_rows(server), params["name"], params["mac"], params["public_key"])
    except ForeignRowError as problem:
        raise ServerError(str(problem), "record_foreign") from problem


def _path(name: str) -> str:
    return f"/api/v1/robots/{quote(name, safe='')}"


ACTIONS = {"present": _present, "absent": _absent, "known": _check}

if __name__ == "__main__":
    main()
