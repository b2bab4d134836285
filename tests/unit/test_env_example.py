"""compose/.env.example, compose.yaml and the server's settings say the same."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from robotether_agent import __version__ as agent_version
from robotether_server import __version__ as server_version
from robotether_server.settings.server import VARIABLES

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = ROOT / "compose"
# Derived when empty: from the published ports, from this checkout's version; or no file.
DERIVED = {
    "SSH_PORTS",
    "PUBLIC_PORT",
    "REGISTRY",
    "PULL_POLICY",
    "TAG",
    "TLS_CERT_FILE",
    "TLS_KEY_FILE",
    "CA_BUNDLE",
}
READ_BY_COMPOSE = {"COMPOSE_PROFILES"}
READ_BY_TOOLS = {"BACKUP_COPY_COMMAND"}


def example() -> dict[str, tuple[str, str]]:
    """Name -> (default, the comment above it, which may speak of several variables)."""
    found: dict[str, tuple[str, str]] = {}
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


def used() -> dict[str, set[str]]:
    """Name -> defaults with which the compose files use it."""
    found: dict[str, set[str]] = {}
    for file in COMPOSE.glob("*.yaml"):
        for name, default in re.findall(
            r"\$\{([A-Z0-9_]+):-([^}$]*)", file.read_text(encoding="utf-8")
        ):
            found.setdefault(name, set()).add(default)
    return found


def services() -> dict[str, dict[str, Any]]:
    """Every service of compose.yaml, of all profiles."""
    read = yaml.safe_load((COMPOSE / "compose.yaml").read_text(encoding="utf-8"))
    found: dict[str, dict[str, Any]] = read["services"]
    return found


def environments() -> list[tuple[str, str]]:
    """(service, variable) of everything that compose.yaml gives to the server's programs."""
    return [
        (name, variable)
        for name, service in services().items()
        if "robotether/server:" in service["image"]
        for variable in service.get("environment", ())
    ]


def setting_of(variable: str) -> str:
    """The setting that a variable gives, perhaps from the file of a secret."""
    return variable if variable in VARIABLES else variable.removesuffix("_FILE")


def bake_targets() -> dict[str, dict[str, str]]:
    """Target -> (key -> text) of docker-bake.hcl, as far as it stands on a line."""
    text = (ROOT / "docker-bake.hcl").read_text(encoding="utf-8")
    blocks = re.findall(
        r'^(?:target|variable) "(\w+)" \{\n(.*?)^\}', text, re.DOTALL | re.MULTILINE
    )
    return {
        name: dict(re.findall(r"^ +(\w+) += (.*)$", body, re.MULTILINE)) for name, body in blocks
    }


def collection_version() -> str:
    """The version of the Ansible collection."""
    read = yaml.safe_load((ROOT / "ansible" / "galaxy.yml").read_text(encoding="utf-8"))
    return str(read["version"])


def test_example_has_exactly_what_compose_reads() -> None:
    """No variable is missing from the example, and none stands there that nothing reads."""
    assert set(example()) == set(used()) | READ_BY_COMPOSE | READ_BY_TOOLS


@pytest.mark.parametrize("name", sorted(used()))
def test_defaults_are_the_same_everywhere(name: str) -> None:
    """What the example shows is what compose and the server take without it."""
    default, comment = example()[name]
    assert comment, f"{name} has no explanation"
    if name not in DERIVED:
        assert used()[name] == {default}
        if name in VARIABLES:
            assert VARIABLES[name].default == default


@pytest.mark.parametrize("name", sorted(set(example()) & set(VARIABLES)))
def test_example_says_what_is_allowed(name: str) -> None:
    """The range that the server accepts stands in the explanation."""
    allowed = re.match(r"\d+ to \d+", VARIABLES[name].allowed)
    if allowed:
        assert allowed[0] in example()[name][1]


@pytest.mark.parametrize(("service", "variable"), environments())
def test_server_reads_what_compose_sets(service: str, variable: str) -> None:
    """No service gets a variable that no program knows, such as a misspelt one."""
    assert setting_of(variable) in VARIABLES


def test_a_wrong_value_ends_the_start_before_anything_runs() -> None:
    """The one-shot service `settings` reads all that the others read, but secrets and what is fixed inside."""
    ours = services()["settings"]["environment"]
    site = {
        name: text
        for item in ("web", "relay", "recorder", "migrate")
        for name, text in services()[item]["environment"].items()
        if text.startswith("${") and name != "DIRECT_PORTS"
    }
    nginx = {name: f"${{{name}:-}}" for name in ("DIRECT_SOURCES", "TRUSTED_PROXIES")}
    site |= services()["alertmanager"]["environment"]
    assert {name: text for name, text in ours.items() if name != "DB_NAME"} == site | nginx


def test_every_setting_can_be_set() -> None:
    """Whatever the server's settings know is set in compose.yaml, or is a fixed place inside the image."""
    inside = {
        "AGENT_FILES_DIR",
        "SSH_HOST_KEYS_DIR",
        "MIGRATIONS_DIR",
        "RECORDINGS_DIR",
        "RELAY_HOST",
        "PROMETHEUS",
    }
    assert {setting_of(variable) for _, variable in environments()} == set(VARIABLES) - inside


def test_everything_has_one_version() -> None:
    """Agent, server, collection, compose.yaml and docker-bake.hcl name one; the last three can read it nowhere."""
    assert {server_version} == {agent_version} | {collection_version()} | used()["TAG"]
    assert bake_targets()["VERSION"]["default"] == f'"{server_version}"'
    assert bake_targets()["TAG"]["default"] == "VERSION"


def image_of(service: dict[str, Any]) -> str:
    """The name of a service's image without registry and tag."""
    pattern = r"\$\{REGISTRY:-local\.invalid/\}robotether/(\w+):\$\{TAG:-[0-9.]+\}"
    found = re.fullmatch(pattern, service["image"])
    assert found is not None, service["image"]
    return found[1]


@pytest.mark.parametrize("name", sorted({image_of(item) for item in services().values()}))
def test_every_image_is_built_by_one_service(name: str) -> None:
    """Compose builds it from the files and under the name that docker-bake.hcl has, and pulls it only if asked to."""
    of_image = [service for service in services().values() if image_of(service) == name]
    for service in of_image:
        assert (
            service["pull_policy"]
            == f"${{PULL_POLICY:-{'build' if 'build' in service else 'never'}}}"
        )
    [build] = [service["build"] for service in of_image if "build" in service]
    target = bake_targets()[name]
    assert f'"${{REGISTRY}}robotether/{name}:${{TAG}}"' in target["tags"]
    context = build if isinstance(build, str) else build["context"]
    assert (COMPOSE / context).resolve() == (ROOT / target["context"].strip('"')).resolve()
    if isinstance(build, dict):
        assert f'"{build["dockerfile"]}"' == target["dockerfile"]
        assert ("ca" in build["secrets"]) == ("id=ca" in target["secret"])


def published() -> list[str]:
    """Every published port, as it stands there."""
    return [port for service in services().values() for port in service.get("ports", [])]


@pytest.mark.parametrize("port", published())
def test_ports_are_published_at_the_bind_address(port: str) -> None:
    """None is open over IPv6, where all clients would be one address, by having been forgotten."""
    assert port.startswith("${BIND_ADDRESS:-0.0.0.0}:")
