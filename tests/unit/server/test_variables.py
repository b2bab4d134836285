"""Variables: what each allows, secrets from files, and sentences that show no secret."""

from __future__ import annotations

import traceback
from pathlib import Path

import pytest
from robotether_server.problems import SettingsError
from robotether_server.variables import (
    ALLOWED_ORIGINS,
    DB_PASSWORD,
    SSH_PORTS,
    TLS_FRONT,
    VARIABLES,
    Variable,
)

BY_NAME = {variable.name: variable for variable in VARIABLES}
SECRETS = [variable for variable in VARIABLES if variable.secret]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("DB_PORT", "0"),
        ("DB_PORT", "mysql"),
        ("DB_HOST", "my host"),
        ("DB_NAME", "a-b"),
        ("TICKET_TTL_S", "4"),
        ("TICKET_TTL_S", "301"),
        ("TICKET_TTL_S", "30s"),
        ("LOGIN_TTL_H", "0"),
        ("LOGIN_IDLE_H", "721"),
        ("PUBLIC_HOST", "https://a"),
        ("PUBLIC_PORT", "0"),
        ("TLS_FRONT", "nginx"),
        ("TLS_FRONT", "nginx:https"),
        ("SSH_PORTS", "2222,99999"),
        ("SSH_PORTS", "2222,"),
        ("MESSAGE_LIMIT_MB", "0"),
        ("ALLOWED_ORIGINS", "lab.example"),
        ("ALLOWED_ORIGINS", "https://lab.example/path"),
        ("MAX_PENDING", "-1"),
        ("JOIN_POLICY", "first"),
        ("ALLOW_LOCAL_MACS", "true"),
        ("SHELL_PORT_FIRST", "80"),
        ("SHELL_PORT_LAST", "65536"),
        ("AUDIT_DAYS", "-1"),
        ("AUDIT_DAYS", "36501"),
        ("PORT_RANGE_FIRST", "80"),
        ("PORT_RANGE_LAST", "65536"),
        ("LOG_LEVEL", "loud"),
    ],
)
def test_wrong_value_is_named_with_what_is_allowed(name: str, value: str) -> None:
    """The sentence has variable, value and the allowed values."""
    variable = BY_NAME[name]
    with pytest.raises(SettingsError) as refused:
        variable.read({name: value})
    assert refused.value.detail == f"cannot use {name}={value!r}: allowed is {variable.allowed}"


@pytest.mark.parametrize("variable", VARIABLES, ids=lambda variable: variable.name)
def test_every_default_is_allowed_and_no_secret_has_one(variable: Variable[object]) -> None:
    """A default that its own rule refuses would stop every start."""
    if variable.secret:
        assert not variable.default
    elif variable.default is not None:
        variable.read({})


def test_lists_are_read() -> None:
    """Ports keep their order; origins may stand alone or be none."""
    assert SSH_PORTS.read({"SSH_PORTS": "443,2222"}) == (443, 2222)
    given = "https://lab.example, http://localhost:8080"
    assert ALLOWED_ORIGINS.read({"ALLOWED_ORIGINS": given}) == (
        "https://lab.example",
        "http://localhost:8080",
    )


def test_endpoint_is_read() -> None:
    """A host and its port."""
    assert TLS_FRONT.read({"TLS_FRONT": "10.0.0.1:443"}) == ("10.0.0.1", 443)


def test_secret_comes_from_its_file(tmp_path: Path) -> None:
    """The newline at the end of the file is not part of it."""
    file = tmp_path / "secret"
    file.write_text("of the file\n".replace(" ", "-"))
    assert DB_PASSWORD.read({"DB_PASSWORD_FILE": str(file)}) == "of-the-file"
    assert DB_PASSWORD.is_set({"DB_PASSWORD_FILE": str(file)})


def test_secret_from_both_is_refused(tmp_path: Path) -> None:
    """Which one holds would be a guess."""
    environ = {"DB_PASSWORD": "a", "DB_PASSWORD_FILE": str(tmp_path / "b")}
    with pytest.raises(SettingsError, match="both DB_PASSWORD and DB_PASSWORD_FILE"):
        DB_PASSWORD.read(environ)


def test_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    """The sentence has variable and path."""
    with pytest.raises(SettingsError, match=r"DB_PASSWORD_FILE=.*nowhere"):
        DB_PASSWORD.read({"DB_PASSWORD_FILE": str(tmp_path / "nowhere")})


def test_only_secrets_come_from_files() -> None:
    """LOG_LEVEL_FILE is nothing that anybody reads."""
    assert BY_NAME["LOG_LEVEL"].read({"LOG_LEVEL_FILE": "/etc/passwd"}) == "info"


@pytest.mark.parametrize("variable", SECRETS, ids=lambda variable: variable.name)
@pytest.mark.parametrize("is_in_file", [False, True])
def test_wrong_secret_is_not_shown(
    variable: Variable[object], is_in_file: bool, tmp_path: Path
) -> None:
    """The sentence has the name and what is allowed; not even a traceback has the value."""
    file = tmp_path / "secret"
    file.write_text("has blanks")
    name, value = variable.name, "has blanks"
    environ = {f"{name}_FILE": str(file)} if is_in_file else {name: value}
    with pytest.raises(SettingsError) as refused:
        variable.read(environ)
    assert refused.value.detail == f"cannot use the secret in {name}: allowed is {variable.allowed}"
    assert value not in "".join(traceback.format_exception(refused.value))
