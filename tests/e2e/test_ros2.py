"""A robot with a real ROS 2 graph: rclpy's nodes behind a rosbridge that is not ours."""

import asyncio
import json
import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import aiohttp
import page_holds
import pytest
from image_names import ensure_built, image
from map_pixels import SCAN, wait_pixels
from pages import drive_live
from playwright.sync_api import expect
from programs import Program, echo, open_echo

ROBOT = "ros2"


@contextmanager
def ros2_robot(server):
    """Run it as the service ROBOT of the stack's project; it may not have joined yet."""
    ensure_built("ros2_robot")
    host = f"cloud:{server.https_port}"
    line = server.robotether("robot", "invite", "--name", ROBOT, "--host", host).splitlines()[-1]
    container = server.engine.containers.run(
        image("ros2_robot"),
        name=f"{server.project}-{ROBOT}",
        detach=True,
        labels={
            "com.docker.compose.project": server.project,
            "com.docker.compose.service": ROBOT,
        },
        mac_address="00:1b:44:00:52:01",
        extra_hosts={"cloud": "host-gateway"},
        read_only=True,
        tmpfs={"/run": "", "/tmp": ""},
        cap_drop=["ALL"],
        environment={
            "ROBOTETHER_SERVER": host,
            "ROBOTETHER_NAME": ROBOT,
            "ROBOTETHER_TOKEN": _option(line, "token"),
            "ROBOTETHER_TLS_FINGERPRINT": _option(line, "tls-fingerprint"),
            "ROBOTETHER_INTERFACE": "eth0",
        },
    )
    try:
        yield container
    finally:
        container.remove(force=True, v=True)
        server.robotether("robot", "remove", ROBOT, "--yes")


def _option(line, name):
    found = re.search(rf"--{name} (\S+)", line)
    assert found is not None, line
    return found[1]


FORWARD = {"linear": {"x": 0.4, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
# More than the action counts in a test that hangs.
ENDLESS = 10_000
ANSWER_S = 20
Result = TypeVar("Result")


@pytest.fixture(scope="module", autouse=True)
def robot(stack):
    """The robot, driven by nobody."""
    if stack.engine.version()["Arch"] != "amd64":
        pytest.skip("there are wheels of ROS 2 for amd64 alone")
    with ros2_robot(stack) as container:
        try:
            stack.wait_until_drivable(ROBOT)
            yield
        except AssertionError as error:
            raise AssertionError(f"{error}\n{container.logs(tail=40).decode()}") from error


@pytest.fixture(scope="module")
def program(stack):
    return Program(stack, stack.token("ros2"))


def run(work):
    """Run it in a thread of its own, as Playwright keeps a loop running in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, work).result()


async def first(socket, **wanted):
    """The first message with these values; others pass."""
    async with asyncio.timeout(ANSWER_S):
        async for frame in socket:
            message = json.loads(frame.data)
            if wanted.items() <= message.items():
                return message
    raise AssertionError(f"closed with {socket.close_code} before {wanted}")


def test_page_drives_it_and_shows_its_sensors(page, stack):
    """Camera, scan and battery come from its graph; while W is held its odometry says that it drives."""
    drive_live(page, stack, ROBOT)
    camera = page.locator("[data-testid=tile][data-topic='/camera/image_raw']")
    expect(camera).to_have_attribute("data-frame", "live", timeout=20_000)
    speed = page.get_by_test_id("speed-linear")
    expect(speed).to_contain_text("0.00 m/s")
    page_holds.hold_key(page, lambda: expect(speed).not_to_contain_text("0.00 m/s"))
    page.keyboard.up("w")
    expect(speed).to_contain_text("0.00 m/s")
    page.get_by_test_id("view-2").click()
    wait_pixels(page.get_by_test_id("video"), SCAN, 50)
    # An agent that was there before its rosbridge asks for a battery again after 30 s.
    expect(page.get_by_test_id("battery")).to_contain_text("50 %", timeout=40_000)


def test_slow_service_delays_no_command(program):
    """A calibration answers once the robot has moved, by commands of the connection that waits for the answer."""

    async def calibrate():
        async with program.connect(ROBOT) as socket:
            await socket.send_json({"op": "subscribe", "topic": "/odom"})
            await socket.send_json(
                {"op": "advertise", "topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
            )
            await first(socket, op="publish", topic="/odom")
            await socket.send_json({"op": "call_service", "id": "slow", "service": "/calibrate"})
            answer = asyncio.create_task(first(socket, op="service_response", id="slow"))
            while not answer.done():
                await socket.send_json({"op": "publish", "topic": "/cmd_vel", "msg": FORWARD})
                await asyncio.wait({answer}, timeout=0.1)
            return await answer

    answer = run(calibrate())
    assert answer["values"] == {"success": True, "message": "calibrated"}


def test_goal_is_cancelled_while_it_runs(program):
    """Feedback comes, a cancel ends the goal, and its result says so."""
    goal = {
        "op": "send_action_goal",
        "id": "count",
        "action": "/count",
        "action_type": "test_msgs/action/Fibonacci",
        "args": {"order": ENDLESS},
        "feedback": True,
    }

    async def count():
        async with program.connect(ROBOT) as socket:
            await socket.send_json(goal)
            feedback = await first(socket, op="action_feedback", id="count")
            assert feedback["values"]["sequence"][:2] == [0, 1]
            await socket.send_json({"op": "cancel_action_goal", "id": "count", "action": "/count"})
            return await first(socket, op="action_result", id="count")

    result = run(count())
    assert 2 < len(result["values"]["sequence"]) < ENDLESS


def test_messages_pass_unchanged(program):
    """Text with any characters comes back as it was sent, and CBOR as binary frames."""
    text = 'quotes " and \\ and é and 日本 and \u2028' + "x" * 100_000

    async def talk():
        async with program.connect(ROBOT) as socket:
            await open_echo(socket)
            echoed = await echo(socket, text)
            await socket.send_json({"op": "subscribe", "topic": "/odom", "compression": "cbor"})
            return echoed, await asyncio.wait_for(socket.receive(), ANSWER_S)

    echoed, frame = run(talk())
    assert echoed == text
    assert frame.type is aiohttp.WSMsgType.BINARY
    assert b"child_frame_id" in frame.data
