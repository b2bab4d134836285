"""What the account `jump` lets people do, asked of the running daemon: reach the shells of their robots, no more."""

import pytest
from commands import run_command
from jump_people import BANNER, JUMP, Person, end, ended, lives
from robot_key import first_line

REGISTER = "/run/robotether/jump"


def registered(stack):
    return stack.exec("sshd", "ls", "-A", REGISTER, user="jump:jumpwatch").split()


@pytest.fixture(scope="module")
def manager(stack, tmp_path_factory, robot, other):
    """Somebody with ann's rights, which no test changes."""
    folder, levels = tmp_path_factory.mktemp("manager"), {robot: "manage", other: "drive"}
    with Person.added(stack, folder, "jumping-manager", levels) as person:
        yield person


def test_person_reaches_the_robot(manager, robot, stack):
    """Who manages the robot gets to the first line of its sshd, also where only 443 is let out."""
    assert manager.reach(robot.shell_port).stdout.encode() == BANNER.replace(b"\r\n", b"\n")
    target = f"127.0.0.1:{robot.shell_port}"
    done = manager.key.ssh("-W", target, JUMP, port=stack.https_port)
    assert done.stdout.encode() == BANNER.replace(b"\r\n", b"\n")


def test_less_than_manage_reaches_nothing(ann, robot):
    for level in ("observe", "drive"):
        ann.grant(robot, level)
        assert "Permission denied" in ann.reach(robot.shell_port).stderr


def test_person_reaches_runs_and_opens_nothing_else(manager, robot, other):
    """Another robot, any rosbridge and the server's services stay closed; so do commands, files and ports."""
    ros, _ = robot.key.ports()
    targets = ("mysql:3306", "relay:8091", "127.0.0.1:2222", f"localhost:{robot.shell_port}")
    others = (f"127.0.0.1:{other.shell_port}", f"127.0.0.1:{ros}")
    reaches = [("-W", target, JUMP) for target in (*targets, *others)]
    runs_and_opens = [
        (JUMP,),
        (JUMP, "session"),
        ("-tt", JUMP),
        ("-s", JUMP, "sftp"),
        ("-N", "-R", "0.0.0.0:0:127.0.0.1:9", JUMP),
        ("-N", "-R", "/tmp/jump.sock:127.0.0.1:9", JUMP),
    ]
    attempts = reaches + runs_and_opens
    for arguments, done in zip(attempts, manager.key.ssh_each(attempts), strict=True):
        assert (done.returncode != 0, done.stdout) == (True, ""), arguments
        assert "Permission denied" not in done.stderr, arguments
        is_refused = "administratively prohibited" in done.stderr
        assert is_refused or arguments not in reaches, arguments


def test_persons_key_opens_no_tunnel_and_robots_key_no_jump(manager, robot):
    assert "Permission denied" in manager.key.ssh("tunnel@127.0.0.1", "session").stderr
    done = robot.key.ssh("-W", f"127.0.0.1:{robot.shell_port}", JUMP)
    assert "Permission denied" in done.stderr


def test_stranger_with_a_public_key_gets_nothing(ann, robot, stack, tmp_path):
    """Who has only the public half does not get in, leaves nothing behind, and disturbs nobody."""
    stolen = tmp_path / "stolen.pub"
    stolen.write_text(ann.key.public + "\n")
    with ann.connected(robot.shell_port) as running:
        # Connections of tests before stay there for a moment.
        stack.wait("she alone in the register", lambda: len(registered(stack)) == 1, "sshd")
        mine = registered(stack)
        bare = ["ssh", "-F", "none", "-p", str(stack.ssh_port), "-i", str(stolen)]
        options = ["BatchMode=yes", "IdentitiesOnly=yes", "StrictHostKeyChecking=no"]
        options.append(f"UserKnownHostsFile={tmp_path / 'known'}")
        arguments = [part for option in options for part in ("-o", option)]
        for _ in range(3):
            target = f"127.0.0.1:{robot.shell_port}"
            done = run_command(*bare, *arguments, "-W", target, JUMP, limit_s=15)
            assert "Permission denied" in done.stderr
        stack.wait("the register as before", lambda: registered(stack) == mine, "sshd")
        assert lives(running, "still here")


def test_key_that_signs_counts_and_not_one_that_is_shown(ann, bob, robot):
    """A connection that offered another person's key first is judged by the key that got in."""
    shown = bob.key.file.with_name("shown.pub")
    shown.write_text(ann.key.public + "\n")
    target = ("-W", f"127.0.0.1:{robot.shell_port}", JUMP)
    running = bob.key.start("-i", str(shown), *target)
    try:
        assert first_line(running).startswith("SSH-2.0")
        ann.lose_grants()
        assert not ended(running, 3)
        assert lives(running, "still here")
        bob.lose_grants()
        assert ended(running)
    finally:
        end(running)


def test_two_people_with_one_key(ann, bob, robot):
    """The key opens what either may reach, as long as one of them may."""
    bob.stack.sql(
        f"UPDATE user_ssh_keys SET fingerprint = '{ann.key.fingerprint}', public_key = '{ann.key.public}' "
        f"WHERE fingerprint = '{bob.key.fingerprint}'"
    )
    with ann.connected(robot.shell_port) as running:
        ann.lose_grants()
        assert not ended(running, 3)
        bob.lose_grants()
        assert ended(running)
