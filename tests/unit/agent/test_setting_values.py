"""The parser of each setting: what it makes of a value, and that nothing but its own refusal leaves it."""

from __future__ import annotations

import string
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent import setting_values
from robotether_agent.setting_values import MAX_RUN_DIR_LENGTH, RefusedValueError
from robotether_agent.settings import PARSERS

# What TOML and the environment can give.
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
NEARLY_RIGHT = st.text(string.ascii_letters + string.digits + "[]:./@%-_?# \n", max_size=40)
VALUES = (
    SCALARS
    | NEARLY_RIGHT
    | st.builds("ws://{}".format, NEARLY_RIGHT)
    | st.lists(SCALARS, max_size=10)
    | st.dictionaries(st.text(), SCALARS)
)


@given(st.sampled_from(sorted(PARSERS)), VALUES)
def test_any_value_is_parsed_or_refused(key, value):
    """No value of any type gets another exception than the refusal out of a parser."""
    with suppress(RefusedValueError):
        PARSERS[key](value)


@given(st.sampled_from(("server", "ssh_host", "rosbridge_url", "video_url", "mac")), VALUES)
def test_what_was_parsed_parses_to_itself(key, value):
    """A value that show-settings prints can be written into the file again."""
    try:
        parsed = PARSERS[key](value)
    except RefusedValueError:
        return
    assert PARSERS[key](parsed) == parsed


@pytest.mark.parametrize(
    ("key", "value", "parsed"),
    [
        ("server", " robots.example.com\n", "robots.example.com"),
        ("server", "Robots.Example.com:8443", "Robots.Example.com:8443"),
        ("server", "[2001:DB8::1]:8443", "[2001:DB8::1]:8443"),
        ("ssh_host", "2001:db8::1", "2001:db8::1"),
        ("ssh_host", "robot_host.lan", "robot_host.lan"),
        ("tls_fingerprint", "sha256:" + "ab" * 32, b"\xab" * 32),
        ("ssh_ports", [2222, "443"], (2222, 443)),
        ("ssh_ports", "2222", (2222,)),
        ("allow_local_mac", " YES ", True),
        ("allow_local_mac", "0", False),
        ("mac", "02-42-AC-11-00-02", "02:42:ac:11:00:02"),
        ("interface", "enp0s31f6.100", "enp0s31f6.100"),
        ("rosbridge_url", "ws://robot.local/", "ws://robot.local:9090"),
        ("rosbridge_url", "ws://[::1]:9091", "ws://[::1]:9091"),
        ("video_url", "http://10.0.0.5", "http://10.0.0.5:8080"),
        ("state_dir", "/srv/robot@home/state", Path("/srv/robot@home/state")),
        ("log_level", "INFO", "info"),
        ("guard", "OFF", "off"),
        ("guard", True, "on"),
        ("video_source", "rosbridge", "rosbridge"),
        ("cameras", [], ()),
        ("cameras", ["rear=http://a/v?x=1&y=a=b"], ("rear=http://a/v?x=1&y=a=b",)),
        (
            "cameras",
            "a=http://h b/c=https://[::1]:8443/v",
            ("a=http://h", "b/c=https://[::1]:8443/v"),
        ),
        ("http_proxy", "http://proxy:3128/", "http://proxy:3128"),
        ("http_proxy", "http://ann:a%40b@[::1]:80", "http://ann:a%40b@[::1]:80"),
    ],
)
def test_takes_every_usual_spelling(key, value, parsed):
    """What a person may reasonably write becomes one form, with the service's usual port."""
    assert PARSERS[key](value) == parsed


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("server", "", "a text that is not empty"),
        ("server", 443, "a text that is not empty"),
        ("server", "a.example:", "HOST or HOST:PORT"),
        ("server", "a.example:0", "HOST or HOST:PORT"),
        ("server", "[::1]x", "HOST or HOST:PORT"),
        ("server", "2001:db8::1", "HOST or HOST:PORT"),
        ("server", "ann@a.example", "HOST or HOST:PORT"),
        ("server", "a.example?x=1", "HOST or HOST:PORT"),
        ("ssh_host", "10.0.0.5:2222", "a host name or an address"),
        ("ssh_host", "cafe:2222", "a host name or an address"),
        ("ssh_host", "fe80::1%eth0", "a host name or an address"),
        ("ssh_ports", 2222, r"such as \[2222, 443\]"),
        ("ssh_ports", [], "1 to 8 ports"),
        ("ssh_ports", [22] * 9, "1 to 8 ports"),
        ("ssh_ports", "2222,,443", "a port from 1 to 65535"),
        ("ssh_ports", "65536", "a port from 1 to 65535"),
        ("ssh_ports", "9" * 5000, "a port from 1 to 65535"),
        ("ssh_ports", [True], "a port from 1 to 65535"),
        ("ssh_ports", [22.0], "a port from 1 to 65535"),
        ("allow_local_mac", 1, "true or false"),
        ("mac", "ff:ff:ff:ff:ff:ff", "multicast or broadcast"),
        ("interface", "..", "such as eth0"),
        ("interface", "a-name-too-long-0", "such as eth0"),
        ("rosbridge_url", "ws://ann:secret@127.0.0.1:9090", "without a path"),
        ("rosbridge_url", "ws://:secret@127.0.0.1:9090", "without a path"),
        ("rosbridge_url", "ws://127.0.0.1:0", "without a path"),
        ("rosbridge_url", "ws://127.0.0.1:9090?x=1", "without a path"),
        ("rosbridge_url", "127.0.0.1:9090", "such as ws://127.0.0.1:9090"),
        ("video_url", "http://-oProxyCommand=x:80", "a host name or an address"),
        ("http_proxy", "proxy:3128", "http://HOST:PORT"),
        ("http_proxy", "https://proxy:3128", "http://HOST:PORT"),
        ("http_proxy", "http://proxy", "http://HOST:PORT"),
        ("http_proxy", "http://proxy:3128/path", "http://HOST:PORT"),
        ("http_proxy", "http://ann:x y@proxy:3128", "http://HOST:PORT"),
        ("http_proxy", "http://ann@proxy:3128", "USER:PASSWORD"),
        ("http_proxy", "http://-oProxyCommand=x:80", "a host name or an address"),
        ("video_source", "ros", "web_video_server"),
        ("cameras", "rear", "NAME=URL"),
        ("cameras", ["rear=http://a", "rear=http://b"], "different names"),
        ("cameras", ["rear=rtsp://a/b"], "http://"),
        ("cameras", ["=http://a"], "NAME=URL"),
        ("cameras", ["a b=http://a"], "NAME=URL"),
        ("cameras", ["rear=http:///x"], "NAME=URL"),
        ("cameras", ["rear=http://a:70000/"], "NAME=URL"),
        ("cameras", ["rear=http://a/\n"], "NAME=URL"),
        ("cameras", [f"c{n}=http://a" for n in range(9)], "up to 8"),
        ("cameras", [5], "NAME=URL"),
        ("guard", 1, "a text that is not empty"),
        ("state_dir", "~/state", "an absolute path"),
        ("state_dir", "/state/%h", "an absolute path"),
        ("token", "  ", "a text that is not empty"),
    ],
)
def test_refuses_with_what_is_allowed(key, value, allowed):
    """Mistakes, and whatever ssh would read in another way, are refused with what is right."""
    with pytest.raises(RefusedValueError, match=allowed):
        PARSERS[key](value)


def test_cameras_by_name():
    given = setting_values.cameras(["rear=http://a/v?x=1", "front=http://b"])
    assert setting_values.camera_urls(given) == {"rear": "http://a/v?x=1", "front": "http://b"}


def test_run_dir_keeps_room_for_the_control_sockets():
    """The longest run directory is the longest whose sockets the kernel takes, one more is refused."""
    longest = "/" + "x" * (MAX_RUN_DIR_LENGTH - 1)
    assert setting_values.run_dir(longest) == Path(longest)
    with pytest.raises(RefusedValueError, match=f"at most {MAX_RUN_DIR_LENGTH} characters"):
        setting_values.run_dir(longest + "x")
