"""compose/.env.example, compose.yaml and the server's settings say the same."""

import json
import re
from pathlib import Path

import pytest
import yaml
from commands import output_of_command
from robotether_agent import __version__ as agent_version
from robotether_server import __version__ as server_version
from robotether_server.settings.server import VARIABLES

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = ROOT / "compose"
# Derived when empty: from the published ports, from this checkout's version; or no file.
DERIVED = {"SSH_PORTS", "PUBLIC_PORT", "REGISTRY", "PULL_POLICY", "TAG"}
DERIVED |= {"TLS_CERT_FILE", "TLS_KEY_FILE", "CA_BUNDLE"}
READ_BY_COMPOSE = {"COMPOSE_PROFILES"}
READ_BY_TOOLS = {"BACKUP_COPY_COMMAND"}


def example():
    """Name -> (default, the comment above it, which may speak of several variables)."""
    found = {}
    comment, above = "", ""
    for line in (COMPOSE / ".env.example").read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            above += line.lstrip("#")
        elif "=" in line:
            name, default = line.split("=", 1)
            comment, above = above or comment, ""
            found[name] = (default, comment)
        else:
            comment, above = "", ""
    return found


def used():
    """Name -> defaults with which the compose files use it."""
    found = {}
    for file in COMPOSE.glob("*.yaml"):
        for name, default in re.findall(
            r"\$\{([A-Z0-9_]+):-([^}$]*)", file.read_text(encoding="utf-8")
        ):
            found.setdefault(name, set()).add(default)
    return found


# Every service, of all profiles.
ALL_SERVICES = yaml.safe_load((COMPOSE / "compose.yaml").read_text(encoding="utf-8"))["services"]


def set_by_compose():
    """The settings, perhaps from the file of a secret, that compose.yaml gives to the server's programs."""
    variables = {
        variable
        for service in ALL_SERVICES.values()
        if "robotether/server:" in service["image"]
        for variable in service.get("environment", ())
    }
    return {name if name in VARIABLES else name.removesuffix("_FILE") for name in variables}


@pytest.mark.parametrize("overlay", ["database.yaml", "cell.yaml"])
def test_programs_of_a_site_reach_its_database_by_tls(overlay):
    """It refuses all other connections."""
    command = ["docker", "compose", "--env-file", "/dev/null", "--profile", "*"]
    command += ["--file", "compose.yaml", "--file", overlay, "config", "--format", "json"]
    services = json.loads(output_of_command(*command, cwd=COMPOSE))["services"].values()
    reading = [
        it["environment"]
        for it in services
        if it.get("networks") and "DB_PORT" in it.get("environment", ())
    ]
    assert reading
    assert {environment["DB_CA_FILE"] for environment in reading} == {
        "/run/secrets/database_ca.pem"
    }


def test_example_has_exactly_what_compose_reads():
    assert set(example()) == set(used()) | READ_BY_COMPOSE | READ_BY_TOOLS


@pytest.mark.parametrize("name", sorted(used()))
def test_defaults_are_the_same_everywhere(name):
    """What the example shows is what compose and the server take without it."""
    default, comment = example()[name]
    assert comment, f"{name} has no explanation"
    if name not in DERIVED:
        assert used()[name] == {default}
        if name in VARIABLES:
            assert VARIABLES[name].default == default


def test_a_wrong_value_ends_the_start_before_anything_runs():
    """The one-shot service `settings` reads all that the others read, but secrets and what is fixed inside."""
    ours = ALL_SERVICES["settings"]["environment"]
    site = {
        name: text
        for item in ("web", "relay", "recorder", "migrate")
        for name, text in ALL_SERVICES[item]["environment"].items()
        if text.startswith("${") and name != "DIRECT_PORTS"
    }
    nginx = {name: f"${{{name}:-}}" for name in ("DIRECT_SOURCES", "TRUSTED_PROXIES")}
    site |= ALL_SERVICES["acme"]["environment"] | ALL_SERVICES["alertmanager"]["environment"]
    others = {
        name: f"${{{name}:-{VARIABLES[name].default}}}"
        for name in example()
        if name.startswith("SIM") or name in {"DB_SERVER_ID", "DB_PARTNER", "DB_READ_ONLY"}
    }
    assert {name: text for name, text in ours.items() if name != "DB_NAME"} == site | nginx | others


def test_compose_sets_every_setting_and_nothing_else():
    """It leaves out only fixed places inside the image."""
    inside = {
        f"{name}_DIR" for name in ("AGENT_FILES", "SSH_HOST_KEYS", "MIGRATIONS", "RECORDINGS")
    }
    inside |= {"RELAY_HOST", "PROMETHEUS"}
    assert set_by_compose() == set(VARIABLES) - inside


def test_everything_has_one_version():
    """Agent, server, collection, compose.yaml and docker-bake.hcl name one; the last three can read it nowhere."""
    collection = yaml.safe_load((ROOT / "ansible" / "galaxy.yml").read_text(encoding="utf-8"))
    assert {server_version} == {agent_version, collection["version"]} | used()["TAG"]
    bake = (ROOT / "docker-bake.hcl").read_text(encoding="utf-8")
    assert re.findall(r'"VERSION" \{[^}]*default = "(.*)"', bake) == [server_version]


def test_ports_are_published_at_the_bind_address():
    """None is open over IPv6, where all clients would be one address, by having been forgotten."""
    ports = [port for service in ALL_SERVICES.values() for port in service.get("ports", [])]
    assert ports
    assert [port for port in ports if not port.startswith("${BIND_ADDRESS:-0.0.0.0}:")] == []
