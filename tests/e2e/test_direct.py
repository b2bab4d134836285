"""The paper's open ports (the service `direct`): for the listed networks only, and still through the robot's guard."""

import select
import socket
from contextlib import ExitStack

import pytest
from program_driver import ProgramDriver
from sim_watch import SimWatch
from stack import wait_until_back

PORTS = (20000, 20005)
# limit_conn of images/nginx/direct.conf.
MOST_OF_AN_ADDRESS = 40
UP_WITHIN_S = 300


@pytest.fixture
def open_to(stack):
    """Publish the robots' ports to these networks; closed again at the end."""
    before = stack.env_file.read_text()

    def publish(sources):
        ours = ("DIRECT_", "COMPOSE_PROFILES=")
        lines = [line for line in before.splitlines() if not line.startswith(ours)]
        lines += ["COMPOSE_PROFILES=direct", f"DIRECT_SOURCES={sources}"]
        lines += [f"DIRECT_PORT_FIRST={PORTS[0]}", f"DIRECT_PORT_LAST={PORTS[1]}"]
        stack.env_file.write_text("\n".join(lines) + "\n")
        stack.tool("tools/up", "--no-build", timeout=UP_WITHIN_S)
        wait_until_back(stack, "sim1")

    yield publish
    stack.env_file.write_text(before)
    stack.tool("tools/up", "--no-build", timeout=UP_WITHIN_S)
    # The relay was made anew, which every robot has to find out.
    wait_until_back(stack, "sim1", "sim2", "sim3")


def ros_port(stack):
    [[port]] = stack.sql("SELECT ros_port FROM robots WHERE name = 'sim1'")
    return int(port)


def answers(port):
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as plain:
            plain.sendall(b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n")
            return plain.recv(16).startswith(b"HTTP/")
    except (ConnectionError, TimeoutError):
        return False


def cut_at_once(port, count):
    """How many of so many connections that say nothing are ended without a wait."""
    with ExitStack() as opened:
        idle = [
            opened.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5))
            for _ in range(count)
        ]
        ended, _, _ = select.select(idle, [], [], 1)
        return len(ended)


@pytest.mark.release
def test_ports_are_open_to_the_listed_networks_only(stack, open_to):
    """A source outside gets nothing; one inside drives through the guard, which stops the robot afterwards."""
    port = ros_port(stack)
    open_to("192.0.2.0/24")
    assert not answers(port)
    open_to("192.0.2.0/24,172.16.0.0/12,192.168.0.0/16,10.0.0.0/8")
    stack.wait("rosbridge behind the open port", lambda: answers(port), "direct", "relay")
    with SimWatch(stack, "sim1") as watch:
        with ProgramDriver(f"ws://127.0.0.1:{port}/"):
            watch.wait_seen("driven", lambda pose: pose["linear_velocity"] > 0, since=0)
        watch.wait_standing()
        assert watch.commands()[-1].msg["linear"]["x"] == 0
    assert cut_at_once(port, MOST_OF_AN_ADDRESS - 5) == 0
    stack.wait("room for one more", lambda: answers(port), "direct")
    assert cut_at_once(port, MOST_OF_AN_ADDRESS + 5) > 0


def test_ports_are_closed_by_default(stack):
    with socket.socket() as probe:
        probe.settimeout(2)
        assert probe.connect_ex(("127.0.0.1", ros_port(stack))) != 0
