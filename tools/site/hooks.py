"""Makes the documents into a site: adds the reference that comes from the code, and the policy for browsers.

MkDocs calls the functions on_*. Three pages of the reference have no source of their own but the server's: they
cannot say what it does not do.
"""

from __future__ import annotations

import base64
import hashlib
import inspect
import json
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from robotether_server import problems
from robotether_server.api import description
from robotether_server.contract.codes import CLOSE_CODES
from robotether_server.relay.channels.rosbridge.operations import OPERATIONS
from robotether_server.relay.http import close_reasons
from robotether_server.settings.robot import DEFAULTS
from robotether_server.settings.server import VARIABLES, Variable

ROOT = Path(__file__).resolve().parents[2]
OUTWARD = re.compile(r"\[([^\]]*)\]\(((?:\.\./)+[^)#\s]*)(?:#[^)]*)?\)")
# The policy of the site's pages, in the site's folder: web reads it there.
POLICY = "policy"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the front page and the pages that come from the code; name each decision in the menu."""
    made = {
        "index.md": front_page(),
        "reference/server-settings.md": server_settings(),
        "reference/api.md": api(description.document()),
        "reference/operations.md": operations(),
        "reference/codes.md": codes(),
    }
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    decisions = sorted(file.src_uri for file in files if file.src_uri.startswith("adr/"))
    config.nav = [_with_decisions(entry, decisions) for entry in config.nav or []]
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Leave the words of links that lead out of the documents: the site holds no sources."""
    here = (Path(config.docs_dir) / page.file.src_uri).parent

    def keep(match: re.Match[str]) -> str:
        inside = (here / match[2]).resolve().is_relative_to(config.docs_dir)
        return match[0] if inside else match[1]

    return OUTWARD.sub(keep, markdown)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Name the search, which the theme leaves without a name for a screen reader."""
    return _with_named_search(output)


def on_post_template(output: str, template_name: str, config: MkDocsConfig) -> str:
    """Name it on the page for wrong addresses, too."""
    return _with_named_search(output)


def _with_named_search(output: str) -> str:
    return output.replace('role="dialog">', 'role="dialog" aria-label="Search">')


def on_post_build(config: MkDocsConfig) -> None:
    """Write the Content-Security-Policy that lets the pages' own scripts run and no others."""
    site = Path(config.site_dir)
    scripts = {script for page in site.rglob("*.html") for script in _inline_scripts(page)}
    hashes = sorted(
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    )
    sources = " ".join(("'self'", *(f"'sha256-{script}'" for script in hashes)))
    policy = (
        "default-src 'self'",
        f"script-src {sources}",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data:",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
    (site / POLICY).write_text("; ".join(policy))


def front_page() -> str:
    """Return the README, with its links and its picture as seen from docs/."""
    text = (ROOT / "README.md").read_text()
    return re.sub(
        r"\]\((?!#|[a-z]+:)([^)]*)\)",
        lambda link: (
            f"]({link[1].removeprefix('docs/')})"
            if link[1].startswith("docs/")
            else f"](../{link[1]})"
        ),
        text,
    )


def server_settings() -> str:
    """Return the table of the server's variables."""
    lines = [
        f"| `{variable.name}` | {_cell(variable.meaning)} | {_cell(variable.allowed)} | {_default(variable)} |"
        for variable in sorted(VARIABLES.values(), key=lambda variable: variable.name)
    ]
    return "\n".join(
        (
            "# Settings of the server",
            "",
            "The containers read these variables; `compose/.env` sets those that a site changes, and",
            "`compose/.env.example` describes them. A secret X may come from a file that `X_FILE` names.",
            "`robotether show-settings` prints what is in force.",
            "",
            "| variable | meaning | allowed | default |",
            "|---|---|---|---|",
            *lines,
            "",
        )
    )


def codes() -> str:
    """Return the codes of problems over HTTP and of closed WebSockets."""
    return "\n".join(
        (
            "# Codes",
            "",
            "## Problems over HTTP",
            "",
            "The member `code` of an `application/problem+json` (RFC 9457); the log has it too.",
            "",
            "| status | code | meaning |",
            "|---|---|---|",
            *_problems(),
            "",
            "Errors of HTTP itself have the status's name: `not_found`, `method_not_allowed`. nginx answers",
            "`request_invalid` (400), `body_too_large` (413), `too_many_requests` (429) and `service_away` (503).",
            "",
            "## Closed WebSockets",
            "",
            "With these the server closes a WebSocket of `/robots/NAME/ros` or `/robots/NAME/video/frames`. A request",
            "for a topic or service that ends so is a problem with the name as its code, and the status.",
            "",
            "| code | name | status | meaning | reason, for example |",
            "|---|---|---|---|---|",
            *_close_codes(),
            "",
        )
    )


def _problems() -> list[str]:
    kinds = [problem for _, problem in inspect.getmembers(problems, inspect.isclass)]
    rows = [
        (int(problem.status), problem.code, _cell(inspect.getdoc(problem) or ""))
        for problem in kinds
        if issubclass(problem, problems.RobotetherError) and "code" in vars(problem)
    ]
    return [f"| {status} | `{code}` | {meaning} |" for status, code, meaning in sorted(rows)]


def _close_codes() -> list[str]:
    lines = []
    for name, function in inspect.getmembers(close_reasons, inspect.isfunction):
        hints = inspect.signature(function).return_annotation
        if function.__module__ != close_reasons.__name__ or hints != "CloseReason":
            continue
        reason = function(**{key: EXAMPLES[key] for key in inspect.signature(function).parameters})
        meaning = _cell(inspect.getdoc(function) or name)
        status = CLOSE_CODES[reason.name].status
        # No request ends as the others say.
        cells = (reason.code, f"`{reason.name}`", "" if status == 500 else status, meaning)  # noqa: PLR2004  # the default
        row = " | ".join(map(str, (*cells, _cell(reason.reason))))
        lines.append((reason.code, f"| {row} |"))
    return [line for _, line in sorted(lines)]


# What stands for each argument of a close reason.
EXAMPLES: dict[str, Any] = {
    "robot": "sim1",
    "limit_bytes": 1024 * 1024,
    "sender": "you",
    "by": "ann",
    "to": "ann",
    "at": datetime(2026, 1, 1, 12, 30, tzinfo=UTC),
    "since": datetime(2026, 1, 1, 12, 30, tzinfo=UTC),
    "now": datetime(2026, 1, 1, 13, 0, tzinfo=UTC),
    "limit_s": 10,
    "why": "(why)",
}


def operations() -> str:
    """Return the table of the rosbridge operations that a client may send."""
    lines = [
        f"| `{name}` | {', '.join(f'`{field}`' for field in rule.fields) or '-'} | "
        f"{f'`{rule.right}` `{rule.named_by}`' if rule.right else '-'} | {'server' if rule.own else 'robot'} |"
        for name, rule in OPERATIONS.items()
    ]
    return "\n".join(
        (
            "# Operations of rosbridge",
            "",
            "What a client may send at `/robots/NAME/ros`. Any other operation is refused, any other field left",
            "out. The robot's policy must let the connection's level use the name in the third column's field.",
            "",
            "| op | fields | right and the field that names it | goes to |",
            "|---|---|---|---|",
            *lines,
            "",
        )
    )


def api(document: dict[str, Any]) -> str:
    """Return the REST API, an operation a section, and its types."""
    lines = [
        "# REST API",
        "",
        f"{document['info']['description']} `/api/v1/openapi.json` has all of it for programs.",
    ]
    for path, item in document["paths"].items():
        for method, operation in item.items():
            if method != "parameters":
                lines += ["", f"## {method.upper()} {path}", "", *_operation(operation)]
    lines += ["", "## Types"]
    for name, schema in document["components"]["schemas"].items():
        lines += ["", f"### {name}", "", *_type(schema)]
        if name == "GivenSettings":
            defaults = json.dumps(DEFAULTS.as_dict(), indent=1)
            lines += ["", "The defaults:", "", "```json", defaults, "```"]
    return "\n".join((*lines, ""))


def _operation(operation: dict[str, Any]) -> Iterator[str]:
    yield f"{operation['summary']}. {operation.get('description', '')}".strip().replace("..", ".")
    yield ""
    for parameter in operation.get("parameters", []):
        words = parameter.get("description", "")
        yield f"- `?{parameter['name']}=` {_kind(parameter['schema'])}{': ' if words else ''}{words}"
    if "requestBody" in operation:
        yield f"- Body: {_kind(operation['requestBody']['content']['application/json']['schema'])}"
    for status, answer in operation["responses"].items():
        if "$ref" in answer:
            yield f"- {status}: {answer['$ref'].rpartition('/')[2]}"
            continue
        kinds = [_kind(content["schema"]) for content in answer.get("content", {}).values()]
        yield f"- {status} {answer['description']}{': ' if kinds else ''}{' or '.join(dict.fromkeys(kinds))}"


def _type(schema: dict[str, Any]) -> Iterator[str]:
    if "description" in schema:
        yield schema["description"]
        yield ""
    required = schema.get("required", [])
    if schema.get("properties"):
        yield "| member | type | |"
        yield "|---|---|---|"
    for name, member in schema.get("properties", {}).items():
        # The label of a setting says what its hint is about.
        words = ": ".join(member[key] for key in ("title", "description") if key in member)
        needed = "required" if name in required else ""
        yield f"| `{name}` | {_cell(_kind(member))} | {_cell('; '.join(filter(None, (needed, words))))} |"
    if not schema.get("properties"):
        yield _kind(schema)


def _kind(schema: dict[str, Any]) -> str:
    """Say a type in a phrase."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "contentSchema" in schema:
        kinds = [kind["properties"] for kind in schema["contentSchema"]["items"]["oneOf"]]
        return "; ".join(f"{_kind(kind['event'])} with {_kind(kind['data'])}" for kind in kinds)
    if "anyOf" in schema:
        return " or ".join(_kind(option) for option in schema["anyOf"])
    if options := schema.get("enum") or [schema[key] for key in schema if key == "const"]:
        return " or ".join(f"`{json.dumps(option)}`" for option in options)
    if schema.get("type") == "array":
        items = schema.get("prefixItems") or [schema.get("items", {})]
        return f"list of {', '.join(_kind(item) for item in items)}"
    bounds = ", ".join(f"{word} {schema[key]}" for key, word in BOUNDS.items() if key in schema)
    kind = schema.get("type", "any")
    return f"{kind} ({bounds})" if bounds else str(kind)


BOUNDS = {
    "minimum": "from",
    "maximum": "to",
    "minLength": "characters from",
    "maxLength": "characters to",
    "format": "",
}


def _default(variable: Variable) -> str:
    if variable.secret:
        return "a secret" if variable.default is None else "a secret, or empty"
    if variable.default is None:
        return "none: must be set"
    return f"`{variable.default}`" if variable.default else "empty"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


def _with_decisions(entry: Any, decisions: list[str]) -> Any:
    if isinstance(entry, dict):
        return {name: _with_decisions(value, decisions) for name, value in entry.items()}
    if isinstance(entry, list):
        return [_with_decisions(item, decisions) for item in entry]
    return decisions if entry == "adr/*" else entry


class _Scripts(HTMLParser):
    """Collects the inline scripts of a page, as the browser hashes them."""

    def __init__(self) -> None:
        super().__init__()
        self.scripts: list[str] = []
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = dict(attrs)
        runs = names.get("type") in (None, "text/javascript", "module")
        self._inside = tag == "script" and "src" not in names and runs
        if self._inside:
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.scripts[-1] += data

    def handle_endtag(self, tag: str) -> None:
        self._inside = False


def _inline_scripts(page: Path) -> list[str]:
    parser = _Scripts()
    parser.feed(page.read_text())
    return parser.scripts
