"""The documents: links lead somewhere, files that sources and pages name are there, and commands are understood."""

import re
import shlex
from collections import Counter
from functools import cache
from itertools import pairwise

import click
import documented
import pytest
from documented import FENCED, HISTORY, ROOT, tracked
from robotether_agent.cli import _parser as agent_parser
from robotether_server.cli.main import cli

LINK = re.compile(r"\]\(([^)\s#]*)(?:#([^)\s]*))?\)")
# A file under docs/, as a comment or a message names it.
NAMED = re.compile(r"\bdocs/[\w/.-]+\.(?:md|py|html)\b")
PROGRAM = re.compile(
    r"\s*(?:sudo )?(?:[A-Z_]+=\S+ )*(?:(?:docker compose|tools/compose) exec (?:-T )?web )?"
    r"(robotether|robotether-agent|tools/\w+|make|ansible-playbook)(?: (.*))?$"
)


@cache
def anchors(page):
    """The headings' anchors, as GitHub and its like make them."""
    found = []
    seen = Counter()
    for heading in re.findall(r"^#+ (.+)$", FENCED.sub("", page.read_text()), re.MULTILINE):
        words = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower()
        anchor = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        found.append(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
        seen[anchor] += 1
    return frozenset(found)


def broken(page):
    """Links to files or headings that are not there."""
    for target, anchor in LINK.findall(FENCED.sub("", page.read_text())):
        if re.match(r"[a-z]+:", target):
            continue
        there = (page.parent / target).resolve() if target else page
        if not there.exists() or (
            anchor and there.suffix == ".md" and anchor not in anchors(there)
        ):
            yield f"{page.relative_to(ROOT)}: {target}#{anchor}"


def test_links_lead_somewhere():
    pages = [page for page in tracked("*.md") if "experiments" not in page.parts]
    assert [link for page in pages for link in broken(page)] == []


def test_named_documents_are_there():
    sources = [
        path
        for path in tracked()
        if path.name != HISTORY and not path.is_relative_to(ROOT / "docs" / "experiments")
    ]
    if not sources:
        pytest.skip("this is not a git checkout")
    missing = []
    for path in sources:
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        missing += [
            f"{path.relative_to(ROOT)}: {name}"
            for name in NAMED.findall(text)
            if not (ROOT / name).exists()
        ]
    assert missing == []


def started(page):
    """Yield each program of ours that a page's commands start, with its arguments."""
    for command in documented.commands(page):
        if ours := PROGRAM.match(command):
            yield ours[1], shlex.split(ours[2] or "")


def parse_robotether(arguments):
    """Parse the arguments as the admin command does, and run nothing."""
    command = cli
    while isinstance(command, click.Group) and arguments and not arguments[0].startswith("-"):
        _, subcommand, arguments = command.resolve_command(click.Context(command), arguments)
        assert subcommand is not None
        command = subcommand
    command.make_context(command.name, arguments)


def check_command(program, arguments):
    """Fail unless the program knows the arguments."""
    match program:
        case "robotether":
            parse_robotether(arguments)
        case "robotether-agent":
            agent_parser().parse_args(arguments)
        case "make":
            verbs = re.findall(
                r"^([a-z0-9-]+):.*## ", (ROOT / "Makefile").read_text(), re.MULTILINE
            )
            assert {word for word in arguments if "=" not in word} <= {*verbs}
        case "ansible-playbook":
            books = [
                word
                for option, word in pairwise(["", *arguments])
                if option != "-i" and re.fullmatch(r"\w+\.yml", word)
            ]
            assert all((ROOT / "ansible" / book).exists() for book in books)
        case "tools/compose":
            pass
        case tool:
            source = (ROOT / tool).read_text()
            assert all(word in source for word in arguments if word.startswith("--"))


def misunderstood(program, arguments):
    """Say what is wrong with a command; nothing if it is right."""
    try:
        check_command(program, arguments)
    except click.exceptions.Exit:
        return ""  # --help
    except SystemExit as ended:
        return f"exit {ended.code}" if ended.code else ""
    except (click.UsageError, AssertionError, OSError) as error:
        return str(error)
    return ""


def test_commands_are_understood():
    wrong = [
        f"{page.relative_to(ROOT)}: {program} {shlex.join(arguments)}: {reason}"
        for page in documented.pages()
        for program, arguments in started(page)
        if (reason := misunderstood(program, arguments))
    ]
    assert wrong == []


def how_to_add(what):
    """The item of CONTRIBUTING.md on how to add something."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    items = text.split("## How to add", 1)[1].split("\n## ", 1)[0].split("\n- ")
    [found] = [item for item in items if item.startswith(f"**{what}**")]
    return found


@pytest.mark.parametrize(
    ("what", "table"),
    [("A codec", "robotether_common.codecs"), ("A forwarded port", "robotether_common.services")],
)
def test_what_a_table_is_used_by_is_named(what, table):
    """How to add a row names the table and each module of the product that reads it."""
    readers = {
        str(path.relative_to(ROOT))
        for path in tracked("*.py")
        if {"tests", "benchmarks"}.isdisjoint(path.parts)
        and f"from {table} import" in path.read_text()
    }
    assert readers
    assert readers <= set(re.findall(r"`([\w/.-]+)`", how_to_add(what)))


# Where the paths begin that a page names.
FOLDERS = [ROOT, *(ROOT / "server" / path for path in ("robotether_server", "frontend/src"))]
FOLDERS += [ROOT / "server/robotether_server/relay", ROOT / "agent/robotether_agent"]


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/explanation/architecture.md"])
def test_files_of_the_tree_are_there(page):
    named = re.findall(r"`([\w.-]+/[\w/.-]+\.\w+)`", (ROOT / page).read_text())
    assert [name for name in named if not any((f / name).exists() for f in FOLDERS)] == []
    assert len(named) > 40


def test_each_path_of_the_relay_has_its_place_in_nginx():
    """Nginx leads what the relay's code routes to the relay, and the description of the API names it."""
    sources = ("control/control_api.py", "channels/kinds.py")
    relay = ROOT / "server" / "robotether_server" / "relay"
    paths = [
        re.sub(r"\{[^}]*\}", "x", path)
        for source in sources
        for path in re.findall(r'"(/(?:api|robots)/[^"]*)"', (relay / source).read_text())
    ]
    text = (ROOT / "images" / "nginx" / "nginx.conf").read_text()
    located = [
        rf"{re.escape(path)}$" if sign == "=" else path.strip('"')
        for sign, path in re.findall(r"location (=|~) (\S+) \{", text)
    ]
    assert [path for path in paths if not any(re.match(item, path) for item in located)] == []
