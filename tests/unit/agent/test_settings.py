"""agent.toml and the environment: what is allowed, and what a wrong value is told."""

import string
import sys
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from robotether_agent.problems import SettingsInvalidError
from robotether_agent.settings import (
    MAX_RUN_DIR_LENGTH,
    PARSERS,
    RefusedValueError,
    Settings,
    load,
    settings_lines,
)

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EXAMPLE = Path(__file__).parents[3] / "agent/agent.toml.example"


def written(tmp_path, text):
    path = tmp_path / "agent.toml"
    path.write_text(text)
    return path


def test_reads_file_and_environment(tmp_path):
    file = written(
        tmp_path, 'server = "a.example"\nssh_ports = [2222, 443]\nallow_local_mac = true\n'
    )
    settings = load(file, {"ROBOTETHER_SERVER": "b.example:8443", "HOME": "/root"})
    assert settings.server == "b.example:8443"
    assert settings.server_host == "b.example"
    assert settings.ssh_ports == (2222, 443)
    assert settings.allow_local_mac is True
    assert settings.rosbridge_url == "ws://127.0.0.1:9090"


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
    with suppress(RefusedValueError):
        PARSERS[key](value)


@pytest.mark.parametrize(
    ("key", "value", "parsed"),
    [
        ("server", " robots.example.com\n", "robots.example.com"),
        ("server", "Robots.Example.com:8443", "Robots.Example.com:8443"),
        ("server", "[2001:DB8::1]:8443", "[2001:DB8::1]:8443"),
        ("tls_fingerprint", "sha256:" + "ab" * 32, b"\xab" * 32),
        ("shell_address", "", ""),
        ("ssh_ports", [2222, "443"], (2222, 443)),
        ("ssh_ports", "2222", (2222,)),
        ("allow_local_mac", " YES ", True),
        ("mac", "02-42-AC-11-00-02", "02:42:ac:11:00:02"),
        ("rosbridge_url", "ws://robot.local/", "ws://robot.local:9090"),
        ("video_url", "http://10.0.0.5", "http://10.0.0.5:8080"),
        ("state_dir", "/srv/robot@home/state", Path("/srv/robot@home/state")),
        ("guard", "OFF", "off"),
        ("guard", True, "on"),
        ("cameras", ["rear=rtsp://a/b", "v=/dev/video0"], ("rear=rtsp://a/b", "v=/dev/video0")),
        ("cameras", ["rear=http://a/v?x=1&y=a=b"], ("rear=http://a/v?x=1&y=a=b",)),
        (
            "cameras",
            "a=http://h b/c=https://[::1]:8443/v",
            ("a=http://h", "b/c=https://[::1]:8443/v"),
        ),
        ("http_proxy", "http://ann:a%40b@[::1]:80", "http://ann:a%40b@[::1]:80"),
    ],
)
def test_takes_every_usual_spelling(key, value, parsed):
    assert PARSERS[key](value) == parsed


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("server", "", "a text that is not empty"),
        ("server", "https://a.example/", "HOST or HOST:PORT"),
        ("server", "-oProxyCommand=x", "a host name"),
        ("server", "a.example:0", "HOST or HOST:PORT"),
        ("server", "ann@a.example", "HOST or HOST:PORT"),
        ("tls_fingerprint", "12:34", "64 hexadecimal digits"),
        ("ssh_host", "-oProxyCommand=x", "a host name or an address"),
        ("ssh_host", "fe80::1%eth0", "a host name or an address"),
        ("ssh_ports", 2222, r"such as \[2222, 443\]"),
        ("ssh_ports", [], "1 to 8 ports"),
        ("ssh_ports", "2222,,443", "a port from 1 to 65535"),
        ("ssh_ports", "9" * 5000, "a port from 1 to 65535"),
        ("ssh_ports", [True], "a port from 1 to 65535"),
        ("allow_local_mac", 1, "true or false"),
        ("mac", "12", "MAC address"),
        ("name", "a robot", "letters, digits"),
        ("interface", "../x", "such as eth0"),
        ("shell_address", "127.0.0.1", "HOST:PORT of an SSH server"),
        ("shell_address", "-oProxyCommand=x:22", "a host name"),
        ("rosbridge_url", "http://127.0.0.1:9090", "ws://HOST:PORT"),
        ("rosbridge_url", "ws://ann:secret@127.0.0.1:9090", "without a path"),
        ("rosbridge_url", "127.0.0.1:9090", "such as ws://127.0.0.1:9090"),
        ("video_url", "http://-oProxyCommand=x:80", "a host name or an address"),
        ("http_proxy", "http://ann:x y@proxy:3128", "http://HOST:PORT"),
        ("http_proxy", "http://ann@proxy:3128", "USER:PASSWORD"),
        ("http_proxy", "http://-oProxyCommand=x:80", "a host name or an address"),
        ("video_source", "ros", "web_video_server"),
        ("cameras", "rear", "NAME=URL"),
        ("cameras", ["rear=http://a", "rear=http://b"], "different names"),
        ("cameras", ["rear=file:///etc/passwd"], "http://"),
        ("cameras", ["rear=/dev/sda"], "/dev/videoN"),
        ("cameras", ["rear=/dev/video0/../sda"], "/dev/videoN"),
        ("cameras", ["rear=http://a/\n"], "NAME=URL"),
        ("cameras", [f"c{n}=http://a" for n in range(9)], "up to 8"),
        ("rosbridge_url", f"ws://{'x' * 64}:9090", "ws://HOST:PORT"),
        ("guard", "maybe", '"on", "off"'),
        ("state_dir", "relative", "an absolute path"),
        # A longer one has no room for the control sockets.
        ("run_dir", "/" + "x" * MAX_RUN_DIR_LENGTH, f"at most {MAX_RUN_DIR_LENGTH} characters"),
        ("state_dir", "/state/%h", "an absolute path"),
        ("token", "  ", "a text that is not empty"),
    ],
)
def test_refuses_with_what_is_allowed(key, value, allowed):
    """Mistakes, and whatever ssh would read in another way, are refused with what is right."""
    with pytest.raises(RefusedValueError, match=allowed):
        PARSERS[key](value)


@pytest.mark.parametrize(
    ("text", "environ", "why"),
    [
        ("sever = 1", {}, "the key 'sever' in .* is not known"),
        ('server = "a"\nssh_ports = "no"', {}, r"agent\.toml: ssh_ports = 'no': allowed is"),
        ("server =", {}, "cannot read the settings"),
        ('server = "a"\ntoken = "x"', {"ROBOTETHER_TOKEN_FILE": "/x"}, "cannot use both"),
        ('server = "a"\nmac = "02:42:ac:11:00:02"', {}, "allow_local_mac"),
    ],
)
def test_refuses_what_cannot_be_meant(tmp_path, text, environ, why):
    with pytest.raises(SettingsInvalidError, match=why):
        load(written(tmp_path, text), environ)


SECRETS = {
    "token": "s3cret",
    "http_proxy": "http://ann:s3cret@proxy:3128",
    "cameras": "rear=http://ann:s3cret@10.0.0.7/video front=http://b",
}


def test_secrets_are_in_no_error_and_not_shown(tmp_path):
    given = {f"ROBOTETHER_{key.upper()}": value for key, value in SECRETS.items()}
    settings = load(None, {"ROBOTETHER_SERVER": "a", **given})
    assert "s3cret" not in repr(settings)
    shown = settings_lines(settings)
    assert "token = (hidden)" in shown
    assert "s3cret" not in str(shown)
    for key, value in SECRETS.items():
        file = written(tmp_path, f'server = "a"\n{key} = {{ wrong = "{value}" }}')
        with pytest.raises(SettingsInvalidError) as error:
            load(file, {})
        assert key in str(error.value)
        assert "s3cret" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "url", "shown_url"),
    [
        ("rosbridge_url", "ws://ann:s3cret@127.0.0.1:9090", "ws://(hidden)@127.0.0.1:9090"),
        ("video_url", "http://ann:s3cret@127.0.0.1:8080", "http://(hidden)@127.0.0.1:8080"),
        ("server", "https://ann:s3cret@a.example", "https://(hidden)@a.example"),
    ],
)
def test_a_refused_urls_password_is_hidden(key, url, shown_url):
    with pytest.raises(SettingsInvalidError) as error:
        load(None, {"ROBOTETHER_SERVER": "a.example", f"ROBOTETHER_{key.upper()}": url})
    assert "s3cret" not in str(error.value)
    assert shown_url in str(error.value)


def test_an_installer_asks_before_it_knows_the_server(tmp_path):
    assert load(None, {}, needs_server=False).server == ""
    with pytest.raises(SettingsInvalidError, match="ROBOTETHER_MAC"):
        load(None, {"ROBOTETHER_MAC": "rubbish"}, needs_server=False)


def test_a_named_file_must_exist(tmp_path):
    with pytest.raises(SettingsInvalidError, match="no such file"):
        load(tmp_path / "none.toml", {"ROBOTETHER_SERVER": "a.example"})


def test_example_is_complete_and_shows_the_defaults():
    assert set(PARSERS) == {item.name for item in fields(Settings)}
    lines = EXAMPLE.read_text().splitlines()
    uncommented = [line[1:] if line.startswith("#") and " = " in line else line for line in lines]
    table = tomllib.loads(
        "\n".join(line for line in uncommented if line[:1].isalpha() and " = " in line)
    )
    assert set(table) == set(PARSERS)
    for key in (
        "allow_local_mac",
        "rosbridge_url",
        "video_url",
        "shell_address",
        "guard",
        "state_dir",
        "run_dir",
        "log_level",
    ):
        default = next(item.default for item in fields(Settings) if item.name == key)
        assert PARSERS[key](table[key]) == default
