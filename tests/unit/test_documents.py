"""The documents: links lead somewhere, and files that sources and pages name are there."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"\]\(([^)\s#]*)(?:#([^)\s]*))?\)")
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
# A file under docs/, as a comment or a message names it.
NAMED = re.compile(r"\bdocs/[\w/.-]+\.(?:md|py|html)\b")
# It says what was there before.
HISTORY = "CHANGELOG.md"


def tracked(*patterns: str) -> list[Path]:
    """The repository's files; none where it is no git checkout."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "--", *patterns],
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    return [ROOT / name for name in sorted(listed.stdout.split("\0")) if (ROOT / name).is_file()]


@cache
def anchors(page: Path) -> frozenset[str]:
    """The headings' anchors, as GitHub and its like make them."""
    found = []
    seen: Counter[str] = Counter()
    for heading in re.findall(r"^#+ (.+)$", FENCED.sub("", page.read_text()), re.MULTILINE):
        words = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower()
        anchor = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        found.append(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
        seen[anchor] += 1
    return frozenset(found)


def broken(page: Path) -> Iterator[str]:
    """Links to files or headings that are not there."""
    for target, anchor in LINK.findall(FENCED.sub("", page.read_text())):
        if re.match(r"[a-z]+:", target):
            continue
        there = (page.parent / target).resolve() if target else page
        if not there.exists() or (
            anchor and there.suffix == ".md" and anchor not in anchors(there)
        ):
            yield f"{page.relative_to(ROOT)}: {target}#{anchor}"


def test_links_lead_somewhere() -> None:
    """Relative links of all documents, with their anchors."""
    pages = [page for page in tracked("*.md") if "experiments" not in page.parts]
    assert [link for page in pages for link in broken(page)] == []


def test_named_documents_are_there() -> None:
    """Comments, messages and pages name files under docs/ by their path."""
    sources = [
        path
        for path in tracked()
        if path.name != HISTORY and not path.is_relative_to(ROOT / "docs" / "experiments")
    ]
    if not sources:
        pytest.skip("this is no git checkout")
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
