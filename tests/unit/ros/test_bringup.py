"""What starts a robot's ROS for the agent, as far as it can be read where ROS 2 is not: packages and launch files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit
from xml.etree import ElementTree

import pytest
from catkin_pkg.package import parse_package
from robotether_agent import __version__
from robotether_agent.settings import Settings

ROS = Path(__file__).resolve().parents[3] / "ros"
PACKAGE = ROS / "robotether_bringup"
ROS_1, ROS_2 = ROS / "robotether.launch", PACKAGE / "launch" / "robotether.launch.xml"


def test_package_is_what_ros_2_takes() -> None:
    """By the checks of ROS's own build tools."""
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
    """As roslaunch itself reads the file."""

    def nodes(*arguments: str) -> list[str]:
        command = ["roslaunch", "--nodes", str(ROS_1), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()

    assert nodes() == ["/rosbridge_websocket", "/rosapi", "/web_video_server"]
    assert nodes("video:=false") == ["/rosbridge_websocket", "/rosapi"]


@pytest.mark.parametrize("file", [ROS_1, ROS_2])
def test_serves_this_machine_alone_where_the_agent_looks(file: Path) -> None:
    root = ElementTree.parse(file).getroot()
    given = [
        (one.get("name"), one.get("value"))
        for one in (*root.iter("param"), *root.iterfind("include/arg"))
    ]
    assert [value for name, value in given if name == "address"] == ["127.0.0.1", "127.0.0.1"]
    assert ("max_message_size", "10000000") in given
    defaults = {one.get("name"): one.get("default") for one in root.iterfind("arg")}
    agent = Settings(server="")
    assert defaults["ros_port"] == str(urlsplit(agent.rosbridge_url).port)
    assert defaults["video_port"] == str(urlsplit(agent.video_url).port)


def test_compose_file_gives_the_agent_no_more_than_the_network() -> None:
    """As Docker reads it."""
    command = ["docker", "compose", "-f", str(ROS / "compose.yaml"), "config", "--format", "json"]
    environ = os.environ | {"SERVER": "robots.example.com"}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environ)
    services = json.loads(done.stdout)["services"]
    assert {one["network_mode"] for one in services.values()} == {"host"}
    agent = services["agent"]
    assert agent["read_only"]
    assert agent["cap_drop"] == ["ALL"]
    assert [one["target"] for one in agent["volumes"]] == ["/var/lib/robotether-agent"]
