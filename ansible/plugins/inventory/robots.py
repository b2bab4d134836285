"""Ansible inventory plugin: the robots of a Robotether server. Runs on the controller; asks, and changes nothing."""

from __future__ import annotations

import hashlib
import re
import shlex
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from typing import Any

from ansible.errors import AnsibleParserError
from ansible.utils.unsafe_proxy import wrap_var
from ansible_collections.robotether.robotether.plugins.module_utils.server import (
    ARGUMENTS,
    ROLE_PREFIX,
    Server,
    ServerError,
)

from ansible.plugins.inventory import BaseInventoryPlugin, Cacheable, Constructable

DOCUMENTATION = r"""
name: robots
short_description: Lists the robots of a Robotether server
description:
  - Lists the robots that the token's user may see. Each is a host of the group C(robots), with which the playbooks of
    this collection work.
  - A robot of the name C(localhost), C(robots) or C(all) is left out, since Ansible would take it for this machine, or
    in place of the group.
  - Each member of a robot's object in the API is a variable with the prefix C(robot_), such as C(robot_mac),
    C(robot_site), C(robot_state), C(robot_online), C(robot_agent_version), C(robot_address) or C(robot_settings).
    Members that only admins may see are missing for others.
  - Groups C(site_NAME), C(state_NAME) and C(group_NAME) come from O(group_by); a character that a group's name may not
    have becomes C(_).
  - A robot whose shell the user may reach gets the variables with which C(ssh) goes through the server, as
    C(robotether ssh-config) prints them. Other robots have none; set C(ansible_host) by O(compose) where you reach
    them otherwise.
  - The group C(robots) gets C(robotether_agent_server) and C(robotether_agent_tls_fingerprint) of O(server) and
    O(tls_fingerprint), for the roles.
author: ["Robotether"]
extends_documentation_fragment: [constructed, inventory_cache]
options:
  plugin: {description: The name of this plugin, type: str, required: true, choices: [robotether.robotether.robots]}
  server: {description: HOST or HOST:PORT of the server's https, type: str, required: true}
  tls_fingerprint: {description: SHA-256 of the server's certificate; empty asks authorities, type: str, default: ""}
  ca_file: {description: A file of certificates in PEM to trust in place of the system's, type: path}
  token:
    description: An API token (rt_) of a user. It need not be an admin's, except for C(group) in O(group_by).
    type: str
    required: true
    env: [{name: ROBOTETHER_TOKEN}]
  group_by:
    description:
      - What makes groups. C(site) is the robot's site.
      - C(state) is C(online) or C(offline) for an active robot, else C(pending) or C(disabled).
      - C(group) are the user groups that have a grant for the robot, be it for its site or for all robots. It also sets
        the variable C(robot_groups).
    type: list
    elements: str
    choices: [site, state, group]
    default: [site, state]
  jump: {description: Whether robots get the variables of their shell through the server, type: bool, default: true}
"""

EXAMPLES = r"""
# fleet.yml; export ROBOTETHER_TOKEN=rt_...
plugin: robotether.robotether.robots
server: robots.example.com
group_by: [site, state, group]
# These robots are in this machine's own network.
jump: false
compose:
  ansible_host: robot_hostname ~ '.local'
keyed_groups:
  - key: robot_agent_version
    prefix: version
groups:
  stopped: robot_stopped is not none
cache: true
cache_plugin: ansible.builtin.jsonfile
cache_connection: ~/.cache/robotether
cache_timeout: 60
"""

ROBOTS = "robots"
# On the first runs what the roles leave to this machine, with an admin's token. The others are groups, whose place in
# Ansible a host of their name takes.
TAKEN = ("localhost", ROBOTS, "all")
# What may become a part of ssh's command line; nothing else is taken from a server.
PLAIN = re.compile(r"[A-Za-z0-9_\[][A-Za-z0-9_.:@\[\]-]*")


class InventoryModule(BaseInventoryPlugin, Constructable, Cacheable):
    """Ansible's entry to this file."""

    NAME = "robotether.robotether.robots"

    def verify_file(self, path: str) -> bool:
        """Tell whether the file may be ours; its `plugin` is checked when it is read."""
        return bool(super().verify_file(path)) and path.endswith((".yml", ".yaml"))

    def parse(self, inventory: Any, loader: Any, path: str, cache: bool = True) -> None:
        """Add the robots that the server lists; AnsibleParserError says why it can not."""
        super().parse(inventory, loader, path, cache)
        self._read_config_data(path)
        try:
            answers = self._cached(path) if cache and self.get_option("cache") else None
            if answers is None:
                answers = self._answers()
            if self.get_option("cache"):
                self._cache[self.get_cache_key(path)] = answers
            self._add_all(answers)
        except ServerError as problem:
            raise AnsibleParserError(f"cannot list the robots: {problem}") from problem

    def _cached(self, path: str) -> Mapping[str, Any] | None:
        try:
            answers: Mapping[str, Any] = self._cache[self.get_cache_key(path)]
        except KeyError:
            return None
        # Of the same questions to the same server.
        return answers if answers["asked"] == self._questions() else None

    def _questions(self) -> list[Any]:
        return [self.get_option("server"), self.get_option("jump"), self._groups_by("group")]

    def _groups_by(self, kind: str) -> bool:
        return kind in self.get_option("group_by")

    def _answers(self) -> dict[str, Any]:
        """Return what the server answers, as it is cached."""
        server = Server.of({name: self.get_option(name) for name in ARGUMENTS}, prefix="")
        has_groups = self._groups_by("group")
        return {
            "asked": self._questions(),
            "robots": server.get("/api/v1/robots")["robots"],
            "shells": server.get_text("/api/v1/ssh-config") if self.get_option("jump") else "",
            "grants": server.get("/api/v1/grants")["grants"] if has_groups else [],
        }

    def _add_all(self, answers: Mapping[str, Any]) -> None:
        self.inventory.add_group(ROBOTS)
        self._group_names: dict[str, str] = {}
        for name in ("server", "tls_fingerprint"):
            if value := self.get_option(name):
                self.inventory.set_variable(ROBOTS, ROLE_PREFIX + name, value)
        shells = shells_of(answers["shells"])
        for robot in answers["robots"]:
            if robot["name"] in TAKEN:
                self.display.warning(
                    f"left the robot {robot['name']} out: Ansible would take it for this machine, or in place of all. "
                    "Rename it on the server"
                )
                continue
            has_groups = self._groups_by("group")
            groups = {"groups": user_groups_of(robot, answers["grants"])} if has_groups else {}
            self._add({**robot, **groups}, shells.get(robot["name"], {}))

    def _add(self, robot: Mapping[str, Any], connection: Mapping[str, Any]) -> None:
        name = self.inventory.add_host(plain(robot["name"]), group=ROBOTS)
        # A manager chooses texts of the settings, and a robot its host name: they are never templates here.
        own = {f"robot_{key}": wrap_var(value) for key, value in robot.items()}
        for key, value in {**own, **connection}.items():
            self.inventory.set_variable(name, key, value)
        for group in self._groups_of(robot):
            safe_name = self._sanitize_group_name(group)
            self.inventory.add_child(self.inventory.add_group(safe_name), name)
            if (other := self._group_names.setdefault(safe_name, group)) != group:
                self.display.warning(
                    f"{other} and {group} are both the group {safe_name}: --limit takes the robots of both"
                )
        variables = self.inventory.get_host(name).get_vars()
        is_strict = self.get_option("strict")
        self._set_composite_vars(self.get_option("compose"), variables, name, strict=is_strict)
        self._add_host_to_composed_groups(self.get_option("groups"), {}, name, strict=is_strict)
        self._add_host_to_keyed_groups(self.get_option("keyed_groups"), {}, name, strict=is_strict)

    def _groups_of(self, robot: Mapping[str, Any]) -> Iterator[str]:
        if self._groups_by("site") and robot["site"]:
            yield f"site_{robot['site']}"
        if self._groups_by("state"):
            yield f"state_{state_of(robot)}"
        for group in robot.get("groups", ()):
            yield f"group_{group}"


def state_of(robot: Mapping[str, Any]) -> str:
    """Return online or offline for a robot that is active, else its state."""
    if robot["state"] != "active":
        return str(robot["state"])
    return "online" if robot["online"] else "offline"


def user_groups_of(robot: Mapping[str, Any], grants: list[Mapping[str, Any]]) -> list[str]:
    """Return the user groups whose grant for the robot has not ended, sorted."""
    return sorted(
        {
            grant["group"]
            for grant in grants
            if grant["group"] and _is_for(robot, grant) and not _has_ended(grant["ends_at"])
        }
    )


def _is_for(robot: Mapping[str, Any], grant: Mapping[str, Any]) -> bool:
    at_site = grant["site"] is not None and grant["site"] == robot["site"]
    return bool(grant["all"] or grant["robot"] == robot["name"] or at_site)


def _has_ended(ends_at: str | None) -> bool:
    if ends_at is None:
        return False
    return datetime.fromisoformat(ends_at.replace("Z", "+00:00")) <= datetime.now(timezone.utc)


def shells_of(ssh_config: str) -> dict[str, dict[str, Any]]:
    """Return the connection variables of each robot that has an entry in an OpenSSH configuration."""
    entries: dict[str, dict[str, str]] = {}
    entry: dict[str, str] = {}
    for line in ssh_config.splitlines():
        key, _, value = line.strip().partition(" ")
        if key == "Host":
            entry = entries.setdefault(value, {})
        elif key:
            entry[key] = plain(value)
    return {robot: _connection_of(entry) for robot, entry in entries.items()}


def _connection_of(entry: Mapping[str, str]) -> dict[str, Any]:
    options = " ".join(f"-o {key}={entry[key]}" for key in ("ProxyJump", "HostKeyAlias"))
    digest = hashlib.sha256(f"{entry['Port']} {options}".encode()).hexdigest()
    return {
        "ansible_host": entry["HostName"],
        "ansible_port": int(entry["Port"]),
        "ansible_ssh_common_args": options,
        # Ansible's own path has host, port and user, which robots of two servers may share.
        "ansible_control_path": f"%(directory)s/{digest[:10]}-%%r",
        **({"ansible_user": entry["User"]} if "User" in entry else {}),
    }


def plain(value: str) -> str:
    """Return a name or an address as it is; ServerError for anything that ssh or a shell could misread."""
    if not PLAIN.fullmatch(value):
        raise ServerError(
            f"cannot use {shlex.quote(value)}, which the server answers", "answer_invalid"
        )
    return value
