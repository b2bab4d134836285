"""Transcripts of what passes between two programs, in a form that is the same in every run.

A test adds each message to a `Transcript` and compares its text with the recorded file:
`assert transcript == recorded` (fixture `recorded` of tests/unit/transcripts/conftest.py).
`pytest tests/unit/transcripts --snapshot-update` records anew.

What differs from run to run is replaced by its kind and never left out: digits of a time become
zeros, a random text becomes `<id 1>` and is `<id 1>` wherever it stands again, a measured number
becomes `<int>` or `<float>`. Everything else stands in the file as it was sent.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import Any

from syrupy.extensions.single_file import SingleFileSnapshotExtension, WriteMode

LINE = 100  # characters; a longer value of JSON is written on several lines
# Headers of a WebSocket's handshake, the same in every run.
UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
}

TIME = re.compile(
    r"\b20\d\d-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?|\b20\d\d-\d\d-\d\d\b|\b\d\d:\d\d UTC\b"
)
HTTP_DATE = re.compile(r"\b[A-Z][a-z]{2}, \d\d [A-Z][a-z]{2} 20\d\d \d\d:\d\d:\d\d GMT")
# A random text is a UUID, 16 or more hex digits, a key or fingerprint of SSH, or `secrets.token_urlsafe()`.
RANDOM = re.compile(
    r"\b[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}\b"
    r"|\b[0-9a-f]{16,}\b"
    r"|(?<=ssh-ed25519 )[A-Za-z0-9+/=]{60,}"
    r"|(?<=SHA256:)[A-Za-z0-9+/]{43}"
    r"|(?<![\w-])[\w-]{43}(?![\w-])"
)


class Transcript:
    """What was said, in order; compared as text."""

    def __init__(self, measured: Iterable[str] = ()) -> None:
        """Take names of keys whose numbers are measured, such as `t_ms`."""
        self._measured = frozenset(measured)
        self._names: dict[str, str] = {}
        self._parts: list[str] = []
        self._before: dict[frozenset[str], dict[str, Any]] = {}

    def name(self, value: str | int, name: str) -> None:
        self._names[str(value)] = f"<{name}>"

    def add(self, heading: str, *bodies: Any) -> None:
        """Add a message: a heading such as `agent:`, and texts or JSON values."""
        texts = [self._text(body) for body in bodies]
        one_line = len(texts) == 1 and "\n" not in texts[0]
        self._parts.append(
            " ".join([heading, *texts]) if one_line else "\n".join([heading, *texts])
        )

    def changes(self, message: dict[str, Any]) -> tuple[str, dict[str, Any]]:
        """Return words for the heading and what to add: of a long message that comes again, what is other.

        It comes again when the last one with the same members is known.
        """
        clean = self.clean(message)
        members = frozenset(clean)
        before, self._before[members] = self._before.get(members), clean
        if before is None or len(json.dumps(clean, ensure_ascii=False)) <= LINE:
            return "", clean
        return ", as before but", difference(before, clean)

    def clean(self, value: Any, key: str = "") -> Any:
        """Return the value with all that varies replaced by its kind."""
        if isinstance(value, dict):
            return {self._clean_text(k): self.clean(v, k) for k, v in sorted(value.items())}
        if isinstance(value, list | tuple):
            return [self.clean(item, key) for item in value]
        if isinstance(value, str):
            return self._clean_text(value)
        if isinstance(value, bool) or value is None:
            return value
        if key in self._measured:
            return f"<{type(value).__name__}>"
        name = self._names.get(str(value))
        # A number that becomes a text is another message.
        return value if name is None else f"<{type(value).__name__} {name[1:]}"

    def __str__(self) -> str:
        return "\n".join(self._parts) + "\n"

    def _text(self, body: Any) -> str:
        if isinstance(body, str):
            # A file that is read again would have a plain newline in its place.
            return self._clean_text(body).replace("\r", "\\r")
        clean = self.clean(body)
        return layout(clean)

    def _clean_text(self, text: str) -> str:
        for value, name in self._names.items():
            text = re.sub(rf"(?<!\w){re.escape(value)}(?!\w)", name, text)
        text = HTTP_DATE.sub("<HTTP date>", text)
        text = TIME.sub(lambda found: re.sub(r"\d", "0", found[0]), text)
        return RANDOM.sub(self._id, text)

    def _id(self, found: re.Match[str]) -> str:
        known = sum(name.startswith("<id ") for name in self._names.values())
        return self._names.setdefault(found[0], f"<id {known + 1}>")


def layout(value: Any, indent: str = "") -> str:
    line = json.dumps(value, ensure_ascii=False)
    if len(indent) + len(line) <= LINE or not isinstance(value, dict | list):
        return line
    inner = indent + "  "
    if isinstance(value, dict):
        items = [f"{json.dumps(key)}: {layout(item, inner)}" for key, item in value.items()]
    else:
        items = [layout(item, inner) for item in value]
    begin, end = "{}" if isinstance(value, dict) else "[]"
    return f"{begin}\n{inner}" + f",\n{inner}".join(items) + f"\n{indent}{end}"


def difference(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return the members that are other than before, and of objects among them those members alone."""
    found: dict[str, Any] = dict.fromkeys(before.keys() - after.keys(), "<gone>")
    for key, value in after.items():
        was = before.get(key, "<gone>")
        if value != was:
            are_objects = isinstance(was, dict) and isinstance(value, dict)
            found[key] = difference(was, value) if are_objects else value
    return found


def problem_line(status: int, problem: dict[str, Any]) -> str:
    """Return what a problem says beyond its status: its code and its sentence."""
    code, detail = problem.pop("code"), problem.pop("detail")
    assert problem == {"type": "about:blank", "title": problem["title"], "status": status}
    return f"{code}: {detail}"


class TranscriptFile(SingleFileSnapshotExtension):
    _write_mode = WriteMode.TEXT
    file_extension = "txt"

    def serialize(self, data: Any, **_options: Any) -> str:
        return str(data)
