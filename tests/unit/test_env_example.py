"""compose/.env.example, compose.yaml and the server's settings say the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from robotether_server.variables import VARIABLES

COMPOSE = Path(__file__).resolve().parents[2] / "compose"
KNOWN = {variable.name: variable for variable in VARIABLES}
# Derived from the published ports when empty, and set by tools/up alone.
DERIVED = {"SSH_PORTS", "PUBLIC_PORT"}
FROM_TOOLS = {"DEMO_TLS_FINGERPRINT"}


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
            r"\$\{([A-Z_]+):-([^}$]*)", file.read_text(encoding="utf-8")
        ):
            found.setdefault(name, set()).add(default)
    return found


def read_by_tools() -> set[str]:
    """What tools/up asks for and compose does not."""
    up = (COMPOSE.parent / "tools" / "up").read_text(encoding="utf-8")
    return set(re.findall(r"--env ([A-Z_]+)", up))


def environments() -> list[tuple[str, str]]:
    """(service, variable) of everything that compose.yaml gives to the server's programs."""
    services = yaml.safe_load((COMPOSE / "compose.yaml").read_text(encoding="utf-8"))["services"]
    return [
        (name, variable)
        for name, service in services.items()
        if service["image"].startswith("robotether/server:")
        for variable in service["environment"]
    ]


def test_example_has_exactly_what_compose_reads() -> None:
    """No variable is missing from the example, and none stands there that nothing reads."""
    assert set(example()) == (set(used()) | read_by_tools()) - FROM_TOOLS


@pytest.mark.parametrize("name", sorted(set(used()) - FROM_TOOLS))
def test_defaults_are_the_same_everywhere(name: str) -> None:
    """What the example shows is what compose and the server take without it."""
    default, comment = example()[name]
    assert comment, f"{name} has no explanation"
    if name not in DERIVED:
        assert used()[name] == {default}
        if name in KNOWN:
            assert KNOWN[name].default == default


@pytest.mark.parametrize("name", sorted(set(example()) & set(KNOWN)))
def test_example_says_what_is_allowed(name: str) -> None:
    """The range that the server accepts stands in the explanation."""
    allowed = re.match(r"\d+ to \d+", KNOWN[name].allowed)
    if allowed:
        assert allowed[0] in example()[name][1]


@pytest.mark.parametrize(("service", "variable"), environments())
def test_server_reads_what_compose_sets(service: str, variable: str) -> None:
    """No service gets a variable that no program knows, such as a misspelt one."""
    assert variable.removesuffix("_FILE") in KNOWN


def test_every_setting_can_be_set() -> None:
    """Whatever the server's settings know is set in compose.yaml, or is a fixed place inside the image."""
    inside = {"AGENT_FILES_DIR", "SSH_HOST_KEYS_DIR", "MIGRATIONS_DIR"}
    assert {variable.removesuffix("_FILE") for _, variable in environments()} == set(KNOWN) - inside
