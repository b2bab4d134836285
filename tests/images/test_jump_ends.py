"""What ends connections of the account `jump`: a right, a port or a robot that is gone, and the watch that sees it."""

from contextlib import ExitStack

import pytest
from jump_people import JUMP, Person, ShellRobot, ended, lives
from robot_key import first_line
from stack import database_away


def take_grant(ann, robot):
    ann.lose_grants()


def remove_key(ann, robot):
    ann.stack.sql(f"DELETE FROM user_ssh_keys WHERE fingerprint = '{ann.key.fingerprint}'")


# The watch asks for what logs people in; tests/unit/sql has all that ends a right.
REVOKED = (take_grant, remove_key)


@pytest.fixture
def losers(stack, tmp_path, robot):
    """Managers of the robot, one for each way to lose the right."""
    with ExitStack() as added:
        yield [
            added.enter_context(
                Person.added(stack, tmp_path, f"jumping-{revoke.__name__}", {robot: "manage"})
            )
            for revoke in REVOKED
        ]


def test_connection_ends_with_its_persons_right(losers, bob, robot):
    with bob.connected(robot.shell_port) as his, ExitStack() as connections:
        theirs = [
            connections.enter_context(person.connected(robot.shell_port)) for person in losers
        ]
        for revoke, person in zip(REVOKED, losers, strict=True):
            revoke(person, robot)
        for revoke, connection in zip(REVOKED, theirs, strict=True):
            assert ended(connection), revoke.__name__
        assert lives(his, "still here")
    for person in losers:
        assert "Permission denied" in person.reach(robot.shell_port).stderr


PORT_CHANGES = ("UPDATE robots SET shell = FALSE", "DELETE FROM robots")


def test_connection_ends_with_its_robots_port(ann, robot, stack, tmp_path):
    with ExitStack() as added:
        for number, change in enumerate(PORT_CHANGES):
            name, mac = f"extra{number}", f"00:00:5e:00:53:{number + 0xC0:02x}"
            extra = added.enter_context(ShellRobot.added(stack, tmp_path, name, mac))
            ann.grant(extra, "manage")
            with ann.connected(robot.shell_port) as running:
                stack.sql(f"{change} WHERE name = '{name}'")
                assert ended(running), change
        assert ann.reach(robot.shell_port).stdout != ""


@pytest.mark.release
def test_person_has_32_connections_at_most(ann, bob, robot):
    """One person cannot fill the container; more connections than that end, and other people's do not."""
    target = ("-W", f"127.0.0.1:{robot.shell_port}", JUMP)
    many = []
    try:
        with bob.connected(robot.shell_port) as his:
            for number in range(34):
                many.append(ann.key.start(*target))
                # Of those beyond 32, whichever ends may not have said a word.
                if number < 32:
                    first_line(many[-1])
            ann.stack.wait(
                "two of 34 ended",
                lambda: sum(each.poll() is not None for each in many) == 2,
                "sshd",
            )
            assert lives(his, "still here")
    finally:
        for each in many:
            each.kill()
            each.communicate()


@pytest.mark.release
def test_watch_that_hangs_is_replaced(ann, robot, stack):
    """The health check ends it, as without a watch nobody new gets in; who is in stays, watched by the next one."""
    restarted = "jump-watch ended with 137; starting it again"
    with ann.connected(robot.shell_port) as running:
        before = stack.logs("sshd", lines=10_000).count(restarted)
        _signal_watch(stack, "STOP")
        stack.wait(
            "another watch has begun",
            lambda: stack.logs("sshd", lines=10_000).count(restarted) > before,
            "sshd",
            seconds=60,
        )
        assert lives(running, "still here")
        stack.wait("she gets in again", lambda: ann.reach(robot.shell_port).stdout, "sshd")
        take_grant(ann, robot)
        assert ended(running)


def test_watch_that_dies_comes_back(ann, robot, stack):
    """It is started again, and knows the connections that were there before."""
    with ann.connected(robot.shell_port) as running:
        _signal_watch(stack, "KILL")
        take_grant(ann, robot)
        assert ended(running)
    assert "jump-watch ended with 137; starting it again" in stack.logs("sshd")


def _signal_watch(stack, signal):
    stack.exec(
        "sshd",
        "pkill",
        f"-{signal}",
        "-f",
        "^/bin/bash /usr/lib/robotether/jump-watch",
        user="jump",
    )


def test_watch_has_no_rights_beyond_its_account(stack):
    """It runs without a capability, as an account that may signal its own processes only."""
    find = "pgrep -f '^/bin/bash /usr/lib/robotether/jump-watch' | head -1"
    status = stack.exec("sshd", "bash", "-c", f"cat /proc/$({find})/status")
    rows = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
    assert rows["Uid"].split() == ["10024"] * 4
    assert rows["Gid"].split() == ["10025"] * 4
    assert rows["Groups"].strip() == ""
    assert int(rows["CapEff"], 16) == int(rows["CapPrm"], 16) == int(rows["CapAmb"], 16) == 0


def test_database_away_leaves_connections_alone_and_lets_nobody_new_in(ann, robot, stack):
    """No cache knows people's keys; who is in stays, and what changed meanwhile counts once the database is back."""
    port = robot.shell_port
    with ann.connected(port) as running:
        with database_away(stack):
            assert "Permission denied" in ann.reach(port).stderr
            assert not ended(running, 3)
            assert lives(running, "still here")
        stack.wait("she gets in again", lambda: ann.reach(port).stdout, "sshd")
        take_grant(ann, robot)
        assert ended(running)
