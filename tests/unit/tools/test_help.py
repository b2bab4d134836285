"""Asked for help, a script says what it does, and does nothing."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parents[3] / "tools"
SCRIPTS = [path for path in TOOLS.iterdir() if path.is_file() and not path.suffix]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_help_is_the_comment_at_the_head(script):
    asked = subprocess.run(
        [script, "--help"], check=True, timeout=20, stdout=subprocess.PIPE, text=True
    )
    head = script.read_text().splitlines()[1]
    assert asked.stdout.splitlines()[0] == head.removeprefix("# ")


@pytest.mark.parametrize("name", ["agent_wheelhouse.py", "coverage.py"])
def test_help_of_a_program_is_its_docstring(tmp_path, name):
    """Run where it could not do its work."""
    program = tmp_path / name
    program.write_text((TOOLS / name).read_text())
    command = [sys.executable, program, "--help"]
    asked = subprocess.run(command, check=True, timeout=20, stdout=subprocess.PIPE, text=True)
    assert f"tools/{name}" in asked.stdout.splitlines()[0]


def test_wheelhouse_that_cannot_be_made_is_a_sentence(tmp_path):
    (tmp_path / "file").touch()
    command = [sys.executable, TOOLS / "agent_wheelhouse.py", "amd64", tmp_path / "file"]
    done = subprocess.run(command, check=False, timeout=20, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (1, f"cannot fill {tmp_path / 'file'}: File exists\n")
