"""tools/dump_database, with a program in the place of Docker."""

from __future__ import annotations

import gzip
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
# Answers as a stack whose database runs, if the file `container` is there.
COMPOSE = """#!/bin/sh
case "$*" in
  ps*) cat container 2>/dev/null || true ;;
  start*) exit "$(cat start_status)" ;;
  *mariadb-dump*) echo 'CREATE DATABASE robotether'; exit "$(cat dump_status)" ;;
  *"SHOW GRANTS FOR 'web'"*) printf 'GRANT USAGE ON *.* TO web\\nGRANT SELECT ON `robotether`.`users` TO web\\n' ;;
esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with the tool and a database that runs."""
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("dump_database", "common.sh"):
        shutil.copy(ROOT / "tools" / name, tools)
    (tools / "compose").write_text(COMPOSE)
    (tools / "compose").chmod(0o755)
    (tmp_path / "container").write_text("0123456789ab\n")
    (tmp_path / "dump_status").write_text("0")
    (tmp_path / "start_status").write_text("0")
    return tmp_path


def dump(
    checkout: Path, *arguments: str, here: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the tool there, or from another folder."""
    return subprocess.run(
        [checkout / "tools" / "dump_database", *arguments],
        cwd=here or checkout,
        env={"PATH": os.environ["PATH"]},
        check=False,
        capture_output=True,
        text=True,
        timeout=30,
    )


def test_dump_is_for_its_owner_and_old_ones_go(checkout: Path) -> None:
    """The newest dumps stay, nobody else may read them, and other files in the folder are left alone."""
    folder = checkout / "dumps"
    folder.mkdir()
    for day in range(1, 4):
        (folder / f"robotether-2020010{day}T000000Z.sql.gz").write_text("")
    (folder / "notes.txt").write_text("")
    done = dump(checkout, "dumps", "2")
    assert done.returncode == 0, done.stderr
    newest = checkout / done.stdout.split()[-1]
    # Rights too, but no account with its password.
    assert gzip.decompress(newest.read_bytes()).decode().splitlines() == [
        "CREATE DATABASE robotether",
        "GRANT SELECT ON `robotether`.`users` TO web;",
    ]
    assert newest.stat().st_mode & 0o077 == 0
    kept = {"robotether-20200103T000000Z.sql.gz", newest.name, "notes.txt"}
    assert {path.name for path in folder.iterdir()} == kept


def test_failed_dump_leaves_no_file(checkout: Path) -> None:
    """Half a dump is none, and the old ones stay."""
    (checkout / "dump_status").write_text("2")
    done = dump(checkout, "dumps")
    assert done.returncode == 1
    assert f"cannot dump the database to {checkout}/dumps/" in done.stderr
    assert list((checkout / "dumps").iterdir()) == []


def test_folder_is_the_callers(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A relative one starts where the tool is called, and not in the checkout."""
    here = tmp_path_factory.mktemp("backups")
    done = dump(checkout, ".", here=here)
    assert done.returncode == 0, done.stderr
    assert [str(path) for path in here.iterdir()] == [done.stdout.split()[-1]]


def test_database_that_runs_is_dumped_though_compose_cannot_start_it(checkout: Path) -> None:
    """Compose starts what mysql depends on, too, and fails where that was removed."""
    (checkout / "start_status").write_text("1")
    done = dump(checkout, "dumps")
    assert done.returncode == 0, done.stderr
    assert len(list((checkout / "dumps").iterdir())) == 1


def test_no_database_is_a_sentence(checkout: Path) -> None:
    """Before the first start there is nothing to dump."""
    (checkout / "container").unlink()
    done = dump(checkout, "dumps")
    assert done.returncode == 1
    assert "there is none yet" in done.stderr


@pytest.mark.parametrize("arguments", [(), ("dumps", "0"), ("dumps", "all")])
def test_wrong_arguments_are_refused(checkout: Path, arguments: tuple[str, ...]) -> None:
    """At least one dump stays, whatever is asked for."""
    done = dump(checkout, *arguments)
    assert done.returncode == 1
    assert "usage is" in done.stderr
