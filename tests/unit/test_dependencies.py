"""pyproject.toml of agent and server name what each of their programs imports, and no program imports another's."""

import ast
import os
import re
import subprocess
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
import tomllib

ROOT = Path(__file__).resolve().parents[2]
NAME = re.compile(r"[\w.-]+")
LOADED = """
import importlib, sys
for module in sys.argv[1:]:
    importlib.import_module(module)
print(*(module.__file__ for name, module in sys.modules.items() if name.startswith("robotether_")), sep="\\n")
"""


def name_of(requirement):
    """A distribution's name, in one spelling."""
    found = NAME.match(requirement)
    assert found, requirement
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def declared(package, *extras):
    """What a package asks for, and what that needs in turn."""
    project = tomllib.loads((ROOT / package / "pyproject.toml").read_text())["project"]
    left = [*project["dependencies"]]
    for extra in extras:
        left += project["optional-dependencies"][extra]
    found = set()
    while left:
        name = name_of(left.pop())
        if name not in found:
            found.add(name)
            left += [module for module in needed_by(name) if "extra ==" not in module]
    return found


def needed_by(name):
    try:
        return requires(name) or []
    except PackageNotFoundError:
        return []  # for another Python


def imported(*modules):
    """The distributions that a program's own modules import."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", LOADED, *modules],
        env={"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    names = {name for file in done.stdout.splitlines() for name in imports_of(Path(file))}
    return {name_of(owner) for name in names for owner in owners().get(name, ())}


@cache
def owners():
    """The distributions of each name that can be imported; to read them takes a second."""
    return packages_distributions()


def imports_of(file):
    nodes = list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    found = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    found |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name.split(".")[0] for name in found}


@pytest.mark.parametrize(
    ("package", "extras", "modules"),
    [
        ("server", (), ("robotether_server.cli.main", "robotether_server.cli.fleet")),
        ("server", ("web",), ("robotether_server.web.app",)),
        ("server", ("relay",), ("robotether_server.relay.main",)),
        ("server", ("recorder",), ("robotether_server.recorder.main",)),
        ("agent", (), ("robotether_agent.cli", "robotether_agent.daemon")),
    ],
    ids=["command", "web", "relay", "recorder", "agent"],
)
def test_a_program_imports_what_is_declared_for_it(package, extras, modules):
    """So `pip install ./server` is enough for `robotether fleet`, without gunicorn, uvloop and aiohttp."""
    assert imported(*modules) - declared(package, *extras) == set()


def test_the_command_needs_no_server():
    """What serves pages and tunnels stays in the extras."""
    assert not declared("server") & {"gunicorn", "uvloop", "aiohttp", "flask", "prometheus-client"}
