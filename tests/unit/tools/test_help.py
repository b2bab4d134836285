"""Asked for help, a script says what it does, and does nothing."""

import sys
from pathlib import Path

import pytest
from commands import output_of_command, run_command

TOOLS = Path(__file__).resolve().parents[3] / "tools"
SCRIPTS = [path for path in TOOLS.iterdir() if path.is_file() and not path.suffix]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_help_is_the_comment_at_the_head(script):
    head = script.read_text().splitlines()[1]
    assert output_of_command(script, "--help").splitlines()[0] == head.removeprefix("# ")


@pytest.mark.parametrize("name", ["agent_wheelhouse.py", "coverage.py"])
def test_help_of_a_program_is_its_docstring(tmp_path, name):
    """Run where it could not do its work."""
    program = tmp_path / name
    program.write_text((TOOLS / name).read_text())
    said = output_of_command(sys.executable, program, "--help")
    assert f"tools/{name}" in said.splitlines()[0]


def test_wheelhouse_that_cannot_be_made_is_a_sentence(tmp_path):
    (tmp_path / "file").touch()
    program = TOOLS / "agent_wheelhouse.py"
    done = run_command(sys.executable, program, "amd64", tmp_path / "file")
    assert (done.returncode, done.stderr) == (1, f"cannot fill {tmp_path / 'file'}: File exists\n")
