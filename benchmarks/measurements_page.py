"""docs/measurements.md as `make bench` writes it: one part an experiment, each saying when and on what it was measured.

So that some parts can be measured anew without the others. A part begins with a comment that names its experiment,
which readers do not see; what stands there is replaced as a whole, and nothing else is touched.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

HEAD = """# Measurements

Written by `make bench`, which can measure some parts anew and leave the others: each says when and on what it was
measured. Compare within a table, not between tables.
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
