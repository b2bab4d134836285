"""What parts share: quantiles, and comparisons with paper and peers."""

import pytest
from paper.step import Comparison, Outcome, failures, spread, succeeded
from sections import quantile


def comparison(reference: float, ours: float, better: str) -> Comparison:
    return Comparison(
        what="p50", against="paper", reference=reference, ours=ours, unit="ms", better=better
    )


@pytest.mark.parametrize(
    ("reference", "ours", "better", "short"),
    [
        (2, 1, "lower", False),
        (2, 3, "lower", True),
        (2, 2, "lower", False),
        (2, 3, "higher", False),
        (2, 1, "higher", True),
        (100, 100, "equal", False),
        (100, 99.9, "equal", True),
        (0, 1, "equal", True),
        (2, float("nan"), "lower", True),
    ],
)
def test_falls_short_where_ours_is_worse(
    reference: float, ours: float, better: str, short: bool
) -> None:
    """As good as the reference is good enough."""
    assert comparison(reference, ours, better).is_short is short


def test_ratio_is_ours_divided_by_the_reference() -> None:
    """There is none to nothing."""
    assert comparison(4, 1, "lower").ratio == 0.25
    assert comparison(0, 1, "lower").ratio is None


def test_outcomes_are_told_apart() -> None:
    """A failed step is in no statistics, and is not forgotten."""
    results = {"a": Outcome(values={"x": 1}), "b": Outcome(failure="TimeoutError")}
    assert succeeded(results) == {"a": {"x": 1}}
    assert failures(results) == ["b: TimeoutError"]


def test_quantiles_lie_between_neighbours() -> None:
    """Also of one value, and of values in no order."""
    assert quantile([3, 1, 2], 0.5) == 2
    assert quantile([0, 10], 0.99) == pytest.approx(9.9)
    assert quantile([7], 0.5) == 7
    assert quantile([1, 2, 3], 1.0) == 3


def test_spread_is_of_a_sample() -> None:
    """Of one value it is zero."""
    assert spread([1, 3]) == pytest.approx(2**0.5)
    assert spread([5]) == 0.0
