"""What starts a robot's ROS for the agent, as far as it can be read where ROS 2 is not: packages and launch files."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit
from xml.etree import ElementTree

import pytest
from catkin_pkg.package import parse_package
from local_network import free_port
from robotether_agent import __version__
from robotether_agent.settings import Settings

ROS = Path(__file__).resolve().parents[3] / "ros"
PACKAGE = ROS / "robotether_bringup"
ROS_1, ROS_2 = ROS / "robotether.launch", PACKAGE / "launch" / "robotether.launch.xml"


def test_package_is_what_ros_2_takes() -> None:
    """ROS's own build tools accept the package."""
    package = parse_package(str(PACKAGE))
    package.validate()
    assert (package.version, package.get_build_type()) == (__version__, "ament_python")


def test_installs_where_ros_2_launch_looks(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "package")
    subprocess.run(
        [sys.executable, "setup.py", "-q", "install_data", f"--install-dir={tmp_path}/to"],
        cwd=tmp_path / "package",
        check=True,
    )
    share = tmp_path / "to" / "share"
    assert (share / "robotether_bringup" / "launch" / ROS_2.name).read_text() == ROS_2.read_text()
    assert (share / "ament_index/resource_index/packages/robotether_bringup").is_file()
    assert (share / "robotether_bringup" / "package.xml").is_file()


def test_ros_1_starts_these_nodes() -> None:
    """The file is read by roslaunch itself."""

    def nodes(*arguments: str) -> list[str]:
        command = ["roslaunch", "--nodes", str(ROS_1), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()

    assert nodes() == ["/rosbridge_websocket", "/rosapi", "/web_video_server"]
    assert nodes("video:=false") == ["/rosbridge_websocket", "/rosapi"]


@contextmanager
def ros_master(environ: dict[str, str]) -> Iterator[None]:
    """ROS 1's master, with the parameter that roscore gives it; killed at the end."""
    port = str(urlsplit(environ["ROS_MASTER_URI"]).port)
    with subprocess.Popen(["rosmaster", "--core", "-p", port], env=environ) as master:
        try:
            wait_until_done(["rosparam", "set", "/run_id", "one"], environ)
            yield
        finally:
            master.kill()


def wait_until_done(command: list[str], environ: dict[str, str]) -> None:
    """Try a command until it succeeds."""
    end = time.monotonic() + 30
    while subprocess.run(command, check=False, env=environ).returncode:
        assert time.monotonic() < end, f"after 30 s still not done: {command}"


def test_boot_unit_of_ros_1_ends_with_its_roscore(tmp_path: Path) -> None:
    """The unit in the docs runs with another program in roslaunch's place: no node registers at the next roscore."""
    unit = (ROS.parent / "docs" / "howto" / "ros1-robot.md").read_text()
    found = re.search(r"^ExecStart=/bin/bash -c '(.+?)'$", unit, re.MULTILINE | re.DOTALL)
    assert found is not None
    script = found[1].replace("$$", "$").replace("\\\n", "").replace("sleep 5", "sleep 0.1")
    begun = tmp_path / "begun"
    for theirs, ours in (
        (". /opt/ros/noetic/setup.bash;", ""),
        ("roslaunch --wait /etc/robotether.launch", "sleep infinity"),
        ("while [", f"touch {begun}; while ["),
    ):
        assert theirs in script
        script = script.replace(theirs, ours)
    environ = os.environ | {
        "ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}",
        "ROS_HOSTNAME": "127.0.0.1",
        "ROS_LOG_DIR": str(tmp_path),
    }
    with subprocess.Popen(["bash", "-c", script], env=environ) as started:
        try:
            with ros_master(environ):
                wait_until_done(["test", "-e", str(begun)], environ)
                assert started.poll() is None
            assert started.wait(timeout=30) == -signal.SIGTERM
        finally:
            started.kill()


@pytest.mark.parametrize("file", [ROS_1, ROS_2])
def test_serves_this_machine_alone_where_the_agent_looks(file: Path) -> None:
    root = ElementTree.parse(file).getroot()
    given = [
        (element.get("name"), element.get("value"))
        for element in (*root.iter("param"), *root.iterfind("include/arg"))
    ]
    assert [value for name, value in given if name == "address"] == ["127.0.0.1", "127.0.0.1"]
    assert ("max_message_size", "10000000") in given
    defaults = {element.get("name"): element.get("default") for element in root.iterfind("arg")}
    agent = Settings(server="")
    assert defaults["ros_port"] == str(urlsplit(agent.rosbridge_url).port)
    assert defaults["video_port"] == str(urlsplit(agent.video_url).port)


def test_compose_file_runs_this_checkout_and_gives_the_agent_only_the_network() -> None:
    """Docker reads the compose file."""
    command = ["docker", "compose", "-f", str(ROS / "compose.yaml"), "config", "--format", "json"]
    environ = os.environ | {"SERVER": "robots.example.com"}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environ)
    config = json.loads(done.stdout)
    services = config["services"]
    assert {service["network_mode"] for service in services.values()} == {"host"}
    # What a `git pull` brought runs, and no registry is asked for our image's name.
    assert {service["pull_policy"] for service in services.values()} == {"build"}
    agent = services["agent"]
    assert agent["read_only"]
    assert agent["cap_drop"] == ["ALL"]
    targets = [volume["target"] for volume in agent["volumes"]]
    assert targets == ["/var/lib/robotether-agent", "/run/robotether-agent"]
    # What a killed agent left says whether the robot moves: it goes with the machine, not with the container.
    assert config["volumes"]["run"]["driver_opts"]["type"] == "tmpfs"
    assert [volume["source"] for volume in services["ros"]["volumes"]] == ["run"]
