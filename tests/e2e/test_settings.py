"""A wrong setting stops the start and says which, what and what is allowed."""

from __future__ import annotations

import pytest
from stack import Stack


@pytest.mark.parametrize(
    ("service", "variable", "value"),
    [
        ("web", "TICKET_TTL_S", "soon"),
        ("relay", "MESSAGE_LIMIT_MB", "0"),
        ("migrate", "PORT_RANGE_FIRST", "80"),
    ],
)
def test_wrong_value_stops_the_start(stack: Stack, service: str, variable: str, value: str) -> None:
    """The service exits at once with one sentence about the variable."""
    with pytest.raises(AssertionError) as stopped:
        stack.compose(
            "run", "--rm", "--no-deps", "-T", "-e", f"{variable}={value}", service, timeout=60
        )
    # Without the command, which has both words.
    printed = str(stopped.value).partition(" exited ")[2]
    assert variable in printed
    assert value in printed
    assert "Traceback" not in printed


def test_show_settings_masks_secrets(stack: Stack) -> None:
    """What is in force is printed, without any secret."""
    printed = stack.robotether("show-settings")
    assert "TICKET_TTL_S" in printed
    for name in ("ticket_key", "web_secret_key", "mysql_web_password"):
        secret = stack.exec("web", "cat", f"/run/secrets/{name}").strip()
        assert len(secret) > 20
        assert secret not in printed
