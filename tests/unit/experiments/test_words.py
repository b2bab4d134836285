"""Texts, numbers and times as the page writes them."""

import pytest
from markdown_it import MarkdownIt
from paper.words import duration, number, plain


def test_plain_text_means_nothing_in_markdown() -> None:
    """A robot's name or an error's text comes out as it went in, and in one line."""
    wild = "a|b `c` *d* _e_ <b>f</b> [g](h) #i\n- j &amp; k~ !l"
    shown = MarkdownIt("commonmark", {"html": True}).enable("table").render(plain(wild))
    assert shown == ("<p>a|b `c` *d* _e_ &lt;b&gt;f&lt;/b&gt; [g](h) #i - j &amp;amp; k~ !l</p>\n")


@pytest.mark.parametrize(
    ("value", "written"),
    [(0, "0"), (100_000, "100,000"), (0.001, "0.001"), (1234.5, "1,234"), (1.23456, "1.235"), (float("nan"), "nan")],
)  # fmt: skip
def test_numbers_have_four_digits_that_count(value: float, written: str) -> None:
    """And no exponent where people would write none."""
    assert number(value) == written


@pytest.mark.parametrize(
    ("seconds", "written"), [(12.34, "12.3 s"), (250, "4 min 10 s"), (3720, "1 h 2 min")]
)
def test_durations_have_two_units_at_most(seconds: float, written: str) -> None:
    """Seconds alone, minutes with seconds, hours with minutes."""
    assert duration(seconds) == written
