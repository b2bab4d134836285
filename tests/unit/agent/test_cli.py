"""The command: what each subcommand but `run` prints, and its exit code."""

import asyncio
import io
import json
import logging
import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest
from fake_cloud import agent_environ
from fake_root import FakeRoot
from robotether_agent import cli as command
from robotether_agent.cli import identity, main, status
from robotether_agent.doctor import fail, ok, skipped
from robotether_agent.enrolment.keys import ensure_key
from robotether_agent.files import LOCK, ensure_directory, only_one
from robotether_agent.settings import Settings, load
from robotether_agent.status import StatusWriter
from robotether_common.join import JOIN_NAMESPACE, join_message
from robotether_server.signatures import is_signed

MAC = "00:1b:44:11:3a:b7"
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
WHO = "import os; print(os.geteuid(), os.getegid(), len(os.getgroups()))"


def teardown_module():
    logging.getLogger().handlers.clear()


def test_for_programs_it_is_one_object(place, capsys):
    settings = Settings(server="a.example", run_dir=place)
    assert status(settings, as_json=True) == 1
    assert json.loads(capsys.readouterr().out) == {"is_running": False}
    writer = StatusWriter(place, "a.example", on_state=lambda _: None)
    writer.set(state="connected", robot="sim1")
    assert status(settings, as_json=True) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["is_running"], output["state"], output["robot"]) == (True, "connected", "sim1")
    writer.set(state="stopped")
    assert status(settings, as_json=True) == 1
    assert json.loads(capsys.readouterr().out)["is_running"] is False


async def joined(cloud, place, **more):
    return await asyncio.to_thread(main, ["join"], agent_environ(cloud, place, **more))


async def test_pending(make_cloud, place, capsys):
    assert await joined(await make_cloud("pending"), place) == 10
    output = capsys.readouterr().out
    key = await ensure_key(place / "state")
    assert output.startswith("pending: cannot connect to")
    assert "robotether robot approve robot-00000a" in output
    assert key.fingerprint in output


def test_prints_the_proof_that_a_playbook_brings(place, capsys):
    """Over MAC and key, as a join without a token has it; Ansible strips the last line's end."""
    environ = {"ROBOTETHER_STATE_DIR": str(place / "state"), "ROBOTETHER_MAC": MAC}
    assert main(["key"], environ) == 0
    key = capsys.readouterr().out.strip()
    assert main(["key", "--prove"], environ) == 0
    proof = capsys.readouterr().out.rstrip()
    assert is_signed(key, JOIN_NAMESPACE, join_message(None, MAC, key), proof)


@pytest.fixture
def root(tmp_path):
    made = FakeRoot(tmp_path)
    made.add("eth0", MAC, 2)
    return made


def test_what_it_prints_is_kept(root, place, capsys):
    settings = load(None, {"ROBOTETHER_STATE_DIR": str(place / "state")}, needs_server=False)
    assert identity(settings, as_json=False, root=root.path) == 0
    assert capsys.readouterr().out == f"{MAC} eth0\n"
    root.add("wlan0", "00:1b:44:00:00:01", 3)
    root.route(("wlan0", 1))
    assert identity(settings, as_json=True, root=root.path) == 0
    output = json.loads(capsys.readouterr().out)
    assert output == {"mac": MAC, "interface": "eth0", "is_present": True, "is_kept": True}


@pytest.mark.parametrize(
    ("findings", "code", "last"),
    [
        ([ok("a", "x"), skipped("b", "y")], 0, "all is well"),
        ([ok("a", "x"), fail("b", "y", "z"), fail("c", "y", "z")], 1, "2 of these steps failed"),
    ],
)
def test_the_exit_code_is_the_worst_of_all(monkeypatch, capsys, findings, code, last):
    settings = Settings(server="a.example", state_dir=Path("/none"))

    async def run_checks(_):
        for finding in findings:
            yield finding

    monkeypatch.setattr(command, "run_checks", run_checks)
    assert command.doctor(lambda: settings) == code
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "ok       a            x"
    assert lines[-1] == last


def test_wrong_settings_are_the_first_finding(capsys):
    assert main(["doctor"], {"ROBOTETHER_SERVER": "https://a"}) == 1
    output = capsys.readouterr().out
    assert output.startswith("FAIL     settings     cannot use ROBOTETHER_SERVER")
    assert "what to do: correct it" in output


def test_doctor_without_root_says_so_before_all_else(place, monkeypatch, capsys):
    """What this user may not read would look like a damaged key."""
    (place / "state").mkdir()
    monkeypatch.setattr(os, "access", lambda *_: False)
    environ = {"ROBOTETHER_SERVER": "a.example", "ROBOTETHER_STATE_DIR": str(place / "state")}
    assert main(["doctor"], environ) == 1
    [line, advice] = capsys.readouterr().out.splitlines()
    assert line.startswith("FAIL     user ")
    assert advice.endswith("what to do: run this with sudo")


@pytest.fixture
def robot_environ(place):
    made = {
        "ROBOTETHER_STATE_DIR": str(place / "state"),
        "ROBOTETHER_RUN_DIR": str(place / "run"),
    }
    assert main(["key"], made) == 0
    return made


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("answer", "code"), [("yes\n", 0), ("\n", 1)])
def test_a_person_is_asked(robot_environ, capsys, monkeypatch, answer, code):
    monkeypatch.setattr("sys.stdin", Terminal(answer))
    assert main(["forget"], robot_environ) == code
    output = capsys.readouterr().out
    assert "removes id_ed25519, id_ed25519.pub. This cannot be undone" in output
    assert Path(robot_environ["ROBOTETHER_STATE_DIR"], "id_ed25519").exists() == bool(code)


def test_without_a_terminal_it_needs_a_word(robot_environ, place, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    assert main(["forget"], robot_environ) == 1
    assert "add --yes" in capsys.readouterr().out
    assert main(["forget", "--yes"], robot_environ) == 0
    assert list((place / "state").iterdir()) == []
    assert main(["forget", "--yes"], robot_environ) == 0
    assert "nothing to forget" in capsys.readouterr().out


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone can be somebody else")
def test_an_ordinary_user_forgets_nothing(robot_environ, place, capsys):
    place.chmod(0o755)
    os.seteuid(65534)
    try:
        assert main(["forget", "--yes"], robot_environ) == 1
    finally:
        os.seteuid(0)
    output = capsys.readouterr().err
    assert "state: Permission denied; run this with sudo [state_unusable]" in output
    assert (place / "state/id_ed25519").exists()


def test_not_while_the_agent_runs(robot_environ, place, capsys):
    ensure_directory(place / "run", "run_dir")
    with only_one(place / "run" / LOCK):
        assert main(["forget", "--yes"], robot_environ) == 75
    assert "sudo systemctl stop robotether-agent" in capsys.readouterr().err
    assert (place / "state/id_ed25519").exists()


def child_in(place, more):
    """Run Python in a process of its own, since a right that is dropped never comes back."""
    environ = {"PATH": os.environ["PATH"], "PYTHONPATH": ":".join(sys.path)}
    code = f"from pathlib import Path; from robotether_agent import cli; {more.format(place=place)}; {WHO}"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True, env=environ).stdout


@needs_root
def test_root_becomes_the_owner_of_the_state(place):
    nobody = pwd.getpwnam("nobody")
    place.chmod(0o755)
    state = place / "state"
    state.mkdir()
    os.chown(state, nobody.pw_uid, nobody.pw_gid)
    output = child_in(place, "cli.act_as_agent(Path('{place}/state'))")
    assert output.split()[:2] == [str(nobody.pw_uid), str(nobody.pw_gid)]


@needs_root
def test_a_missing_directory_is_made_for_the_agents_user(place):
    nobody = pwd.getpwnam("nobody")
    place.chmod(0o755)
    more = "cli.AGENT_USER = 'nobody'; cli.act_as_agent(Path('{place}/new/state'))"
    assert child_in(place, more).split()[0] == str(nobody.pw_uid)
    made = (place / "new/state").stat()
    assert (made.st_uid, made.st_mode & 0o777) == (nobody.pw_uid, 0o700)
