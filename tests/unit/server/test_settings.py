"""Settings: each part demands what it needs, and a wrong value stops the start with a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from robotether_server import settings
from robotether_server.problems import SettingsError

KEY = "k" * 32
DATABASE = {"DB_USER": "web", "DB_PASSWORD": "s3cret-of-web"}
WEB = DATABASE | {"TICKET_KEY": KEY, "WEB_SECRET_KEY": "x" * 32}
RELAY = DATABASE | {"TICKET_KEY": KEY, "SESSION_KEY": "y" * 32}


def test_defaults_are_the_documented_ones() -> None:
    """With nothing but secrets and the account, everything else has its default."""
    web = settings.load_web(WEB)
    assert (web.database.host, web.database.port, web.database.name) == (
        "mysql",
        3306,
        "robotether",
    )
    assert (web.tickets.ttl_s, web.login_ttl_h, web.login_idle_h) == (30, 12, 4)
    assert web.log_level == "info"
    assert (web.join.policy, web.join.max_pending, web.join.public_host) == ("approve", 50, None)
    assert web.join.ssh_ports == (2222, 443)
    assert web.join.allow_local_macs is False
    assert web.join.ssh_host_keys_dir == Path("/ssh_host_keys")
    assert (web.site_address.public_host, web.site_address.public_port) == (None, 443)
    assert web.site_address.tls_front == ("nginx", 8443)
    assert web.agent_files_dir == Path("/usr/share/robotether/agent")
    assert web.allowed_origins == ()
    relay = settings.load_relay(RELAY)
    assert (relay.tunnel_host, relay.allowed_origins) == ("sshd", ())
    assert relay.message_limit_bytes == 10 * 1024 * 1024
    migrate = settings.load_migrate(DATABASE)
    assert (migrate.port_range_first, migrate.port_range_last) == (20000, 23999)
    assert (migrate.shell_port_first, migrate.shell_port_last) == (24000, 25999)
    assert migrate.migrations_dir == Path("/usr/share/robotether/sql")


@pytest.mark.parametrize(
    ("load", "environ", "missing"),
    [
        (settings.load_database, DATABASE, "DB_USER"),
        (settings.load_database, DATABASE, "DB_PASSWORD"),
        (settings.load_web, WEB, "TICKET_KEY"),
        (settings.load_web, WEB, "WEB_SECRET_KEY"),
        (settings.load_relay, RELAY, "TICKET_KEY"),
        (settings.load_relay, RELAY, "SESSION_KEY"),
        (settings.load_migrate, DATABASE, "DB_PASSWORD"),
    ],
)
def test_missing_secret_or_account_stops_the_start(
    load: Callable[[Mapping[str, str]], object], environ: dict[str, str], missing: str
) -> None:
    """There is no default that works; a variable that is empty counts as missing."""
    for value in (None, ""):
        changed = {name: text for name, text in environ.items() if name != missing}
        if value is not None:
            changed[missing] = value
        with pytest.raises(SettingsError, match=f"cannot start without {missing}"):
            load(changed)


def test_range_must_hold_a_pair() -> None:
    """The sentence names both ends."""
    environ = DATABASE | {"PORT_RANGE_FIRST": "30000", "PORT_RANGE_LAST": "30000"}
    with pytest.raises(SettingsError, match=r"PORT_RANGE_LAST=30000.*PORT_RANGE_FIRST=30000"):
        settings.load_migrate(environ)


@pytest.mark.parametrize(
    ("first", "last", "why"),
    [
        ("25000", "24999", "SHELL_PORT_LAST=24999.*SHELL_PORT_FIRST=25000"),
        ("23999", "24999", "outside PORT_RANGE_FIRST=20000 to PORT_RANGE_LAST=23999"),
        ("1024", "65535", "outside PORT_RANGE_FIRST=20000 to PORT_RANGE_LAST=23999"),
        ("19000", "20000", "outside PORT_RANGE_FIRST=20000 to PORT_RANGE_LAST=23999"),
    ],
)
def test_shell_ports_are_a_range_of_their_own(first: str, last: str, why: str) -> None:
    """One port may be enough; no port is of both ranges."""
    one = settings.load_migrate(
        DATABASE | {"SHELL_PORT_FIRST": "24000", "SHELL_PORT_LAST": "24000"}
    )
    assert one.shell_port_last == 24000
    with pytest.raises(SettingsError, match=why):
        settings.load_migrate(DATABASE | {"SHELL_PORT_FIRST": first, "SHELL_PORT_LAST": last})


def test_history_is_kept_for_days() -> None:
    """A year when nothing is said; 0 is for ever."""
    assert settings.load_migrate(DATABASE).audit_days == 365
    assert settings.load_migrate(DATABASE | {"AUDIT_DAYS": "0"}).audit_days == 0


@pytest.mark.parametrize("policy", ["approve", "first-key", "token-only"])
def test_policy_is_one_of_three(policy: str) -> None:
    """A misspelt one stops the start, and so does a yes that is none."""
    assert settings.load_join({"JOIN_POLICY": policy}).policy == policy
    assert settings.load_join({"ALLOW_LOCAL_MACS": "yes"}).allow_local_macs is True
    for wrong in ({"JOIN_POLICY": f"{policy}s"}, {"ALLOW_LOCAL_MACS": "true"}):
        with pytest.raises(SettingsError, match="allowed is"):
            settings.load_join(wrong)


def test_in_force_shows_everything_and_no_secret() -> None:
    """Secrets are masked, and what is not set is said so."""
    shown = settings.in_force(WEB | {"TICKET_TTL_S": "45"})
    assert shown["TICKET_TTL_S"] == "45"
    assert shown["TICKET_KEY"] == shown["DB_PASSWORD"] == settings.MASK
    assert shown["SESSION_KEY"] == "(not set)"
    assert not set(WEB.values()) - {"web"} & set(shown.values())


def test_secret_that_may_be_empty_is_not_masked(tmp_path: Path) -> None:
    """A mask stands for a value; an empty file is none."""
    file = tmp_path / "admin_password"
    file.write_text("\n")
    from_file = {"ADMIN_PASSWORD_FILE": str(file)}
    for environ in ({}, {"ADMIN_PASSWORD": ""}, from_file):
        assert settings.in_force(environ)["ADMIN_PASSWORD"] == "(not set)"
    file.write_text("a-password-of-ones-own\n")
    assert settings.in_force(from_file)["ADMIN_PASSWORD"] == settings.MASK


def test_in_force_refuses_a_wrong_value() -> None:
    """What is printed is what would start."""
    with pytest.raises(SettingsError, match="TICKET_TTL_S='soon'"):
        settings.in_force(WEB | {"TICKET_TTL_S": "soon"})


def test_printing_settings_shows_no_secret() -> None:
    """A log line with the whole object gives nothing away."""
    loaded = (settings.load_web(WEB), settings.load_relay(RELAY))
    for secret in {*WEB.values(), *RELAY.values()} - {"web"}:
        assert secret not in repr(loaded)
