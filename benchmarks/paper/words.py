"""How the page writes what others wrote: texts, numbers and times. Parts use it for what they put into Markdown."""

from __future__ import annotations

import math
import re

# What means something in Markdown or HTML; a backslash before it makes it mean itself.
_SIGNS = re.compile(r"([\\`*_{}\[\]<>()#|~&!])")
MINUTE_S, HOUR_S = 60, 3600


def plain(text: str) -> str:
    """The text in one line, so that nothing in it is taken for Markdown or HTML; also good in a table."""
    return _SIGNS.sub(r"\\\1", " ".join(text.split()))


def number(value: float) -> str:
    """Four digits that count; whole numbers and large ones in full, with commas between thousands."""
    if not math.isfinite(value):
        return str(value)
    if value == int(value) or abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.4g}"


def duration(seconds: float) -> str:
    """`12.3 s`, `4 min 10 s` or `1 h 2 min`."""
    if seconds < MINUTE_S:
        return f"{seconds:.1f} s"
    if seconds < HOUR_S:
        return f"{int(seconds // MINUTE_S)} min {int(seconds % MINUTE_S)} s"
    return f"{int(seconds // HOUR_S)} h {int(seconds % HOUR_S // MINUTE_S)} min"
