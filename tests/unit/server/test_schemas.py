"""Reading of what comes from outside into Structs."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Literal

import pytest
from msgspec import UNSET, Meta, Struct, UnsetType
from robotether_common.ros import MAX_NAME_LENGTH
from robotether_server import schemas
from robotether_server.problems import FieldInvalidError
from robotether_server.schemas import Label, NewPlainName, RobotName, RosName, read_globs


class Inner(Struct):
    """A member that is an object, and may have members that nobody reads."""

    name: Label


class Publish(Struct, tag_field="kind", tag="publish", forbid_unknown_fields=True):
    topic: Annotated[str, Meta(max_length=9, pattern="^/[a-z]+$", extra={"exact": True})]


class Call(Struct, tag_field="kind", tag="call", forbid_unknown_fields=True):
    service: Label


class Thing(Struct, forbid_unknown_fields=True):
    name: Label
    plain: NewPlainName | UnsetType = UNSET
    robot: RobotName | UnsetType = UNSET
    uses: Annotated[int, Meta(ge=1, le=10)] | UnsetType = UNSET
    level: Literal["a", "b"] | UnsetType = UNSET
    ends_at: Annotated[dt.datetime, Meta(tz=True)] | UnsetType | None = UNSET
    disabled: bool | UnsetType = UNSET
    settings: dict[str, object] | UnsetType = UNSET
    password: Annotated[str, Meta(extra={"as_typed": True})] | UnsetType = UNSET
    inner: Inner | UnsetType | None = UNSET
    speed: Annotated[float, Meta(ge=0.5, le=5)] | UnsetType | None = UNSET
    turned: Literal[0, 90] = 0
    several: Annotated[list[Publish | Call], Meta(max_length=2)] | UnsetType = UNSET


def read(**given):
    [name] = given
    return getattr(schemas.read({"name": "x"} | given, Thing), name)


def refused(given):
    with pytest.raises(FieldInvalidError) as problem:
        schemas.read(given, Thing)
    return problem.value.detail


def test_text_loses_the_space_around_it():
    """A key line may come with its newline."""
    assert read(name=" a b\n") == "a b"


@pytest.mark.parametrize("value", [None, 1, [], "", "  ", "x" * 64, "a\nb", "a\x00", "\ud800"])
def test_anything_else_is_refused_by_name(value):
    expected = "cannot use name: it must be a text of 1 to 63 printable characters"
    assert refused({"name": value}) == expected
    assert refused({}) == expected


@pytest.mark.parametrize("value", ["Crew", "a b", "-a", "a/b", "x" * 64])
def test_text_has_to_match_its_pattern(value):
    assert read(plain="crew\n") == "crew"
    assert "plain: it must be 1 to 63 characters a-z" in refused({"name": "x", "plain": value})


def test_name_of_what_is_there_may_be_any_text():
    """Nothing of that name is found, which is another refusal; but a long text is none."""
    assert read(robot="No Robot") == "No Robot"
    assert "cannot use robot: it must be a text of 1 to 63" in refused(
        {"name": "x", "robot": "x" * 64}
    )


@pytest.mark.parametrize("value", [1, 10, 5.0])
def test_number_within_bounds(value):
    """5.0 is a whole number to JSON."""
    found = read(uses=value)
    assert (found, type(found)) == (value, int)


@pytest.mark.parametrize(
    "value", [None, 0, 11, 1.5, True, "5", float("nan"), float("inf"), 10**400]
)
def test_number_out_of_bounds_is_refused(value):
    """Truth values and texts are no numbers."""
    assert refused({"name": "x", "uses": value}) == (
        "cannot use uses: it must be a whole number from 1 to 10"
    )


@pytest.mark.parametrize("value", ["0", "11", "1.0", "+5", "5_0", "\u0665", "x", "", "9" * 5000])
def test_number_in_a_query_is_plain_digits(value):
    """Python takes more for a number than people mean."""
    assert schemas.read_query({"name": "7", "uses": "7"}, Thing) == Thing(name="7", uses=7)
    with pytest.raises(FieldInvalidError, match="uses: it must be a whole number from 1 to 10"):
        schemas.read_query({"name": "x", "uses": value}, Thing)


@pytest.mark.parametrize("value", [None, "c", ["a"], 1])
def test_choice_tells_what_is_allowed(value):
    """The sentence lists the choices."""
    assert read(level="a") == "a"
    assert refused({"name": "x", "level": value}) == "cannot use level: it must be one of a, b"


def test_number_may_be_real():
    assert (read(speed=1), type(read(speed=1))) == (1.0, float)
    assert read(speed=None) is None
    for value in (0.4, 5.1, "1", False, float("inf"), float("nan"), 10**400):
        assert refused({"name": "x", "speed": value}) == (
            "cannot use speed: it must be null or a number from 0.5 to 5"
        )


def test_choice_of_numbers_is_one_of_numbers():
    """90.0 is 90, and false is not 0."""
    assert (read(turned=90.0), type(read(turned=90.0))) == (90, int)
    for value in (45, False, "90", None):
        assert "it must be one of 0, 90" in refused({"name": "x", "turned": value})


def test_items_are_read_by_their_kind():
    publish, call = {"kind": "publish", "topic": "/a"}, {"kind": "call", "service": "b"}
    assert read(several=[publish, call]) == [Publish("/a"), Call("b")]
    for wrong, sentence in (
        ([publish] * 3, "cannot use several: it must be a list of at most 2"),
        ({}, "cannot use several: it must be a list of at most 2"),
        ([publish, 5], "cannot use several.2: it must be a JSON object"),
        ([publish, {}], "cannot use several.2.kind: it must be one of "),
        ([{**publish, "topic": "/a\n"}], "cannot use several.1.topic: it must be a text of 1 to 9"),
        ([{**call, "topic": "/a"}], "cannot use several.1: 'topic' is no setting; there is kind, "),
    ):
        assert refused({"name": "x", "several": wrong}).startswith(sentence), wrong


def test_flag_is_true_or_false():
    assert read(disabled=False) is False
    for value in (None, 0, 1, "true"):
        assert "must be true or false" in refused({"name": "x", "disabled": value})


def test_moment_has_its_offset():
    """Null is no moment, where that may be."""
    assert read(ends_at="2026-01-31T13:00+01:00") == dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)
    assert read(ends_at=None) is None
    for value in ("", 5, "2026-01-31", "2026-01-31T12:00:00"):
        assert "a timestamp with its offset, such as" in refused({"name": "x", "ends_at": value})


def test_object_is_no_list_of_pairs():
    assert read(settings={"a": {}}) == {"a": {}}
    assert refused({"name": "x", "settings": []}) == (
        "cannot use settings: it must be a JSON object"
    )


def test_secret_is_taken_as_it_was_typed():
    """A secret keeps its spaces; half a character is no secret."""
    assert read(password=" a\n") == " a\n"
    for value in (None, 1, "\ud800"):
        assert refused({"name": "x", "password": value}) == "cannot use password: it must be a text"


def test_inner_object_is_read_too():
    """A refusal says where the field stands; what nobody reads may be there if the object allows it."""
    assert read(inner={"name": "y", "more": 1}) == Inner("y")
    assert read(inner=None) is None
    assert "cannot use inner.name: it must be a text" in refused({"name": "x", "inner": {}})
    assert "cannot use inner: it must be null or a JSON object" in refused(
        {"name": "x", "inner": []}
    )


def test_member_that_nobody_reads_is_named():
    """A typo does not pass silently."""
    assert "cannot use 'naem': there is no such field; known are name, plain, " in refused(
        {"naem": "x"}
    )


@pytest.mark.parametrize("name", ["a", "Ann's desk", "x" * 63, "Küche"])
def test_single_value_passes(name):
    schemas.check("name", name, Label)


@pytest.mark.parametrize("name", ["", " ", "a ", "a\tb", "a\x1b[2J", "x" * 64])
def test_single_value_is_refused_unless_it_can_stay_as_it_is(name):
    """The sentence names the field."""
    with pytest.raises(FieldInvalidError, match="cannot use name"):
        schemas.check("name", name, Label)


def test_patterns_are_kept_once():
    assert list(read_globs(["/a*", "/b", "/a*"], "page.fps")) == ["/a*", "/b"]


@pytest.mark.parametrize("value", ["/a", ["a"], [5], None])
def test_other_patterns_are_refused_by_their_path(value):
    """Who gave it reads which member it was."""
    with pytest.raises(FieldInvalidError, match=r"cannot use page\.fps: "):
        read_globs(value, "page.fps")


def test_full_name_passes():
    assert schemas.value("topic", "/a/b_1", RosName) == "/a/b_1"


@pytest.mark.parametrize(
    "value", ["a", "/", "/a/", "//a", "/a*", "/ä", "/a\n", " /a", None, "/" + "a" * MAX_NAME_LENGTH]
)
def test_other_names_are_refused(value):
    """A name with white space around it is rejected, too."""
    with pytest.raises(FieldInvalidError, match="cannot use topic: it must be a full name such as"):
        schemas.value("topic", value, RosName)
