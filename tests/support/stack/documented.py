"""The commands of the documents, in the order in which a reader meets them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from commands import run_command

ROOT = Path(__file__).resolve().parents[3]
# It says what was there before.
HISTORY = "CHANGELOG.md"
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_BLOCK_OR_CODE = re.compile(
    r"^ *```sh\n(?P<block>.*?)^ *```|^```.*?^```|`(?P<code>(?:robotether|robotether-agent|tools/\w+|make) [^`]+)`",
    re.MULTILINE | re.DOTALL,
)
_HERE_DOCUMENT = re.compile(r" <<'(\w+)'\n.*?^\1$", re.MULTILINE | re.DOTALL)


def tracked(*patterns: str) -> list[Path]:
    """The repository's files; none where it is not a git checkout."""
    listing = ("git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "--")
    names = sorted(run_command(*listing, *patterns, cwd=ROOT).stdout.split("\0"))
    return [ROOT / name for name in names if (ROOT / name).is_file()]


def pages() -> list[Path]:
    pages = [page for page in tracked("*.md") if not {"experiments", "adr"} & {*page.parts}]
    return [page for page in pages if page.name != HISTORY]


def commands(page: Path) -> Iterator[str]:
    for match in _BLOCK_OR_CODE.finditer(page.read_text()):
        text = match["block"] or (match["code"] or "").replace("\n", " ")
        text = _HERE_DOCUMENT.sub("", text).replace("\\\n", " ")
        for line in text.splitlines():
            command = re.sub(r"(?:^|\s+)# .*", "", line)
            yield from filter(None, map(str.strip, re.split(r"&&|\|", command)))
