"""A programmer's view: roslibpy and plain WebSockets with an API token, through wss."""

import os
import re
import subprocess
import sys

import pytest
from programs import Program
from sim_watch import SimWatch
from stack import ROOT

JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"


@pytest.fixture(scope="module")
def token(stack):
    """An API token of the admin, who finds nobody else at the robots that these tests drive."""
    for robot in ("sim1", "sim2"):
        stack.wait_until_free(robot)
    return stack.token("programs")


@pytest.fixture(scope="module")
def program(stack, token):
    return Program(stack, token)


def run_tutorial(stack, token, folder, **environment):
    return subprocess.run(
        [sys.executable, str(ROOT / "docs" / "tutorial" / "roslibpy_client.py"), stack.url, "sim1", token],
        env={**os.environ, **environment}, cwd=folder,
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def drivers_token(stack):
    """A token of a user with level drive on sim1, as README makes one."""
    stack.admin.add_user("programmer")
    stack.admin.grant("programmer", "sim1", "drive")
    stack.wait_for_right("programmer", "sim1")
    yield stack.token("tutorial", "programmer")
    stack.admin.remove("users", "programmer")


def test_tutorial_sends_its_token_over_https_alone():
    """Another address is answered by the usage, not by a traceback."""
    for address in ("localhost", "http://localhost"):
        command = [
            sys.executable,
            str(ROOT / "docs/tutorial/roslibpy_client.py"),
            address,
            "sim1",
            "rt_x",
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stderr.split(":")[0]) == (1, "usage")


def test_tutorial_drives_with_level_drive_and_saves_a_frame(stack, drivers_token, tmp_path):
    """The program says how far the robot came, and logs no error on the way."""
    with SimWatch(stack, "sim1") as watch:
        done = run_tutorial(stack, drivers_token, tmp_path, ROBOTETHER_INSECURE="1")
        sent = [seen.msg["linear"]["x"] for seen in watch.commands()]
    assert done.returncode == 0, done.stderr
    moved = re.search(r"sim1 moved (\S+) m", done.stdout)
    assert moved is not None, done.stdout
    # A metre is more than any delay of the last command adds to the 0.2 m.
    assert 0 < float(moved[1]) < 1
    assert "Traceback" not in done.stderr
    assert "error:" not in done.stderr
    assert 0.2 in sent
    assert sent[-1] == 0
    picture = (tmp_path / "sim1.jpg").read_bytes()
    assert picture.startswith(JPEG_START)
    assert picture.endswith(JPEG_END)


def test_tutorial_prints_why_it_is_refused(stack, drivers_token, tmp_path):
    """A certificate that nobody signed and a robot that is stopped end the program with one sentence."""
    untrusted = run_tutorial(stack, drivers_token, tmp_path)
    assert untrusted.returncode == 1
    assert "ROBOTETHER_INSECURE=1" in untrusted.stderr
    stack.admin.ask("POST", "/robots/sim1/stop", {"reason": "tutorial"})
    try:
        stopped = run_tutorial(stack, drivers_token, tmp_path, ROBOTETHER_INSECURE="1")
    finally:
        stack.admin.ask("POST", "/robots/sim1/release")
    assert stopped.returncode == 1
    assert "stopped" in stopped.stderr
    assert "Traceback" not in untrusted.stderr + stopped.stderr


def test_topics_and_services_answer_over_http(stack, program):
    def ask(method, path):
        path = f"/api/v1/robots/sim2/{path}"
        status, answer = stack.request(method, path, headers=program.headers)
        assert status == 200, answer
        return answer

    # This may open the robot's media connection, which takes a log-in.
    stack.request("GET", "/api/v1/robots/sim2/topics/odom?wait_s=9", headers=program.headers)
    first = ask("GET", "topics/odom?wait_s=9")
    assert first["message"]["twist"]
    assert 0 <= first["received_age_s"] < 30
    assert ask("GET", f"topics/%2Fodom?since={first['sequence']}")["sequence"] != first["sequence"]
    assert ask("POST", "services/rosapi/topics?timeout_s=8")["values"]["topics"]
    assert ask("POST", "services/reset?timeout_s=8")["result"]
    unknown = ask("POST", "services/no_such_service?timeout_s=8")
    assert (unknown["result"], bool(unknown["reason"])) == (False, True)


def test_robot_asks_for_help_by_its_topic(stack, program):
    def ask(method, path):
        status, answer = stack.request(method, f"/api/v1/{path}", headers=program.headers)
        assert status == 200, answer
        return answer

    def requests():
        found = ask("GET", "requests?robot=sim2")["requests"]
        return [request for request in found if request["source"] == "robot"]

    called = ask("POST", "robots/sim2/services/call_for_help?timeout_s=8")
    assert called["values"]["success"], called
    [request] = stack.wait("the robot's request", requests, "sim2", "relay")
    assert (request["robot"], request["asked_by"], request["state"]) == ("sim2", "sim2", "waiting")
    assert request["reason"] == "I need a person"
    ask("POST", f"requests/{request['id']}/cancel")
