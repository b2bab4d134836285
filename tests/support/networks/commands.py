"""Programs that a test runs to their end, and those that it puts in the place of this machine's own."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
LIMIT_S = 120.0


def run_command(
    *words: str | Path, limit_s: float = LIMIT_S, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program, which may fail; with what it printed as text. TimeoutExpired after `limit_s`."""
    given: dict[str, Any] = {"capture_output": True, **options}
    if "input" not in options:
        given.setdefault("stdin", subprocess.DEVNULL)
    return subprocess.run(words, text=True, check=False, timeout=limit_s, **given)


def output_of_command(*words: str | Path, **options: Any) -> str:
    """Run a program that must succeed, and return what it printed; AssertionError with the end of what it said."""
    done = run_command(*words, **options)
    if done.returncode != 0:
        said = f"{done.stdout[-4000:]}\n{done.stderr[-8000:]}"
        raise AssertionError(f"{' '.join(map(str, words))} exited {done.returncode}\n{said}")
    return done.stdout


def write_programs(folder: Path, programs: Mapping[str, str]) -> None:
    folder.mkdir(exist_ok=True)
    for name, text in programs.items():
        (folder / name).write_text(text if text.startswith("#!") else f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)


def copy_tools(checkout: Path, *names: str) -> None:
    """Let a checkout have these of our tools, and what they share."""
    (checkout / "tools").mkdir(parents=True, exist_ok=True)
    for name in (*names, "common.sh"):
        shutil.copy(ROOT / "tools" / name, checkout / "tools")


def path_with(folder: Path) -> dict[str, str]:
    return {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
