"""What starts a robot's ROS for the agent, as far as it can be read where ROS 2 is not: packages and launch files."""

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


def test_package_is_what_ros_2_takes():
    """ROS's own build tools accept the package."""
    package = parse_package(str(PACKAGE))
    package.validate()
    assert (package.version, package.get_build_type()) == (__version__, "ament_python")


def test_installs_where_ros_2_launch_looks(tmp_path):
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


def test_ros_1_starts_these_nodes():
    """The file is read by roslaunch itself."""

    def nodes(*arguments):
        command = ["roslaunch", "--nodes", str(ROS_1), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()

    assert nodes() == ["/rosbridge_websocket", "/rosapi", "/web_video_server"]
    assert nodes("video:=false") == ["/rosbridge_websocket", "/rosapi"]


@pytest.mark.parametrize("file", [ROS_1, ROS_2])
def test_serves_this_machine_alone_where_the_agent_looks(file):
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


def test_compose_file_runs_this_checkout_and_gives_the_agent_only_the_network():
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
