"""Reads and writes docs/measurements.md, one part an experiment.

A part begins with a comment that names its experiment. `make bench` replaces the parts that it measured again, and
leaves the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

HEAD = """# Measurements

`make bench` writes this page. It may measure only some parts again, so each says when and where it
was measured. Compare numbers within a table, not between tables.
"""
_MARK = re.compile(r"^<!-- experiment: (\w+) -->\n", re.MULTILINE)


def parts(text: str) -> dict[str, str]:
    """The parts of a page by their experiments' names."""
    pieces = _MARK.split(text)[1:]
    return {name: part.strip("\n") for name, part in zip(pieces[::2], pieces[1::2], strict=True)}


def page(known: Mapping[str, str], order: Iterable[str]) -> str:
    """The whole page; a part whose experiment is not in `order` is gone."""
    written = [f"<!-- experiment: {name} -->\n{known[name]}\n" for name in order if name in known]
    return "\n".join([HEAD, *written])
