"""Parts of the measurements' page are replaced one by one."""

from measurements_page import HEAD, page, parts

ORDER = ("first", "second", "third")


def test_page_is_read_back_as_it_was_written() -> None:
    """What was written is read back, tables and empty lines included."""
    known = {"first": "## One\n\nWords.\n\n| a |\n|---|\n| 1 |", "second": "## Two"}
    text = page(known, ORDER)
    assert text.startswith(HEAD)
    assert parts(text) == known
    assert page(parts(text), ORDER) == text


def test_a_part_is_replaced_and_the_others_stay() -> None:
    """A new part takes the old one's place, wherever it was measured."""
    before = page({"first": "## One", "second": "## Two", "third": "## Three"}, ORDER)
    after = parts(page({**parts(before), "second": "## Two anew"}, ORDER))
    assert after == {"first": "## One", "second": "## Two anew", "third": "## Three"}
    assert list(after) == list(ORDER)


def test_part_of_an_experiment_that_is_gone_goes_too() -> None:
    """A page holds nothing that no experiment could measure anew."""
    assert parts(page({"first": "## One", "old": "## Old"}, ORDER)) == {"first": "## One"}
