"""The installed collection, away from any checkout, enrols a robot and retires it; its inventory lists it meanwhile."""

import json
import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from commands import output_of_command, path_with
from playbooks import pip_environment
from robot_hosts import ROOT

# What a change breaks of it, unit tests say: the archive, its installation and its names.
pytestmark = pytest.mark.release
BIN = Path(sys.executable).parent
PLAYBOOKS = "robotether.robotether"


@pytest.fixture(scope="module")
def installed(site, tmp_path_factory):
    """An administrator who has the collection and no checkout."""
    folder = tmp_path_factory.mktemp("installed")
    run = partial(
        output_of_command, cwd=folder, env=pip_environment() | path_with(BIN), limit_s=300
    )
    archive = run(ROOT / "tools" / "build_collection", folder).splitlines()[-1]
    run("ansible-galaxy", "collection", "install", "--offline", "-p", folder, archive)
    return replace(site, folder=folder, collections=folder)


def listed(site):
    inventory = site.folder / "fleet.yml"
    inventory.write_text(
        "plugin: robotether.robotether.robots\n"
        f"server: {site.server}\ntls_fingerprint: {site.fingerprint}\ntoken: {site.token}\n"
    )
    environ = {**os.environ, "ANSIBLE_COLLECTIONS_PATH": str(site.collections)}
    command = (BIN / "ansible-inventory", "-i", inventory, "--list")
    said = output_of_command(*command, cwd=site.folder, env=environ)
    return list(json.loads(said).get("state_online", {"hosts": []})["hosts"])


def test_enrolled_listed_retired(installed, hosts):
    robot = hosts.boot("roamer")
    before = robot.footprint()
    first = installed.play_well(f"{PLAYBOOKS}.enroll", robot)
    first.must_say("a message went to its rosbridge and back")
    assert installed.play_well(f"{PLAYBOOKS}.enroll", robot).changed["roamer"] == 0
    robot.wait("online in the inventory", lambda: "roamer" in listed(installed))
    installed.play_well(f"{PLAYBOOKS}.retire", robot, retire_confirm="true")
    assert robot.footprint() ^ before == set()
    assert listed(installed) == []


def test_what_only_a_checkout_has_is_said(installed, hosts):
    """The image of the agent is built from sources, which the collection does not have."""
    robot = hosts.boot("boxless")
    # A Docker that runs, as far as the check can see.
    robot.put(b"#!/bin/sh\n", "/usr/local/bin/docker", 0o755)
    played = installed.play(f"{PLAYBOOKS}.enroll", robot, agent_runtime="docker")
    assert played.code != 0
    played.must_say("only a checkout can build the image", "Nothing was changed")
