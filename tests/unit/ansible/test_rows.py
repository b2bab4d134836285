"""An admin who retires a machine removes its own row, whatever the machine says of itself."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SOURCE = ROOT / "ansible/plugins/module_utils/rows.py"
MAC, OTHER_MAC = "00:1b:44:00:61:01", "00:1b:44:00:61:02"
LINE = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA robotether"


# Ansible finds its modules by itself, and Python does not.
spec = importlib.util.spec_from_file_location("rows", SOURCE)
rows = importlib.util.module_from_spec(spec)
spec.loader.exec_module(rows)
KEY = rows.fingerprint_of(LINE)


def row(name, mac, fingerprint="SHA256:other"):
    return {"name": name, "mac": mac, "fingerprint": fingerprint}


@pytest.mark.parametrize(
    "own",
    [
        row("turtle", MAC),
        row("turtle", MAC, None),
        row("renamed", MAC, KEY),
        row("turtle", OTHER_MAC, KEY),
        row("renamed", OTHER_MAC, KEY),
    ],
)
def test_own_row_is_found(own):
    others = [row("victim", "00:1b:44:00:61:03")]
    assert rows.own_row([*others, own], "turtle", MAC, LINE) == own


@pytest.mark.parametrize("key", [LINE, None, "rubbish", ""])
@pytest.mark.parametrize("fingerprint", ["SHA256:other", None, ""])
def test_row_of_another_robot_is_never_it(key, fingerprint):
    """A machine that names another robot's MAC, with or without a row of its own, gets nobody removed."""
    victim = row("victim", OTHER_MAC, fingerprint)
    with pytest.raises(rows.ForeignRowError, match=rf"victim \(MAC {OTHER_MAC}\)"):
        rows.own_row([row("turtle", MAC), victim], "turtle", OTHER_MAC, key)
    with pytest.raises(rows.ForeignRowError, match="remove the right one by hand"):
        rows.own_row([victim], "turtle", OTHER_MAC, key)


def test_unknown_machine_has_no_row():
    assert rows.own_row([row("victim", OTHER_MAC)], "turtle", MAC, LINE) is None


def test_fingerprint_is_that_of_ssh_keygen():
    assert rows.fingerprint_of(LINE.rsplit(" ", 1)[0]) == KEY
    assert KEY.startswith("SHA256:")
    assert len(KEY) == len("SHA256:") + 43
