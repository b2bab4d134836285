"""Finds the tests that start processes, and those that wait for a network or a clock, by what their code names."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from inspect import unwrap
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import pytest

TESTS = str(Path(__file__).resolve().parents[2])
# Of each mark: modules, and functions and classes of any module.
NAMES = {
    "daemon": {
        *("docker", "multiprocessing", "subprocess"),
        *("create_subprocess_exec", "create_subprocess_shell", "sync_playwright"),
    },
    "waits": {
        *("sleep", "open_connection", "open_unix_connection", "start_server", "start_unix_server"),
        *("AppRunner", "ClientSession", "TCPSite", "create_connection", "create_server"),
    },
}


def marks_of(item: pytest.Item) -> list[str]:
    """Say what a test, its fixtures, or code of the tests that they name, however far, may do."""
    if not isinstance(item, pytest.Function):
        return list(NAMES)
    everyones = [
        entry.func for found in item._fixtureinfo.name2fixturedefs.values() for entry in found
    ]
    functions = {
        "daemon": [item.function, *everyones],
        # What all tests of a folder do at their end is no reason.
        "waits": [item.function, *fixtures_of(item)],
    }
    return [mark for mark in NAMES if any(may(mark, function) for function in functions[mark])]


def fixtures_of(item: pytest.Function) -> Iterator[object]:
    """Functions of the fixtures that a test asks for, also by way of others."""
    found = item._fixtureinfo.name2fixturedefs
    asked = {mark for marker in item.iter_markers("usefixtures") for mark in marker.args}
    waiting, seen = [*item._fixtureinfo.argnames, *asked], set[str]()
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            for fixture in found.get(name, ()):
                waiting += fixture.argnames
                yield fixture.func


@cache
def may(mark: str, start: object) -> bool:
    """Whether the function or class names what the mark is about, or something of the tests that does."""
    seen: set[object] = set()
    waiting = {start}
    while waiting:
        found = waiting.pop()
        seen.add(found)
        names, reached = named_by(found)
        if names & NAMES[mark]:
            return True
        waiting |= reached - seen
    return False


@cache
def named_by(found: object) -> tuple[frozenset[str], frozenset[object]]:
    """All names that a function or class looks up, and the functions and classes behind them."""
    every, reached = set[str](), set[object]()
    for function in functions_of(found):
        names = names_in(function.__code__)
        values = [function.__globals__.get(name) for name in names]
        for module in [value for value in values if isinstance(value, ModuleType)]:
            values += [vars(module).get(name) for name in names]
        every |= names
        reached |= {value for value in values if isinstance(value, FunctionType | type)}
    return frozenset(every), frozenset(reached)


def functions_of(found: object) -> Iterator[FunctionType]:
    """Functions of the tests' own code: the function itself, or a class's."""
    if isinstance(found, type):
        inside = [value for base in found.__mro__ for value in vars(base).values()]
        values = [getattr(value, "__func__", getattr(value, "fget", value)) for value in inside]
    else:
        values = [found]
    for value in values:
        # A decorator such as contextmanager has wrapped it.
        function = unwrap(value) if isinstance(value, FunctionType) else None
        if isinstance(function, FunctionType) and function.__code__.co_filename.startswith(TESTS):
            yield function


@cache
def names_in(code: CodeType) -> frozenset[str]:
    inner = (names_in(const) for const in code.co_consts if isinstance(const, CodeType))
    return frozenset(code.co_names).union(*inner)
