"""The shape of the packages: which way imports go, and that the tests mirror the sources."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests" / "unit"
PACKAGES = {
    "server": ROOT / "server" / "robotether_server",
    "agent": ROOT / "agent" / "robotether_agent",
    "sim_robot": ROOT / "images" / "sim_robot" / "sim_robot",
}
# The agent's test files are named after what a user relies on, in folders as the package has them.
# The simulated robot is a double, tested by its use.
BY_MODULE = ("server",)
# A layer may import from itself and from those before it. Names that no layer claims are `base`.
LAYERS = ("base", "db", "services", "api", "web", "relay", "cli")
MAY_IMPORT = {
    "base": {"base", "db"},  # migrate and the like stand beside its users
    "db": {"base", "db"},
    "services": {"base", "db", "services"},
    "api": {"base", "db", "services", "api"},
    "web": {"base", "db", "services", "api", "web"},
    "relay": {"base", "db", "relay"},
    "cli": {"base", "db", "services", "cli"},
}
# The agent's. What is in none of these folders is base, but for what puts the parts together.
AGENT_TOP = ("cli", "daemon", "doctor", "health", "__main__")
AGENT_MAY_IMPORT = {
    "base": {"base"},
    "net": {"base", "net"},
    "enrolment": {"base", "net", "enrolment"},
    "tunnel": {"base", "net", "enrolment", "tunnel"},
    "guard": {"base", "guard"},
    "video": {"base", "video"},
}
FOUNDATION = ("problems", "settings", "variables", "tickets", "macs", "ssh_keys")


def modules(package: Path) -> dict[str, Path]:
    """Every module of a package by its dotted name."""
    found = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, known: dict[str, Path]) -> set[str]:
    """The package's own modules that one of them imports when it is loaded."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            base = str(node.module)
            named = {f"{base}.{alias.name}" for alias in node.names}
            # `from package import module` needs the module, not the package's own names.
            found |= {name if name in known else base for name in named}
    return found & set(known)


def graph(name: str) -> dict[str, set[str]]:
    known = modules(PACKAGES[name])
    return {module: imports(path, known) - {module} for module, path in known.items()}


def nested_imports(path: Path) -> Iterator[str]:
    """Imports inside functions."""
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for node in ast.walk(function):
                if isinstance(node, ast.Import | ast.ImportFrom):
                    yield f"{path}:{node.lineno}"


def layer(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in LAYERS else "base"


@pytest.mark.parametrize("name", PACKAGES)
def test_no_imports_in_a_circle(name: str) -> None:
    """Every package can be read from the bottom to the top."""
    TopologicalSorter(graph(name)).prepare()


@pytest.mark.parametrize("name", PACKAGES)
def test_no_import_hides_in_a_function(name: str) -> None:
    """What a module needs stands at its top."""
    hidden = [line for path in PACKAGES[name].rglob("*.py") for line in nested_imports(path)]
    assert hidden == []


def test_servers_imports_go_one_way() -> None:
    """Settings and problems, the database, services, the API, then web and cli; the relay meets none of these four."""
    wrong = [
        f"{module} imports {imported}"
        for module, imported_modules in graph("server").items()
        for imported in imported_modules
        if layer(imported) not in MAY_IMPORT[layer(module)]
    ]
    assert wrong == []


def agent_layer(module: str) -> str:
    part = [*module.split("."), ""][1]
    return "top" if part in AGENT_TOP else part if part in AGENT_MAY_IMPORT else "base"


def test_agents_imports_go_one_way() -> None:
    """From what it stands on to the network, enrolment, the tunnel and the daemon; guard and video stand beside."""
    wrong = [
        f"{module} imports {imported}"
        for module, imported_modules in graph("agent").items()
        for imported in imported_modules
        if agent_layer(module) != "top"
        and agent_layer(imported) not in AGENT_MAY_IMPORT[agent_layer(module)]
    ]
    assert wrong == []


def test_servers_foundation_imports_no_database() -> None:
    """What the database layer stands on does not need it."""
    links = graph("server")
    for module in FOUNDATION:
        assert all(layer(name) == "base" for name in links[f"robotether_server.{module}"]), module


def sources(name: str) -> set[str]:
    """Modules of a package, but for the starts of packages and programs."""
    package = PACKAGES[name]
    return {
        str(path.relative_to(package).with_suffix(""))
        for path in package.rglob("*.py")
        if not path.stem.startswith("__")
    }


def does_something(path: Path) -> bool:
    """Whether a module has a function of its own; exceptions and constants alone need no tests."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return any(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in ast.walk(tree))


def modules_with_tests(name: str) -> set[str]:
    """Test files, by the module that they are named after."""
    folder = TESTS / name
    return {
        str(path.relative_to(folder).with_name(path.stem.removeprefix("test_")))
        for path in folder.rglob("test_*.py")
    }


@pytest.mark.parametrize("name", BY_MODULE)
def test_every_module_has_its_tests(name: str) -> None:
    """tests/unit/PACKAGE/x/test_y.py tests x/y.py."""
    without = sources(name) - modules_with_tests(name)
    package = PACKAGES[name]
    assert [m for m in sorted(without) if does_something(package / f"{m}.py")] == []


@pytest.mark.parametrize("name", BY_MODULE)
def test_every_test_file_has_its_module(name: str) -> None:
    """A module that moves takes its tests along."""
    starts = {"main"} if (PACKAGES[name] / "__main__.py").exists() else set()
    assert sorted(modules_with_tests(name) - sources(name) - starts) == []


@pytest.mark.parametrize("name", PACKAGES)
def test_every_folder_of_tests_has_its_package(name: str) -> None:
    """A package that moves takes its tests along."""
    folders = {path.parent.relative_to(TESTS / name) for path in (TESTS / name).rglob("test_*.py")}
    assert [f for f in sorted(folders) if not (PACKAGES[name] / f / "__init__.py").exists()] == []
