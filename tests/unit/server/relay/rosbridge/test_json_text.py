"""Texts that all parsers read alike, and those that are rejected."""

from __future__ import annotations

import json
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_server.relay.rosbridge.json_text import MAX_DEPTH, NotJsonError, read, write


@pytest.mark.parametrize(
    ("data", "meant"),
    [
        (b' {"a": 1}\n', {"a": 1}),
        ('{"ü": "\\u00fc€"}'.encode(), {"ü": "ü€"}),
        (b'{"a": "\\ud83d\\ude00"}', {"a": "\U0001f600"}),
        (b'{"a": 18446744073709551615}', {"a": 2**64 - 1}),
        (b'{"a": -9223372036854775808}', {"a": -(2**63)}),
        (b'{"a": 0.12345678901234567890123456789}', {"a": 0.12345678901234568}),
        (b'{"a": "0000000000000000000000000000000000"}', {"a": "0" * 34}),
        (b'{"a": [{}, [], null, true]}', {"a": [{}, [], None, True]}),
    ],
)
def test_a_json_object_is_read(data, meant):
    """Whatever spelling JSON allows means what it says."""
    assert read(data) == meant
    assert json.loads(write(read(data))) == meant


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "Expecting value"),
        (b"{'a': 1}", "Expecting property name"),
        (b'{"a": 1} {"b": 2}', "Extra data"),
        (b'\xef\xbb\xbf{"a": 1}', "Expecting value"),
        (b'{"a": "\xed\xa0\x80"}', "not UTF-8"),
        (b'{"a": "\xc0\xaf"}', "not UTF-8"),
        (b'{"a": "\n"}', "Invalid control character"),
        (b"[{}]", "no object"),
        (b'"{}"', "no object"),
        (b'{"a": 1, "a": 1}', "twice"),
        (b'{"a": {"b": 1, "\\u0062": 1}}', "twice"),
        (b'{"a": NaN}', "NaN is no number"),
        (b'{"a": -Infinity}', "-Infinity is no number"),
        (b'{"a": 18446744073709551616}', "64 bits"),
        (b'{"a": -9223372036854775809}', "64 bits"),
        (b'{"a": ' + b"9" * 100_000 + b"}", "64 bits"),
        (b'{"a": ' + b"[" * MAX_DEPTH + b"]" * MAX_DEPTH + b"}", "nested more than"),
        (b'{"a":' * 100_000 + b"1" + b"}" * 100_000, "nested too deep"),
    ],
)
def test_what_some_parser_refuses_is_not_read(data, why):
    """The reason stands in the error."""
    with pytest.raises(NotJsonError, match=why):
        read(data)


def test_the_deepest_is_read():
    """As deep as the limit says, whatever brackets stand in texts."""
    data = b'{"a": ' + b"[" * (MAX_DEPTH - 1) + b"]" * (MAX_DEPTH - 1) + b', "b": "[[[[{{{{"}'
    assert read(data)["b"] == "[[[[{{{{"
    assert read(b'{"a": [' + b"{}," * 1000 + b"[]]}")


@pytest.mark.parametrize(
    "message", [{"a": float("inf")}, {"a": [float("nan")]}, {"a": "\ud800"}, {"\udfff": 1}]
)
def test_what_json_cannot_hold_is_not_written(message):
    """A number that grew out of all bounds, and half of a character."""
    with pytest.raises(NotJsonError):
        write(message)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=20,
    )
)
def test_what_is_read_and_written_stays_the_same(value):
    """A value passes unchanged or not at all."""
    try:
        message = read(json.dumps({"a": value}).encode())
        written = write(message)
    except NotJsonError:
        return
    assert read(written) == message == {"a": value}


@given(st.binary() | st.text().map(str.encode))
def test_any_bytes_are_read_or_refused(data):
    """Nothing else comes out of it."""
    with suppress(NotJsonError):
        assert isinstance(read(data), dict)
