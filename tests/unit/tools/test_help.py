"""Asked for help, a script says what it does, and does nothing."""

import subprocess
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
