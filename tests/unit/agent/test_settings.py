"""agent.toml and the environment: what is allowed, and what a wrong value is told."""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path

import pytest
from robotether_agent.problems import SettingsInvalid
from robotether_agent.settings import PARSERS, Settings, load, shown

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EXAMPLE = Path(__file__).parents[3] / "agent/agent.toml.example"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "agent.toml"
    path.write_text(text)
    return path


def test_reads_file_and_environment(tmp_path):
    """The environment wins over the file, and both become checked values."""
    file = written(
        tmp_path, 'server = "a.example"\nssh_ports = [2222, 443]\nallow_local_mac = true\n'
    )
    settings = load(file, {"ROBOTETHER_SERVER": "b.example:8443", "HOME": "/root"})
    assert settings.server == "b.example:8443"
    assert settings.server_host == "b.example"
    assert settings.ssh_ports == (2222, 443)
    assert settings.allow_local_mac is True
    assert settings.rosbridge_url == "ws://127.0.0.1:9090"


def test_environment_alone_is_enough():
    """A container needs no file, and may pass a variable on that is empty."""
    environ = {"ROBOTETHER_SERVER": "[2001:db8::1]:443", "ROBOTETHER_SSH_PORTS": "22, 443"}
    environ["ROBOTETHER_TLS_FINGERPRINT"] = ""
    settings = load(None, environ)
    assert settings.server_host == "2001:db8::1"
    assert settings.ssh_ports == (22, 443)


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("server", "https://a.example/", "HOST or HOST:PORT"),
        ("server", "a.example:99999", "HOST or HOST:PORT"),
        ("server", "-oProxyCommand=x", "a host name"),
        ("tls_fingerprint", "12:34", "64 hexadecimal digits"),
        ("ssh_host", "-oProxyCommand=x", "a host name or an address"),
        ("ssh_ports", "2222,0", "a port from 1 to 65535"),
        ("ssh_ports", "a", "a port from 1 to 65535"),
        ("mac", "12", "MAC address"),
        ("mac", "02:42:ac:11:00:02", "allow_local_mac"),
        ("interface", "../x", "network interface"),
        ("mac", "ff:ff:ff:ff:ff:ff", "MAC address"),
        ("allow_local_mac", "maybe", "true or false"),
        ("name", "a robot", "letters, digits"),
        ("guard", "maybe", '"on" or "off"'),
        ("shell_address", "127.0.0.1", "HOST:PORT of an SSH server"),
        ("shell_address", "-oProxyCommand=x:22", "a host name"),
        ("rosbridge_url", "http://127.0.0.1:9090", "ws://HOST:PORT"),
        ("rosbridge_url", "ws://127.0.0.1:9090/path", "without a path"),
        ("video_url", "https://127.0.0.1", "http://HOST:PORT"),
        ("state_dir", "relative", "an absolute path"),
        ("state_dir", "/with blank", "an absolute path"),
        ("run_dir", "/" + "x" * 100, "at most"),
        ("log_level", "loud", "debug, info, warning, error"),
    ],
)
def test_wrong_value_names_variable_value_and_what_is_allowed(key, value, allowed):
    """A wrong value stops the start with everything that is needed to correct it."""
    name = f"ROBOTETHER_{key.upper()}"
    with pytest.raises(SettingsInvalid) as error:
        load(None, {"ROBOTETHER_SERVER": "a.example", name: value})
    assert name in error.value.message
    assert repr(value) in error.value.message
    assert allowed in error.value.message


def test_wrong_value_in_the_file_names_file_and_key(tmp_path):
    file = written(tmp_path, 'server = "a.example"\nssh_ports = "no"\n')
    with pytest.raises(SettingsInvalid, match=f"{file}: ssh_ports = 'no': allowed is"):
        load(file, {})


@pytest.mark.parametrize(
    ("text", "environ", "why"),
    [
        ("sever = 1", {}, "the key 'sever' in .* is not known"),
        ("", {"ROBOTETHER_SEVER": "a"}, "ROBOTETHER_SEVER is not known"),
        ("", {}, "server is set neither in"),
        ("server =", {}, "cannot read the settings"),
        ('server = "a"\ntoken = "x"', {"ROBOTETHER_TOKEN_FILE": "/x"}, "cannot use both"),
        (
            'server = "a"\nca_file = "/x"',
            {"ROBOTETHER_TLS_FINGERPRINT": "0" * 64},
            "cannot use both",
        ),
    ],
)
def test_refuses_unknown_missing_and_contradicting(tmp_path, text, environ, why):
    """Unknown keys, a missing server, broken TOML and two sources of one thing are errors."""
    with pytest.raises(SettingsInvalid, match=why):
        load(written(tmp_path, text), environ)


def test_an_installer_asks_before_it_knows_the_server(tmp_path):
    """Some commands need no server; what else is set is checked all the same."""
    assert load(None, {}, needs_server=False).server == ""
    with pytest.raises(SettingsInvalid, match="ROBOTETHER_MAC"):
        load(None, {"ROBOTETHER_MAC": "rubbish"}, needs_server=False)


@pytest.mark.parametrize(("server", "port"), [("a", 443), ("a:8443", 8443), ("[::1]:1", 1)])
def test_the_port_of_https(server, port):
    """443 unless the setting names another one."""
    assert load(None, {"ROBOTETHER_SERVER": server}).server_port == port


def test_a_robot_may_allow_no_shell(tmp_path):
    """In the file an empty text, in the environment a word, as an empty variable counts as not set."""
    assert load(None, {"ROBOTETHER_SERVER": "a"}).shell_address == "127.0.0.1:22"
    file = written(tmp_path, 'server = "a"\nshell_address = ""\n')
    assert load(file, {}).shell_address == ""
    environ = {"ROBOTETHER_SERVER": "a", "ROBOTETHER_SHELL_ADDRESS": "none"}
    assert load(None, environ).shell_address == ""


def test_a_named_file_must_exist(tmp_path):
    with pytest.raises(SettingsInvalid, match="no such file"):
        load(tmp_path / "none.toml", {"ROBOTETHER_SERVER": "a.example"})


def test_fingerprint_takes_colons():
    """The fingerprint is taken as openssl prints it, too."""
    text = ":".join(["AB"] * 32)
    environ = {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_TLS_FINGERPRINT": text}
    assert load(None, environ).tls_fingerprint == b"\xab" * 32


def test_secrets_are_hidden(tmp_path):
    """The token is in no output, not even in that of an error."""
    environ = {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_TOKEN": "s3cret"}
    settings = load(None, environ)
    assert settings.join_token() == "s3cret"
    assert "s3cret" not in "\n".join(shown(settings)) + repr(settings)
    with pytest.raises(SettingsInvalid) as error:
        load(written(tmp_path, 'server = "a.example"\ntoken = ["s3cret"]'), {})
    assert "s3cret" not in str(error.value)


def test_a_cameras_password_is_hidden():
    """As a proxy's; what each camera is called may be seen."""
    urls = "rear=http://ann:s3cret@10.0.0.7/video front=http://b"
    environ = {"ROBOTETHER_SERVER": "a", "ROBOTETHER_CAMERAS": urls}
    settings = load(None, environ)
    assert "s3cret" not in "\n".join(shown(settings)) + repr(settings)
    assert "cameras = rear=http://(hidden)@10.0.0.7/video, front=http://b" in shown(settings)
    with pytest.raises(SettingsInvalid) as error:
        load(None, {**environ, "ROBOTETHER_CAMERAS": urls + " bad"})
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
    """Where no password is allowed, the refusal of one does not print it."""
    with pytest.raises(SettingsInvalid) as error:
        load(None, {"ROBOTETHER_SERVER": "a.example", f"ROBOTETHER_{key.upper()}": url})
    assert "s3cret" not in str(error.value)
    assert shown_url in str(error.value)


def test_a_proxys_password_is_hidden():
    """Where the proxy is may be seen, who asks it and with what may not, not even in an error."""
    environ = {"ROBOTETHER_SERVER": "a", "ROBOTETHER_HTTP_PROXY": "http://ann:s3cret@proxy:3128"}
    settings = load(None, environ)
    assert settings.http_proxy == environ["ROBOTETHER_HTTP_PROXY"]
    assert "s3cret" not in "\n".join(shown(settings)) + repr(settings)
    assert "http_proxy = http://(hidden)@proxy:3128" in shown(settings)
    assert "http_proxy = (not set)" in shown(load(None, {"ROBOTETHER_SERVER": "a"}))
    with pytest.raises(SettingsInvalid) as error:
        load(None, {**environ, "ROBOTETHER_HTTP_PROXY": "ann:s3cret@proxy:3128"})
    assert "s3cret" not in str(error.value)


def test_token_file_is_read_when_it_is_needed(tmp_path):
    """A token file may be gone once the robot is enrolled; a join without it says which is missing."""
    file = tmp_path / "token"
    settings = load(None, {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_TOKEN_FILE": str(file)})
    with pytest.raises(SettingsInvalid, match="cannot read the join token"):
        settings.join_token()
    file.write_text("from-file\n")
    assert settings.join_token() == "from-file"


def test_example_is_complete_and_shows_the_defaults():
    """agent.toml.example has every key, and each default as it is."""
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
