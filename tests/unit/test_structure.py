"""Names in the product, the order of its scripts, and the folders of tests. pyproject.toml has the order of Python."""

import ast
import re
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests" / "unit"
PACKAGES = {
    "common": ROOT / "common" / "robotether_common",
    "server": ROOT / "server" / "robotether_server",
    "agent": ROOT / "agent" / "robotether_agent",
    "sim_robot": ROOT / "images" / "sim_robot" / "sim_robot",
}


@cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


# The folders of the scripts by rank: one imports from itself and from those of lower ranks.
SCRIPT_RANKS = (
    "decoders texts",
    "client",
    "dom",
    "control input overlays queue topics",
    "fleet health replay video",
    "pages",
)
SCRIPT_RANK = {folder: rank for rank, row in enumerate(SCRIPT_RANKS) for folder in row.split()}
SCRIPTS_ROOT = ROOT / "server" / "frontend" / "src"
SCRIPTS = [*SCRIPTS_ROOT.rglob("*.js")]
SCRIPT_IMPORT = re.compile(r'(?:\bfrom |\bimport |\bimport\()"(\.[^"]+)"')


def script_graph():
    """What each script imports, types in comments too."""
    return {
        path: {
            (path.parent / name).resolve()
            for name in SCRIPT_IMPORT.findall(path.read_text(encoding="utf-8"))
        }
        for path in SCRIPTS
    }


def test_scripts_imports_go_one_way():
    """A script imports from lower ranks and its own folder, and never in a circle."""
    links = script_graph()
    assert set().union(*links.values()) <= set(links)
    wrong = [
        f"{path.relative_to(SCRIPTS_ROOT)} imports {imported.relative_to(SCRIPTS_ROOT)}"
        for path, imports_of_it in links.items()
        for imported in imports_of_it
        if imported.parent != path.parent
        and SCRIPT_RANK[imported.parent.name] >= SCRIPT_RANK[path.parent.name]
    ]
    assert sorted(wrong) == []
    TopologicalSorter(links).prepare()


@pytest.mark.parametrize("name", PACKAGES)
def test_every_folder_of_tests_has_its_package(name):
    folders = {path.parent.relative_to(TESTS / name) for path in (TESTS / name).rglob("test_*.py")}
    assert [f for f in sorted(folders) if not (PACKAGES[name] / f / "__init__.py").exists()] == []


# Words of our own, and the field's words for them. None is a word of an identifier, in singular or plural.
BANNED_WORDS = {
    "helm joint keeper bench": "drive_controller, client_proxy, guard_supervisor, spare",
    "marking order reach patience": "motion_state, message, command, robot_dialer, timeout",
    "authority admission allowance": "authorization, rate_limiter",
    "wish want gate": "requested_features, stream_request, rate_limiter, message_validator",
    "handover door front": "fd_passing, video_proxy, site_certificate",
    "pace budget meter": "pacer, bandwidth_estimator, probe",
    "unfinished switching forgetting": "pending_upgrade, upgrade, unenrol",
    "examination board delivery": "doctor, fleet_events, viewer_stats",
    "ending deed unsure": "close_reason, closing, action, ConfirmedAction, focusLoss",
    "seat came told visit visitor": "DriveLease, on_command, connected, session, current_user",
    "moment beat picture": "timestamp, clock_sync, frame",
    "vouching stranger crew mission": "enrolment_credentials, unknown_robots, fleet_run",
    "wheel truth sight sighthold": "controlPanel, safety, video, videoInterlock",
    "outlook lookout": "statusSelector, observerConnection",
}
# Ordinary words, banned as the whole name of a class, function, module, folder or script's export.
BANNED_NAMES = {
    "Gate Kept Order Own Parts Shown": "message_validator, Command, LocalService, PresentedKey",
    "way race pass_socket rounds marks": "server_dialer, happy_eyeballs, motion_state",
    "switch kept kept_identity managed left": "source_switch, identity_store, permissions",
    "why EndedError means": "describe_error, ConnectionClosed, HandlerContext, AppContext",
    "ages records reports latencies": "timestamps, database, observers, latency_histogram",
    "trip deeds heavy vitals still": "latencyBreakdown, robotButtons, largeTypes, overlays",
    "moves rest news": "reorder, pointerPause, controlState",
}
# As the first word of a function or export.
BANNED_VERBS = {"hear", "look", "stand", "take", "tell"}
# Pronouns and participles, banned as the whole name of a variable: they do not say of what.
BANNED_VARIABLES = "asked found given heard kept known one ones said shown this told wanted whose"
# Standard terms, or fixed names, each in its files.
ALLOWED = {
    ("Handover", "robots/lease.py"): "of control, from a driver to the next",
    ("_check_authority", "doctor/server.py"): "a certificate authority",
    ("KNOWN", "robotether_common/topics.py"): "a member of a query",
    ("authority", "net/http_proxy.py"): "host and port, in RFC 3986",
    ("authority", "robotether_server/install_line.py"): "host and port, in RFC 3986",
    ("inNameOrder", "fleet/filters.js"): "sorted",
    ("inOrder", "fleet/filters.js"): "sorted",
    ("in_order", "robotether_agent/"): "one after the other",
    ("moves", "guard/drive_messages.py"): "of a robot",
    ("records", "relay/records/"): "of the database, the audit and drives",
    ("switch", "robotether_agent/cli.py"): "a command of the program",
    ("take", "server/robotether_server/relay/"): "an action of the API",
    ("wanted", "robotether_agent/upgrade.py"): "a member of a file",
    ("tls_front", "robotether_server/settings/server.py"): "TLS_FRONT's field",
}
WHOLE = set(" ".join(BANNED_NAMES).split())
SINGULAR = " ".join(BANNED_WORDS).split()
FORMS = {f"{word}{end}" for word in SINGULAR for end in ("", "s", "es")} | {"deliveries"}
PRODUCT = [path for package in PACKAGES.values() for path in package.rglob("*.py")]
EXPORT = re.compile(r"^export (?:async )?(?:function\*?|class|const|let) (\w+)", re.MULTILINE)


def named_in(path):
    """What a file names: itself, its folder, its scripts' exports, and all that Python gives a name."""
    yield from (("module", path.stem), ("module", path.parent.name))
    if path.suffix == ".js":
        yield from (("function", name) for name in EXPORT.findall(path.read_text(encoding="utf-8")))
        return
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ClassDef):
            yield "class", node.name
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield "function", node.name
        elif isinstance(node, ast.arg):
            yield "variable", node.arg
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield "variable", node.id if isinstance(node, ast.Name) else node.attr


def is_banned(kind, name):
    parts = [part.lower() for part in re.findall("[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]
    return (
        not FORMS.isdisjoint(parts)
        or (kind != "variable" and name.strip("_") in WHOLE)
        or (kind == "variable" and name.strip("_").lower() in BANNED_VARIABLES.split())
        or (kind == "function" and not BANNED_VERBS.isdisjoint(parts[:1]))
    )


def test_no_class_name_stands_twice():
    names = [name for path in PRODUCT for kind, name in named_in(path) if kind == "class"]
    assert [name for name, count in Counter(names).items() if count > 1] == []


def test_no_identifier_has_a_banned_word():
    """Names are the field's own terms; an exception that nothing needs any more goes, too."""
    found = {
        (name, str(path.relative_to(ROOT)))
        for path in (*PRODUCT, *SCRIPTS)
        for kind, name in named_in(path)
        if is_banned(kind, name)
    }
    allowed = {
        (item, key) for item in found for key in ALLOWED if item[0] == key[0] and key[1] in item[1]
    }
    assert sorted(found - {item for item, _ in allowed}) == []
    assert sorted(set(ALLOWED) - {key for _, key in allowed}) == []


def test_no_loop_calls_its_subject_one():
    """What a loop of a template, or a loop or a lambda of the tests, has in hand has the noun of the thing."""
    pronoun = re.compile(r"\b(?:for|lambda) (?:\w+, )*one\b(?= in|[:,])")
    files = [path for name in ("tests", "benchmarks") for path in (ROOT / name).rglob("*.py")]
    # Copies of the sources, such as those of tools/mutants.py, lie there.
    files = [path for path in files if ROOT / "tests" / "artifacts" not in path.parents]
    files += PACKAGES["server"].rglob("*.html")
    assert [str(path) for path in files if pronoun.search(path.read_text("utf-8"))] == []


# The first word of a comment above a constant that is a number: it names the quantity.
QUANTITIES = (
    "Age Bits Close Default Delay Depth Difference Divisor Duration Error Exit First Flag Gain Interval Length Limit "
    "Margin Maximum Minimum Number Numbers Part Pause Port Rate Ratio Reason Request Size Time"
)


def numbers_with_comments(path):
    """Name and comment of each constant of a module that is a number and has a comment above it."""
    lines = path.read_text(encoding="utf-8").splitlines()
    for node in tree(path).body:
        if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
            continue
        value, above = node.value, node.lineno - 1
        is_number = isinstance(value, ast.BinOp) or (
            isinstance(value, ast.Constant) and isinstance(value.value, int | float)
        )
        while lines[above - 1].startswith("# "):
            above -= 1
        if is_number and above < node.lineno - 1:
            yield node.targets[0].id, lines[above].removeprefix("# ")


def test_comments_of_constants_name_the_quantity():
    """A comment above a number begins with what the number is: a time limit, a maximum, a size."""
    comments = [(path, *found) for path in PRODUCT for found in numbers_with_comments(path)]
    assert len(comments) > 100
    assert [
        f"{path.relative_to(ROOT)}: {name}: {comment}"
        for path, name, comment in comments
        if comment.split()[0].rstrip(",:") not in QUANTITIES.split() and name.isupper()
    ] == []


def test_no_sentence_says_so_long():
    """Comments and docstrings name a time or a number instead of "so long" and "so many"."""
    vague = re.compile(r"\bso (?:long|many|often)\b", re.IGNORECASE)
    said = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in PRODUCT
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if vague.search(line)
    ]
    assert said == []
