"""Reading of what comes from outside into Structs."""

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


PUBLISH, CALL = {"kind": "publish", "topic": "/a"}, {"kind": "call", "service": "b"}
NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("name", "value", "read"),
    [
        ("name", " a b\n", "a b"),
        ("plain", "crew\n", "crew"),
        ("robot", "No Robot", "No Robot"),  # nothing of that name is found: another refusal
        ("uses", 5.0, 5),
        ("speed", 1, 1.0),
        ("speed", None, None),
        ("turned", 90.0, 90),
        ("ends_at", "2026-01-31T13:00+01:00", dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC)),
        ("settings", {"a": {}}, {"a": {}}),
        ("password", " a\n", " a\n"),
        ("inner", {"name": "y", "more": 1}, Inner("y")),
        ("several", [PUBLISH, CALL], [Publish("/a"), Call("b")]),
    ],
)
def test_value_is_read_as_it_is_meant(name, value, read):
    """Text loses the space around it, except a secret's; 5.0 is a whole number to JSON."""
    found = getattr(schemas.read({"name": "x", name: value}, Thing), name)
    assert (found, type(found)) == (read, type(read))


def refused(given):
    with pytest.raises(FieldInvalidError) as problem:
        schemas.read(given, Thing)
    return problem.value.detail


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("name", (None, 1, [], "", "  ", "x" * 64, "a\nb", "a\x00", "\ud800"), "a text of 1 to 63"),
        ("plain", ("Crew", "a b", "-a", "a/b", "x" * 64), "1 to 63 characters a-z"),
        ("robot", ("x" * 64,), "a text of 1 to 63"),
        ("uses", (None, 0, 11, 1.5, True, "5", NAN, 10**400), "a whole number from 1 to 10"),
        ("level", (None, "c", ["a"], 1), "one of a, b"),
        ("speed", (0.4, 5.1, "1", False, INFINITE, NAN), "null or a number from 0.5 to 5"),
        ("turned", (45, False, "90", None), "one of 0, 90"),
        ("disabled", (None, 0, 1, "true"), "true or false"),
        (
            "ends_at",
            ("", 5, "2026-01-31", "2026-01-31T12:00:00"),
            "a timestamp with its offset, such as",
        ),
        ("settings", ([],), "a JSON object"),
        ("password", (None, 1, "\ud800"), "a text"),
        ("inner", ([],), "null or a JSON object"),
        ("several", ([PUBLISH] * 3, {}), "a list of at most 2"),
    ],
)
def test_other_value_is_refused_by_name_with_what_is_allowed(name, values, sentence):
    """Truth values and texts are no numbers, false is not 0, and null is what its field says."""
    for value in values:
        said = refused({"name": "x", name: value})
        assert said.startswith(f"cannot use {name}: it must be "), value
        assert sentence in said, value


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"naem": "x"}, "cannot use 'naem': there is no such field; known are name, plain, "),
        ({"name": "x", "inner": {}}, "cannot use inner.name: it must be a text"),
        ({"name": "x", "several": [PUBLISH, 5]}, "cannot use several.2: it must be a JSON object"),
        ({"name": "x", "several": [PUBLISH, {}]}, "cannot use several.2.kind: it must be one of "),
    ],
)
def test_refusal_says_where_the_field_stands(given, sentence):
    assert refused(given).startswith(sentence)


@pytest.mark.parametrize("value", ["0", "11", "1.0", "+5", "5_0", "\u0665", "x", "", "9" * 5000])
def test_number_in_a_query_is_plain_digits(value):
    """Python takes more for a number than people mean."""
    assert schemas.read_query([("name", "7"), ("uses", "7")], Thing) == Thing(name="7", uses=7)
    with pytest.raises(FieldInvalidError, match="uses: it must be a whole number from 1 to 10"):
        schemas.read_query([("name", "x"), ("uses", value)], Thing)


@pytest.mark.parametrize("name", ["", " ", "a ", "a\tb", "a\x1b[2J", "x" * 64])
def test_single_value_is_refused_unless_it_can_stay_as_it_is(name):
    for good in ("a", "Ann's desk", "x" * 63, "Küche"):
        schemas.check("name", good, Label)
    with pytest.raises(FieldInvalidError, match="cannot use name"):
        schemas.check("name", name, Label)


@pytest.mark.parametrize("value", ["/a", ["a"], [5], None])
def test_patterns_are_full_names_and_kept_once(value):
    assert list(read_globs(["/a*", "/b", "/a*"], "page.fps")) == ["/a*", "/b"]
    with pytest.raises(FieldInvalidError, match=r"cannot use page\.fps: "):
        read_globs(value, "page.fps")


@pytest.mark.parametrize(
    "value", ["a", "/", "/a/", "//a", "/a*", "/ä", "/a\n", " /a", None, "/" + "a" * MAX_NAME_LENGTH]
)
def test_name_of_ros_is_full(value):
    assert schemas.value("topic", "/a/b_1", RosName) == "/a/b_1"
    with pytest.raises(FieldInvalidError, match="cannot use topic: it must be a full name such as"):
        schemas.value("topic", value, RosName)
