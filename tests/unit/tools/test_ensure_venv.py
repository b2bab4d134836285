"""tools/ensure_venv, in a checkout whose requirements are none."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def test_environment_of_a_python_that_is_gone_is_made_again(tmp_path: Path) -> None:
    """An upgrade of the release takes the Python that the environment's links lead to."""
    (tmp_path / "tools").mkdir()
    for name in ("ensure_venv", "common.sh"):
        shutil.copy(ROOT / "tools" / name, tmp_path / "tools")
    (tmp_path / "requirements").mkdir()
    (tmp_path / "requirements/dev.txt").write_text("")
    programs = tmp_path / "venv/bin"
    programs.mkdir(parents=True)
    (programs / "python").symlink_to("/usr/bin/python-of-a-release-before")
    (programs / "pip").write_text("#!/usr/bin/python-of-a-release-before\n")
    (programs / "pip").chmod(0o755)
    done = subprocess.run(
        ["tools/ensure_venv", "venv"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert subprocess.run([programs / "pip", "--version"], check=False).returncode == 0
    assert (tmp_path / "venv/.complete").exists()
