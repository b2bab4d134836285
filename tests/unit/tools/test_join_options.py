"""What agent/join.sh refuses to do before it looks at the machine; tests/ansible/test_join_line.py tries the rest."""

import os
import re
import sys
from pathlib import Path

import pytest
from commands import output_of_command, path_with, run_command
from local_network import free_port

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = ROOT / "agent/join.sh"


def run(*options, folder=None, programs=None):
    environ = {**os.environ, **(path_with(programs) if programs else {})}
    return run_command("sh", SCRIPT, *options, cwd=folder, env=environ)


def test_no_image_holds_an_api_token():
    """Every card would give whoever finds it the rights of the token's user."""
    done = run("--server", "robots.example", "--token", "rt_x", "--image")
    assert done.returncode == 1
    assert "cannot put an API token into an image" in done.stderr
    assert "rt_x" not in done.stderr


@pytest.mark.parametrize(
    "value", ["a b", "a;id", "$(id)", "`id`", 'a"b', "a\\b", "a\nb", "-x", "", "a'b", "a|b", "a>b"]
)
def test_no_value_is_more_than_a_word(value):
    """Values become lines of a file and arguments of commands that root runs."""
    done = run("--server", value)
    assert done.returncode == 1
    assert "cannot use --server" in done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="it looks at the machine as root only")
def test_no_module_of_the_folder_that_it_is_started_in(tmp_path):
    """Root may start it where anybody can put a file."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/systemctl").symlink_to("/bin/true")
    module = f"open({str(tmp_path / 'was-run')!r}, 'w')"
    for name in ("venv", "ssl", "http", "hmac"):
        (tmp_path / f"{name}.py").write_text(module)
    options = ("--server", f"127.0.0.1:{free_port()}", "--image", "--wheelhouse", "bin")
    done = run(*options, folder=tmp_path, programs=tmp_path / "bin")
    assert "Connection refused" in done.stderr
    assert not (tmp_path / "was-run").exists()


def test_looks_at_the_machine_without_any_package():
    """What it takes from the agent's wheel before it installs runs on a bare Python 3.10, which has no tomllib."""
    taken = re.findall(r"^from robotether_agent\S* import .*$", SCRIPT.read_text(), re.MULTILINE)
    assert taken
    path = [str(ROOT / "agent"), str(ROOT / "common")]
    lines = [
        "import sys",
        "sys.modules['tomllib'] = None",
        f"sys.path[:0] = {path}",
        "import robotether_agent.install",
        *taken,
    ]
    output_of_command(sys.executable, "-I", "-S", "-c", "\n".join(lines))
