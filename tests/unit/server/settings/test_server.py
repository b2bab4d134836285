"""Settings: each part demands what it needs, and a wrong value stops the start with a sentence."""

import traceback

import pytest
from robotether_server.problems import SettingsError
from robotether_server.settings.server import (
    MASK,
    VARIABLES,
    DatabaseSettings,
    MigrateSettings,
    RelaySettings,
    WebSettings,
    in_force,
    load,
)

KEY = "k" * 32
PASSWORD = VARIABLES["DB_PASSWORD"]
DATABASE = {"DB_USER": "web", "DB_PASSWORD": "s3cret-of-web"}
WEB = DATABASE | {"TICKET_KEY": KEY, "WEB_SECRET_KEY": "x" * 32}
RELAY = DATABASE | {"TICKET_KEY": KEY, "SESSION_KEY": "y" * 32}


@pytest.mark.parametrize(
    ("kind", "environ", "missing"),
    [
        (DatabaseSettings, DATABASE, "DB_USER"),
        (WebSettings, WEB, "TICKET_KEY"),
        (WebSettings, WEB, "WEB_SECRET_KEY"),
        (RelaySettings, RELAY, "SESSION_KEY"),
        (MigrateSettings, DATABASE, "DB_PASSWORD"),
    ],
)
def test_missing_secret_or_account_stops_the_start(kind, environ, missing):
    """There is no default that works; a variable that is empty counts as missing."""
    for value in (None, ""):
        changed = {name: text for name, text in environ.items() if name != missing}
        if value is not None:
            changed[missing] = value
        with pytest.raises(SettingsError, match=f"cannot start without {missing}"):
            load(kind, changed)


@pytest.mark.parametrize(
    ("name", "first", "last", "why"),
    [
        ("PORT_RANGE", "30000", "30000", "PORT_RANGE_LAST=30000.*PORT_RANGE_FIRST=30000"),
        ("SHELL_PORT", "25000", "24999", "SHELL_PORT_LAST=24999.*SHELL_PORT_FIRST=25000"),
        ("SHELL_PORT", "23999", "24999", "outside PORT_RANGE_FIRST=20000 to PORT_RANGE_LAST=23999"),
        ("SHELL_PORT", "1024", "65535", "outside PORT_RANGE_FIRST=20000 to PORT_RANGE_LAST=23999"),
    ],
)
def test_ranges_of_ports_hold_robots_and_are_apart(name, first, last, why):
    """A robot needs two, its shell one."""
    load(MigrateSettings, DATABASE | {"SHELL_PORT_FIRST": "24000", "SHELL_PORT_LAST": "24000"})
    with pytest.raises(SettingsError, match=why):
        load(MigrateSettings, DATABASE | {f"{name}_FIRST": first, f"{name}_LAST": last})


def test_secret_that_may_be_empty_is_not_masked(tmp_path):
    """A mask stands for a value; an empty file is none."""
    file = tmp_path / "admin_password"
    file.write_text("\n")
    from_file = {"ADMIN_PASSWORD_FILE": str(file)}
    for environ in ({}, {"ADMIN_PASSWORD": ""}, from_file):
        assert in_force(environ)["ADMIN_PASSWORD"] == "(not set)"
    file.write_text("a-password-of-ones-own\n")
    assert in_force(from_file)["ADMIN_PASSWORD"] == MASK


WRONG = {
    "SIM_CAMERA_FPS": ("0.5", "nan", "fast"),
    "DB_HOST": ("my host", "db:3306"),
    "DB_NAME": ("a-b",),
    "TICKET_TTL_S": ("4", "301", "30s"),
    "PUBLIC_HOST": ("https://a", "a:8443", "2001:db8::1%eth0", "192.168.1.256", "a..b"),
    "PUBLIC_PORT": ("0", "443 ", "0443"),
    "TLS_FRONT": ("nginx", "nginx:https"),
    "SSH_PORTS": ("2222,99999", "2222,"),
    "ALLOWED_ORIGINS": ("lab.example", "https://lab.example/path"),
    "DIRECT_SOURCES": ("10.0.0", "192.0.2.0/24,", "192.0.2.0/33", "0.0.0.0/0", "::/0"),
    "TRUSTED_PROXIES": ("10.0.0", "0.0.0.0/1", "10.0.0.0/255.0.0.0"),
    "JOIN_POLICY": ("first",),
    "ALLOW_LOCAL_MACS": ("true",),
    "SHELL_PORT_LAST": ("80", "65536"),
    "DOMAIN": ("Robots.example.org", "localhost", "https://robots.example.org"),
    "ACME_EMAIL": ("ops",),
    "ACME_SERVER": ("http://acme.example.org",),
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in WRONG.items() for value in values]
)
def test_wrong_value_is_named_with_what_is_allowed(name, value):
    variable = VARIABLES[name]
    with pytest.raises(SettingsError) as refused:
        variable.read({name: value})
    assert refused.value.detail == f"cannot use {name}={value!r}: allowed is {variable.allowed}"


@pytest.mark.parametrize("variable", VARIABLES.values(), ids=lambda variable: variable.name)
def test_every_default_is_allowed_and_no_secret_has_one(variable):
    if variable.secret:
        assert not variable.default
    elif variable.default is not None:
        variable.read({})


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("SSH_PORTS", "443,2222", (443, 2222)),
        ("ALLOWED_ORIGINS", "https://Lab:443, http://a:8080", ("https://lab", "http://a:8080")),
        ("TRUSTED_PROXIES", "10.0.0.5/32, ::1/128", ("10.0.0.5/32", "::1/128")),
        ("TLS_FRONT", "10.0.0.1:443", ("10.0.0.1", 443)),
        ("ALLOW_LOCAL_MACS", "yes", True),
    ],
)
def test_value_is_read(name, text, value):
    """Ports keep their order; white space after a comma is no part of an origin or a network."""
    assert VARIABLES[name].read({name: text}) == value


def test_secret_comes_from_its_file_alone(tmp_path):
    """The newline at the end of the file is not part of it; with both, which one holds would be a guess."""
    file = tmp_path / "secret"
    file.write_text("of-the-file\n")
    environ = {"DB_PASSWORD_FILE": str(file)}
    assert PASSWORD.read(environ) == "of-the-file"
    with pytest.raises(SettingsError, match="both DB_PASSWORD and DB_PASSWORD_FILE"):
        PASSWORD.read(environ | {"DB_PASSWORD": "a"})
    file.unlink()
    with pytest.raises(SettingsError, match=r"DB_PASSWORD_FILE=.*secret"):
        PASSWORD.read(environ)


@pytest.mark.parametrize("name", [item.name for item in VARIABLES.values() if item.secret])
@pytest.mark.parametrize("is_in_file", [False, True])
def test_wrong_secret_is_not_shown(name, is_in_file, tmp_path):
    file = tmp_path / "secret"
    file.write_text("has blanks")
    variable, value = VARIABLES[name], "has blanks"
    environ = {f"{name}_FILE": str(file)} if is_in_file else {name: value}
    with pytest.raises(SettingsError) as refused:
        variable.read(environ)
    assert refused.value.detail == f"cannot use the secret in {name}: allowed is {variable.allowed}"
    assert value not in "".join(traceback.format_exception(refused.value))
