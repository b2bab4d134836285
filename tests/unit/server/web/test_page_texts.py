"""How values are written on pages."""

import pytest
from robotether_server.web.page_texts import size_words


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (999, "999 B"),
        (1000, "1.0 kB"),
        (999_950, "1.0 MB"),
        (181_234_567, "181.2 MB"),
        (10**13, "10000.0 GB"),
    ],
)
def test_sizes_have_the_unit_that_makes_them_short(count, words):
    """A thousand of one is one of the next; after the last one it grows."""
    assert size_words(count) == words
