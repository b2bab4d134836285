"""What somebody on the tunnel network without any secret tries: another container there, or a part that was taken over.

The network is for sshd, relay and nginx alone. Should somebody else get there, the robots' guards still ask for their
keys, and the relay for its own. It has an address of its own, from which half-open log-ins keep nobody else out.
"""

import json
import subprocess
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest
from inside import run_inside
from jump_people import ShellRobot
from stack import PROJECT

# Sends bytes, and prints as JSON what came back until it was silent, or why nothing could be sent.
PROBE = """
import json, socket, sys
host, port, data = sys.argv[1], int(sys.argv[2]), bytes.fromhex(sys.argv[3])
try:
    way = socket.create_connection((host, port), 3)
except OSError as error:
    print(json.dumps({"unreachable": type(error).__name__})); sys.exit()
way.sendall(data)
way.settimeout(10)
got = b""
try:
    while len(got) < 4096:
        piece = way.recv(4096)
        if not piece:
            break
        got += piece
        way.settimeout(1)
except OSError:
    pass
print(json.dumps({"got": got.decode("latin-1")}))
"""
UNREACHABLE = "unreachable"
# Keeps so many log-ins half open, and begins another for each that the server ends; says when it has begun all of them.
HOLD_HALF_OPEN = """
import select, socket, sys, time
host, port, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
begun, ways = 0, []
while True:
    while len(ways) < count:
        ways.append(socket.create_connection((host, port), 5))
        ways[-1].sendall(b"SSH-2.0-half_open\\r\\n")
        begun += 1
        if begun == count:
            print("begun", flush=True)
    for way in select.select(ways, [], [], 0.1)[0]:
        try:
            if way.recv(4096):
                continue
        except OSError:
            pass
        way.close()
        ways.remove(way)
"""


class Insider:
    def __init__(self, container):
        self._container = container

    def send(self, host, port, data):
        """Send bytes to a port; what came back, or UNREACHABLE."""
        done = run_inside(self._container, "python3", "-c", PROBE, host, str(port), data.hex())
        assert done.returncode == 0, done.stderr
        answer = json.loads(done.stdout)
        return answer.get("got", UNREACHABLE)

    def get(self, host, port, path="/", method="GET", **headers):
        """Send an HTTP request; the status line of the answer, or what `send` says."""
        named = {"Host": host, "Content-Length": "0", "Connection": "close", **headers}
        spelt = [f"{name.replace('_', '-')}: {value}" for name, value in named.items()]
        request = "\r\n".join([f"{method} {path} HTTP/1.1", *spelt, "", ""])
        return self.send(host, port, request.encode()).split("\r\n", 1)[0]

    def upgrade(self, host, port, **headers):
        asked = {
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec_WebSocket_Version": "13",
            "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
        }
        return self.get(host, port, **asked, **headers)

    @contextmanager
    def half_open_log_ins(self, host, port, count):
        command = ["docker", "exec", "--interactive", str(self._container.id), "python3", "-c"]
        running = subprocess.Popen(
            [*command, HOLD_HALF_OPEN, host, str(port), str(count)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert running.stdout.readline() == "begun\n", running.communicate()[1]
            yield
            assert running.poll() is None, running.communicate()[1]
        finally:
            # What runs inside does not end with its client.
            run_inside(self._container, "sh", "-c", "kill -KILL -1", user="0")
            running.communicate(timeout=10)


@contextmanager
def insider(stack):
    image = stack.container("relay").image
    container = stack.engine.containers.run(
        image,
        ["infinity"],
        entrypoint="sleep",
        network=f"{PROJECT}_tunnel",
        name=f"{PROJECT}-insider",
        detach=True,
    )
    try:
        yield Insider(container)
    finally:
        container.remove(force=True)


VICTIM = "sim1"
USER = "tunnel@127.0.0.1"
HALF_OPEN = 40
LOG_INS = 4


@pytest.fixture(scope="module")
def inside(stack):
    """Somebody on the tunnel network, where the victim's guard answers: a test before may have restarted it."""
    [[port]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    with insider(stack) as somebody:
        stack.wait(
            f"{VICTIM} behind its port",
            lambda: somebody.get("sshd", int(port)).startswith("HTTP/1.1 426 "),
            VICTIM,
            "relay",
        )
        yield somebody


def test_a_robots_port_and_the_relay_open_with_their_keys_only(inside, stack):
    """The forwarded port is no secret: the guard behind it asks for its session's key, and the relay for sshd's."""
    [[port]] = stack.sql(f"SELECT ros_port FROM robots WHERE name = '{VICTIM}'")
    wrong = {"Robotether_Key": "x" * 43, "Robotether_Mode": "drive", "Robotether_Fence": "999999"}
    for headers in ({}, wrong, {**wrong, "Robotether_Key": ""}):
        assert inside.upgrade("sshd", int(port), **headers) == "HTTP/1.1 403 Forbidden"
    preface = {
        "type": "preface", "kind": "session", "robot_id": 1, "fingerprint": "", "ports": [], "address": "192.0.2.1",
    }  # fmt: skip
    for first in (preface, {**preface, "session_key": "0" * 64}):
        assert inside.send("relay", 8091, json.dumps(first).encode() + b"\n") == ""


@pytest.fixture(scope="module")
def key(stack, tmp_path_factory):
    """The key of an active robot that no agent uses."""
    folder = tmp_path_factory.mktemp("keys")
    with ShellRobot.added(stack, folder, "kept-out", "00:00:5e:00:53:73") as robot:
        yield robot.key


def log_in(key, port):
    said = key.ssh("-v", USER, "id", port=port, timeout=45).stderr
    return "in" if "Authenticated to" in said else said[-400:]


@pytest.mark.parametrize("door", ["2222", "443"])
def test_half_open_log_ins_of_one_address_keep_nobody_out(stack, inside, key, door):
    host, attacked = {"2222": ("sshd", 2222), "443": ("nginx", 8443)}[door]
    port = {"2222": stack.ssh_port, "443": stack.https_port}[door]
    with inside.half_open_log_ins(host, attacked, HALF_OPEN), ThreadPoolExecutor(LOG_INS) as pool:
        got = list(pool.map(lambda _: log_in(key, port), range(LOG_INS)))
    assert got == ["in"] * LOG_INS
