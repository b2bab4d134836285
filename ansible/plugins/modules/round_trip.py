#!/usr/bin/python
"""Ansible module: proves that a robot is drivable through its Robotether server. Runs on the controller."""

from __future__ import annotations

import contextlib
import json
import secrets
import struct
import sys
import time
from collections.abc import Iterator
from typing import Any

from ansible.module_utils.basic import AnsibleModule
from ansible_collections.robotether.robotether.plugins.module_utils.server import (
    ARGUMENTS,
    Server,
    ServerError,
    reason_of,
)

try:
    import websocket
except ImportError:
    websocket = None

DOCUMENTATION = r"""
module: round_trip
short_description: Sends a message to a robot through the server and waits for it to come back
description:
  - Gets a ticket, opens the robot's rosbridge through the server, and publishes one text on a topic of its own that the
    same connection is subscribed to. It moves nothing, and takes the way of any program that drives the robot.
  - In check mode it only looks whether it could do so.
requirements: [websocket-client]
options:
  server: {description: HOST or HOST:PORT of the server's https, type: str, required: true}
  tls_fingerprint: {description: SHA-256 of the server's certificate; empty asks authorities, type: str, default: ""}
  ca_file: {description: A file of certificates in PEM to trust in place of the system's, type: path}
  token: {description: An API token (rt_) of a user who may drive the robot, type: str, required: true}
  name: {description: The robot's name, type: str, required: true}
  timeout: {description: Seconds in which it must succeed once, type: int, default: 60}
author: ["Robotether"]
"""

EXAMPLES = r"""
- name: Send a message to a robot and back
  robotether.robotether.round_trip:
    server: robots.example.com
    token: "{{ lookup('ansible.builtin.env', 'ROBOTETHER_TOKEN') }}"
    name: turtle
  delegate_to: localhost
"""

RETURN = r"""
round_trip_ms: {description: how long the message was on its way, type: float, returned: success}
"""

TOPIC = "/robotether_enrolment"
ANSWER_S = 5.0
PAUSE_S = 0.5
CREATED = 201
SWITCHING_PROTOCOLS = 101
# Nothing that a wait could mend.
FINAL = {"token_invalid", "grant_missing", "tls_untrusted", "robot_unknown"}


def main() -> None:
    """Try until one round trip succeeds or the time is over."""
    module = AnsibleModule(
        argument_spec={
            **ARGUMENTS,
            "name": {"type": "str", "required": True},
            "timeout": {"type": "int", "default": 60},
        },
        supports_check_mode=True,
    )
    if websocket is None:
        module.fail_json(
            msg="cannot send a message to a robot: this machine's Ansible has no websocket-client; "
            f"install it (apt install python3-websocket, or pip install websocket-client with {sys.executable})",
            code="websocket_client_missing",
        )
    if module.check_mode:
        module.exit_json(changed=False)
    end = time.monotonic() + module.params["timeout"]
    try:
        server = Server.of(module.params)
        while (took_ms := _try(server, module.params["name"], is_last=False)) is None:
            if time.monotonic() > end:
                took_ms = _try(server, module.params["name"], is_last=True)
                break
            time.sleep(PAUSE_S)
    except ServerError as problem:
        module.fail_json(msg=str(problem), code=problem.code)
    module.exit_json(changed=False, round_trip_ms=took_ms)


def _try(server: Server, robot: str, *, is_last: bool) -> float | None:
    """Return what the round trip took, or None when it may succeed later."""
    try:
        return _round_trip(server, robot)
    except ServerError as problem:
        if is_last or problem.code in FINAL:
            raise
        return None


def _round_trip(server: Server, robot: str) -> float:
    path = _ros_path(server, robot)
    try:
        with _opened(server, path) as socket:
            return _echo(socket)
    except (websocket.WebSocketException, OSError) as error:
        why = reason_of(error) if isinstance(error, OSError) else error
        raise ServerError(
            f"cannot reach rosbridge of robot {robot} through {server.address}: {why}; "
            "run 'robotether-agent doctor' on the robot",
            "robot_unreachable",
        ) from error


def _ros_path(server: Server, robot: str) -> str:
    status, answer = server.ask("POST", "/api/v1/tickets", {"robot": robot, "mode": "drive"})
    if status != CREATED:
        code = str(answer.get("code", "answer_invalid"))
        detail = answer.get("detail", f"HTTP status {status}")
        raise ServerError(f"cannot open robot {robot}: {detail} [{code}]", code)
    return str(answer["ros_url"])


@contextlib.contextmanager
def _opened(server: Server, path: str) -> Iterator[Any]:
    """Open a WebSocket over a connection whose certificate was compared; as `server` does, follow no redirect."""
    connection = server.connect()
    socket = websocket.WebSocket()
    url = f"wss://{server.address}{path}"
    with contextlib.closing(connection), contextlib.closing(socket):
        try:
            socket.connect(
                url,
                socket=connection.sock,
                timeout=ANSWER_S,
                suppress_origin=True,
                redirect_limit=0,
            )
            status = socket.getstatus()
        except websocket.WebSocketBadStatusException as error:
            status = error.status_code
        if status != SWITCHING_PROTOCOLS:
            raise websocket.WebSocketException(
                f"the server answers {status} in place of a WebSocket"
            )
        yield socket


def _echo(socket: Any) -> float:
    topic = {"topic": TOPIC, "type": "std_msgs/String"}
    for operation in ("advertise", "subscribe"):
        socket.send(json.dumps({"op": operation, **topic}))
    # The first waits at the server for the subscription.
    _time_echo(socket)
    took_s = _time_echo(socket)
    for operation in ("unsubscribe", "unadvertise"):
        socket.send(json.dumps({"op": operation, "topic": TOPIC}))
    return round(took_s * 1000, 1)


def _time_echo(socket: Any) -> float:
    text, started = secrets.token_hex(8), time.monotonic()
    socket.send(json.dumps({"op": "publish", "topic": TOPIC, "msg": {"data": text}}))
    while text not in _received(socket):
        # By our clock, too: each ping of the server begins the socket's own time limit anew.
        if time.monotonic() > started + ANSWER_S:
            raise websocket.WebSocketTimeoutException(f"no echo in {ANSWER_S:g} s")
    return time.monotonic() - started


def _received(socket: Any) -> str:
    kind, data = socket.recv_data(control_frame=True)
    if kind != websocket.ABNF.OPCODE_CLOSE:
        return data.decode(errors="replace")
    code, reason = struct.unpack(">H", data[:2]) if data else (1005,), data[2:]
    raise websocket.WebSocketException(
        f"{reason.decode(errors='replace') or 'it was closed'} [{code[0]}]"
    )


if __name__ == "__main__":
    main()
