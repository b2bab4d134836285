"""Fields of operations are checked, and errors name them."""

from typing import Any

import pytest
from sim_robot.problems import FieldInvalid, FieldMissing
from sim_robot.rosbridge import fields


def test_values_come_through() -> None:
    """What fits is returned as it is."""
    operation = {"topic": "/a", "latch": True, "msg": {}, "queue_length": 3, "id": 7}
    assert fields.text(operation, "topic") == "/a"
    assert fields.optional_flag(operation, "latch") is True
    assert fields.optional_object(operation, "msg") == {}
    assert fields.count(operation, "queue_length") == 3
    assert fields.identity(operation) == 7


def test_left_out_is_none_or_zero() -> None:
    """What is left out has a neutral value."""
    assert fields.optional_text({}, "type") is None
    assert fields.count({}, "throttle_rate") == 0
    assert fields.identity({}) is None


def test_missing_names_the_field() -> None:
    """A field that must be there is named."""
    with pytest.raises(FieldMissing, match="topic"):
        fields.text({}, "topic")


@pytest.mark.parametrize("value", [None, 5, [], {}])
def test_wrong_text_names_field_and_value(value: Any) -> None:
    """A topic that is no string is refused, null included."""
    with pytest.raises((FieldInvalid, FieldMissing), match="topic"):
        fields.text({"topic": value}, "topic")


@pytest.mark.parametrize("value", [-1, 1.5, "1", True, None])
def test_wrong_count(value: Any) -> None:
    """A count is a whole number from 0."""
    with pytest.raises(FieldInvalid, match="throttle_rate"):
        fields.count({"throttle_rate": value}, "throttle_rate")


@pytest.mark.parametrize("value", [1.5, True, [], {}])
def test_wrong_id(value: Any) -> None:
    """An id is a string or a whole number."""
    with pytest.raises(FieldInvalid, match="id"):
        fields.identity({"id": value})
