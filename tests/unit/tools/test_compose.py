"""tools/compose --env, which other tools ask for settings: what it prints is what compose reads."""

import os

import pytest
from commands import copy_tools, output_of_command


def setting(checkout, line, **environment):
    """What is in force with this line in compose/.env."""
    copy_tools(checkout, "compose")
    (checkout / "compose").mkdir(exist_ok=True)
    (checkout / "compose" / ".env").write_text(f"OTHER=x\n{line}\nDB_HOST_OF=y\n")
    environ = {"PATH": os.environ["PATH"], "HOME": "/root", **environment}
    said = output_of_command("tools/compose", "--env", "DB_HOST", cwd=checkout, env=environ)
    return said.removesuffix("\n")


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("DB_HOST=192.0.2.1", "192.0.2.1"),
        ("DB_HOST=192.0.2.1             # where all machines reach it", "192.0.2.1"),
        ("DB_HOST='a # b' # c", "a # b"),
        ("DB_HOST=a\nDB_HOST=b", "b"),
        ("#DB_HOST=a", ""),
        (" export DB_HOST = a ", "a"),
        ("DB_HOST=${OTHER}$HOME", "x/root"),
        ("DB_HOST='$OTHER'", "$OTHER"),
        ("", ""),
    ],
)
def test_value_is_what_compose_reads(tmp_path, line, value):
    assert setting(tmp_path, line) == value


def test_environment_goes_before_the_file(tmp_path):
    assert setting(tmp_path, "DB_HOST=a", DB_HOST="b") == "b"


def test_another_file_is_there_or_nothing_is_done(tmp_path):
    """Its stack would else be taken for that of compose/.env."""
    (tmp_path / "two").write_text("DB_HOST=b")
    for name in ("two", tmp_path / "two"):
        assert setting(tmp_path, "DB_HOST=a", ENV_FILE=str(name)) == "b"
    with pytest.raises(AssertionError, match="cannot use ENV_FILE=three: there is no file /"):
        setting(tmp_path, "DB_HOST=a", ENV_FILE="three")
