"""The image of the simulated robot, run as the demo does, without any cloud: its agent retries meanwhile."""

from __future__ import annotations

import io
import json
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import aiohttp
import docker
import pytest
from docker.models.containers import Container
from image_names import ensure_built, image
from inside import run_inside
from PIL import Image
from stopwatch import Stopwatch

pytestmark = pytest.mark.release

IMAGE = image("sim_robot")
NOWHERE = {
    "ROBOTETHER_SERVER": "127.0.0.1:1",
    "ROBOTETHER_INTERFACE": "eth0",
    "ROBOTETHER_ALLOW_LOCAL_MAC": "true",
}


@dataclass(frozen=True)
class Robot:
    """A running container of the image."""

    container: Container

    def port(self, inside: int) -> int:
        """The published port on this machine."""
        self.container.reload()
        return int(self.container.ports[f"{inside}/tcp"][0]["HostPort"])

    @property
    def state(self) -> dict[str, Any]:
        """What the engine says about the container now."""
        self.container.reload()
        state: dict[str, Any] = self.container.attrs["State"]
        return state

    def shell(self, command: str) -> tuple[int, str]:
        """Run a command inside; exit code and what it printed."""
        done = run_inside(self.container, "sh", "-c", command, merged=True)
        return done.returncode, done.stdout.strip()

    def wait(self, what: str, condition: Callable[[], bool], seconds: float = 60) -> None:
        """Wait until the condition holds, or fail with the container's log."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                log = self.container.logs(tail=40).decode()
                raise AssertionError(f"after {seconds} s still not: {what}\n{log}")
            time.sleep(0.1)


@pytest.fixture(scope="module")
def image() -> str:
    """The image, built from this checkout."""
    ensure_built("sim_robot")
    return IMAGE


@pytest.fixture
def robot(image: str) -> Iterator[Robot]:
    """One robot as the demo runs it: read-only, without any capability."""
    engine = docker.from_env()
    container = engine.containers.run(
        image,
        name=f"sim-robot-test-{uuid.uuid4().hex[:8]}",
        detach=True,
        read_only=True,
        tmpfs={"/run": "", "/tmp": ""},
        cap_drop=["ALL"],
        security_opt=["no-new-privileges:true"],
        mem_limit="256m",
        healthcheck={"interval": 500_000_000},  # ns; the image's own command, asked more often
        environment=NOWHERE | {"SIM_NAME": "simtest"},
        ports={"9090/tcp": ("127.0.0.1", None), "8080/tcp": ("127.0.0.1", None)},
    )
    try:
        running = Robot(container)
        running.wait("healthy", lambda: running.state["Health"]["Status"] == "healthy")
        yield running
    finally:
        container.remove(force=True, v=True)
        engine.close()


async def test_robot_shows_what_a_robot_shows(robot: Robot) -> None:
    """Odometry comes over rosbridge, a picture over the video server, and the agent retries beside them."""
    url = f"ws://127.0.0.1:{robot.port(9090)}/"
    query = {"topic": "/camera/image_raw", "width": "320", "height": "240"}
    async with aiohttp.ClientSession() as http, http.ws_connect(url) as socket:
        await socket.send_json({"op": "subscribe", "topic": "/odom"})
        message = json.loads((await socket.receive(timeout=5)).data)
        async with http.get(
            f"http://127.0.0.1:{robot.port(8080)}/snapshot", params=query
        ) as answer:
            image = Image.open(io.BytesIO(await answer.read()))
    assert message["topic"] == "/odom"
    assert message["msg"]["child_frame_id"] == "base_link"
    assert (image.format, image.size) == ("JPEG", (320, 240))
    robot.wait("the agent's next try", lambda: b"next try in" in robot.container.logs())


def test_robot_can_do_little_on_its_machine(robot: Robot) -> None:
    """No process is root, the file system is read-only but for the agent's state and /tmp."""
    assert robot.shell("id -u") == (0, "10090")
    # But for runc, which brings a health check in as root and becomes its user only then.
    owners = {row[0] for row in robot.container.top()["Processes"] if "runc" not in row[-1]}
    assert owners == {"10090"}
    for folder in ("/", "/etc", "/opt/robotether", "/opt/venv"):
        code, printed = robot.shell(f"touch {folder}/x")
        assert code != 0, printed
    for folder in ("/var/lib/robotether-agent", "/run", "/tmp"):
        assert robot.shell(f"touch {folder}/x") == (0, "")


def test_robot_has_a_key_of_its_own(robot: Robot) -> None:
    """The agent made its key in the volume, readable by itself alone."""
    look = "stat -c %a /var/lib/robotether-agent/id_ed25519"
    robot.wait("a key", lambda: robot.shell(look) == (0, "600"))


def test_stop_ends_it_soon(robot: Robot) -> None:
    """SIGTERM ends simulator and agent within 5 s, with code 0."""
    with Stopwatch() as stopwatch:
        robot.container.kill("SIGTERM")
        assert robot.container.wait(timeout=30)["StatusCode"] == 0
    assert stopwatch.s < 5


def pid_of(robot: Robot, module: str) -> str:
    """The oldest process that runs a module, nothing if there is none; the agent has forked the others."""
    return oldest(robot, f"grep -qz '^{module}$' $p/cmdline")


def guard_of(robot: Robot) -> str:
    """The process of the guard, nothing if there is none."""
    return oldest(robot, "grep -qx robot-guard $p/comm")


def oldest(robot: Robot, condition: str) -> str:
    """The oldest process `p` of which a condition holds."""
    find = f"for p in /proc/[0-9]*; do {condition} 2>/dev/null && basename $p; done"
    return robot.shell(f"({find}) | sort -n | head -n 1")[1]


def test_end_of_the_simulator_is_the_end(robot: Robot) -> None:
    """When the simulator dies, the container ends with an error, so that Docker starts it again."""
    robot.shell(f"kill -KILL {pid_of(robot, 'sim_robot')}")
    assert robot.container.wait(timeout=30)["StatusCode"] == 137


def test_an_agent_that_dies_is_started_anew(robot: Robot) -> None:
    """As on a real robot its guard ends with it, and both come back beside the simulator that runs on."""
    simulator = pid_of(robot, "sim_robot")
    robot.wait("a guard", lambda: bool(guard_of(robot)))
    agent, guard = pid_of(robot, "robotether_agent"), guard_of(robot)
    robot.shell(f"kill -KILL {agent}")
    robot.wait(
        "another agent and guard",
        lambda: (
            pid_of(robot, "robotether_agent") not in {"", agent}
            and guard_of(robot) not in {"", guard}
        ),
    )
    assert pid_of(robot, "sim_robot") == simulator
    assert robot.state["Running"]


def test_a_guard_that_dies_is_started_anew(robot: Robot) -> None:
    """The agent has another one at once."""
    robot.wait("a guard", lambda: bool(guard_of(robot)))
    agent, guard = pid_of(robot, "robotether_agent"), guard_of(robot)
    robot.shell(f"kill -KILL {guard}")
    robot.wait("another guard", lambda: guard_of(robot) not in {"", guard})
    assert pid_of(robot, "robotether_agent") == agent


def test_health_check_notices_a_hung_simulator(robot: Robot) -> None:
    """A simulator that does not answer is unhealthy."""
    assert robot.shell("healthy")[0] == 0
    robot.shell(
        "for p in /proc/[0-9]*; do grep -qz '^sim_robot$' $p/cmdline && kill -STOP $(basename $p); done"
    )
    code, printed = robot.shell("healthy")
    assert (code, "rosbridge at port 9090" in printed) == (1, True), printed


def test_missing_server_setting_stops_the_start(image: str) -> None:
    """Without ROBOTETHER_SERVER the container ends and says which setting is missing."""
    engine = docker.from_env()
    container = engine.containers.run(
        image, detach=True, read_only=True, tmpfs={"/run": "", "/tmp": ""}
    )
    try:
        assert container.wait(timeout=30)["StatusCode"] != 0
        assert b"server" in container.logs()
    finally:
        container.remove(force=True, v=True)
        engine.close()
