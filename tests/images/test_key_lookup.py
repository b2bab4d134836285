"""Whom the look-up of robots' keys lets in, asked of the program that sshd runs and of the running daemon."""

from base64 import b64encode
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256

import pytest
from inside import run_inside
from jump_people import end
from robot_key import RobotKey, session_line
from stack import database_away

USER = "tunnel@127.0.0.1"
PROGRAM = "/usr/lib/robotether/authorized-keys"
CACHE = "/var/cache/robotether"
CONNECTION = "192.0.2.7 50022 192.0.2.1 2222"
# As long as a fingerprint, and no key's.
HASH = "SHA256:" + "x/+0" * 10 + "abc"


def look_up(stack, *arguments):
    return run_inside(stack.container("sshd"), PROGRAM, *arguments, user="keylookup")


def line_of(key):
    done = look_up(key.stack, "tunnel", key.fingerprint, CONNECTION)
    assert done.returncode == 0
    return done.stdout


def refused(stack, fingerprint):
    return stack.sql(
        "SELECT address FROM audit_events WHERE kind = 'key_refused' "
        f"AND JSON_VALUE(details, '$.fingerprint') = '{fingerprint}'"
    )


@pytest.mark.parametrize("shell", ["FALSE", "TRUE"])
def test_line_lets_the_key_listen_on_its_ports_and_run_its_session(key, stack, shell):
    """The line is this one, byte for byte, with the shell's port while the robot has one."""
    stack.sql(f"UPDATE robots SET shell = {shell} WHERE name = 'thief'")
    columns = "id, ros_port, video_port, IFNULL(shell_port, '')"
    [[number, *with_none]] = stack.sql(f"SELECT {columns} FROM robots WHERE name = 'thief'")
    ports = [port for port in with_none if port]
    assert len(ports) == (3 if shell == "TRUE" else 2)
    listens = ",".join(f'permitlisten="*:{port}"' for port in ports)
    command = f"/usr/lib/robotether/session {number} {key.fingerprint} {','.join(ports)}"
    options = f'restrict,port-forwarding,{listens},command="{command}"'
    assert line_of(key) == f"{options} {' '.join(key.public.split()[:2])}\n"


def test_odd_question_finds_nothing(key, stack):
    """It ends and prints nothing; no statement, no audit line and no file's name is made of it."""
    count = "SELECT COUNT(*) FROM audit_events WHERE kind = 'key_refused'"
    before = stack.sql(count)
    odd = ("", "MD5:00:11", HASH[:-1], HASH + "a", HASH[:-1] + "\n", "SHA256:" + "a" * 100_000)
    quoted = ("' OR '1'='1' -- ".ljust(43, "a"), "../../../etc/passwd".ljust(43, "a"))
    for fingerprint in (*odd, *(f"SHA256:{item}" for item in quoted)):
        done = look_up(stack, "tunnel", fingerprint, CONNECTION)
        assert (done.returncode, done.stdout) == (0, ""), fingerprint[:30]
    for arguments in ((), ("tunnel",), ("tunnel", HASH), ("tunnel", HASH, "", "")):
        assert look_up(stack, *arguments).stdout == "", arguments
    for user in ("jump", "root", ""):
        assert look_up(stack, user, key.fingerprint, CONNECTION).stdout == "", user
    assert stack.sql(count) == before


def test_refused_key_is_recorded_with_an_address_or_none(stack):
    """Nothing but an address reaches the audit."""
    recorded = {
        CONNECTION: "192.0.2.7",
        "2001:db8::7 50022 2001:db8::1 2222": "2001:db8::7",
        "": "NULL",
        "192.0.2.7'); DROP TABLE robots; -- 1 2 3": "NULL",
        "\\ 1 2 3": "NULL",
        "1" * 46 + " 1 2 3": "NULL",
    }
    for connection, address in recorded.items():
        unknown = "SHA256:" + b64encode(sha256(connection.encode()).digest()).decode().rstrip("=")
        done = look_up(stack, "tunnel", unknown, connection)
        assert (done.returncode, done.stdout) == (0, "")
        # Whoever logs in does not wait for the line.
        lines = stack.wait("the line of the key", lambda key=unknown: refused(stack, key))
        assert lines == [[address]]


def test_unknown_key_leaves_one_audit_line(stack, tmp_path):
    stranger = RobotKey(stack, tmp_path, "stranger")
    for _ in range(3):
        assert "Permission denied" in stranger.ssh(USER, "session").stderr
    rows = refused(stack, stranger.fingerprint)
    assert len(rows) == 1
    assert rows[0][0] not in ("", "NULL")


def cached_names(stack):
    return stack.exec("sshd", "find", CACHE, "-type", "f", user="keylookup").split()


def cached(key):
    return file_of(key) in cached_names(key.stack)


def file_of(key):
    """The key's in the cache; a slash would be a folder."""
    return f"{CACHE}/{key.fingerprint.removeprefix('SHA256:').replace('/', '_')}"


def test_disabled_robots_key_is_refused_and_the_cache_follows(stack, key):
    """A key that never came here is in it, as with a robot whose cell dies, and one that is no longer good is not."""
    stack.exec("sshd", "rm", "-f", file_of(key), user="keylookup")
    stack.exec("sshd", PROGRAM, "cache", user="keylookup")
    assert stack.exec("sshd", "cat", file_of(key), user="keylookup") == line_of(key)
    stack.robotether("robot", "disable", "thief")
    try:
        stack.exec("sshd", PROGRAM, "cache", user="keylookup")
        assert not cached(key)
        assert cached_names(stack), "the other robots' keys"
        stack.robotether("robot", "enable", "thief")
        line_of(key)
        assert cached(key)
        stack.robotether("robot", "disable", "thief")
        # It forgets the key with the refusal, too.
        assert "Permission denied" in key.ssh(USER, "session").stderr
        assert not cached(key)
    finally:
        stack.robotether("robot", "enable", "thief")
        # The relay, which reads it a moment later, may lose the database in the next test.
        stack.wait_for_changes("sim1")


def test_database_that_answers_with_an_error_lets_nobody_in(stack, key):
    """Although the key is in the cache: whoever can bring an error about shall not open it."""
    line_of(key)
    stack.sql("ALTER USER 'keylookup'@'%' ACCOUNT LOCK")
    end_database_connections(stack)
    try:
        done = look_up(stack, "tunnel", key.fingerprint, CONNECTION)
        assert "Permission denied" in key.ssh(USER, "session").stderr
    finally:
        stack.sql("ALTER USER 'keylookup'@'%' ACCOUNT UNLOCK")
    # sshd says in its log that it failed.
    assert (done.returncode, done.stdout) == (1, "")


def end_database_connections(stack):
    """Those of the look-ups, as a database does that is restarted."""
    stack.sql("KILL USER 'keylookup'@'%'")


def test_look_up_connects_again_when_the_database_has_ended_the_connection(stack, key):
    known = line_of(key)
    end_database_connections(stack)
    assert line_of(key) == known


def signal_lookups(stack, signal):
    stack.exec("sshd", "pkill", f"-{signal}", "-x", "key-lookups", user="keylookup")


def test_log_in_waits_for_look_ups_that_died(stack, key):
    """They are started again, and no robot hears that its key is refused, nor one whose question they had."""
    known = line_of(key)
    signal_lookups(stack, "STOP")
    with ThreadPoolExecutor() as threads:
        answer = threads.submit(line_of, key)
        asks = ("pgrep", "-x", "authorized-keys")
        sshd = stack.container("sshd")
        stack.wait("somebody asks", lambda: run_inside(sshd, *asks).returncode == 0, "sshd")
        signal_lookups(stack, "KILL")
        assert line_of(key) == answer.result() == known
    assert "key-lookups ended with 137; starting it again" in stack.logs("sshd")


@pytest.mark.release
def test_look_ups_that_hang_let_nobody_in(stack, key):
    """The container is not healthy then, and its check has them started again."""
    signal_lookups(stack, "STOP")
    try:
        done = look_up(stack, "tunnel", key.fingerprint, CONNECTION)
        assert (done.returncode, done.stdout) == (1, "")
        stack.wait(
            "the container is not healthy",
            lambda: run_inside(stack.container("sshd"), "/usr/lib/robotether/healthy").returncode,
            "sshd",
        )
    finally:
        # The check has killed them, if the test has come that far.
        run_inside(stack.container("sshd"), "pkill", "-CONT", "-x", "key-lookups", user="keylookup")
    line_of(key)


def test_known_key_works_while_the_database_is_away(key, stack, tmp_path):
    """With mysql stopped a key that worked within 24 hours still opens its session, and no other one does."""
    known = line_of(key)
    with database_away(stack):
        running = key.start(USER, "session")
        try:
            assert session_line(running)["robot"] == "thief"
        finally:
            end(running)
        assert "Permission denied" in RobotKey(stack, tmp_path, "late").ssh(USER, "session").stderr
        for hours, line in ((23, known), (25, "")):
            touch = ("touch", "--date", f"{hours} hours ago", file_of(key))
            stack.exec("sshd", *touch, user="keylookup")
            assert look_up(stack, "tunnel", key.fingerprint, CONNECTION).stdout == line
    # Half a day old or more: it is written again.
    assert line_of(key) == known
    renewed = stack.exec("sshd", "find", file_of(key), "-mmin", "-5", user="keylookup")
    assert renewed.strip() == file_of(key)
