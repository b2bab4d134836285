"""robotether fleet, as it is typed, on real sshds: output, status, time-outs, and the end with the connection."""

import json
import signal
from io import StringIO
from threading import Lock, Thread, main_thread

import pytest
from commands import write_programs
from openssh_server import is_alive, wait_until
from robotether_server.cli import fleet, fleet_ssh
from robotether_server.cli.fleet import (
    MAX_CAPTURED_LENGTH,
    MAX_LINE_LENGTH,
    Captured,
    Lines,
)
from robotether_server.cli.fleet_ssh import FleetError, SshConnections


def test_run_prints_lines_and_a_table(run_fleet, network):
    """An offline robot is a row with a sentence, as is a pattern without a robot; neither is a traceback."""
    listed = run_fleet("list", "--on", "sim*", "--ssh-config", network.config)
    assert listed.out.split()[:4] == ["ROBOT", "USER", "PORT", "THROUGH"]
    assert [line.split()[0] for line in listed.out.splitlines()[1:]] == ["sim1", "sim2"]
    done = run_fleet("run", "echo hi", "--on", "sim1", "--on", "*", "--ssh-config", network.config)
    assert (done.status, sorted(done.out.splitlines())) == (0, ["sim1 | hi", "sim2 | hi"])
    rows = [line.split()[0::2] for line in done.err.splitlines()[2:4]]
    assert rows == [["sim1", "ok"], ["sim2", "ok"]]
    assert done.err.endswith("2 of 2 robots: ok\n")

    network.robots["sim2"].stop()
    done = run_fleet("run", "true", "--on", "*", "--ssh-config", network.config)
    assert done.status == 1
    assert "cannot reach sim2: it is offline" in done.err
    assert done.err.endswith("1 of 2 robots: ok\n")
    assert "Traceback" not in done.err
    done = run_fleet("run", "true", "--on", "elsewhere", "--ssh-config", network.config)
    assert (done.status, done.out, done.err.count("\n")) == (1, "", 1)
    assert "cannot find robots for elsewhere" in done.err


def test_ctrl_c_ends_the_command_everywhere(run_fleet, network):
    """A robot that was to follow never starts."""
    pids = network.folder / "pids"
    command = f"sleep 60 & echo $! >> {pids}; wait"
    network.robots["sim3"] = network.robots["sim2"]
    network.write_config()

    def written():
        return [int(word) for word in pids.read_text().split()] if pids.exists() else []

    def press():
        wait_until(lambda: len(written()) == 2, lambda: "both robots run it")
        # As from a terminal: a signal ends the wait of the main thread.
        signal.pthread_kill(main_thread().ident or 0, signal.SIGINT)

    presser = Thread(target=press)
    # Whoever starts the tests in the background hands an ignored Ctrl-C down to them.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        presser.start()
        more = ("--parallel", "2", "--ssh-config", network.config, "--json")
        done = run_fleet("run", command, "--on", "sim*", *more)
        presser.join()
    finally:
        signal.signal(signal.SIGINT, before)
    assert done.status == 130
    outcomes = [(item["robot"], item["status"], item["problem"]) for item in json.loads(done.out)]
    assert outcomes == [(f"sim{number}", None, "interrupted") for number in (1, 2, 3)]
    assert len(written()) == 2
    wait_until(lambda: not any(map(is_alive, written())), lambda: "the commands have ended")


@pytest.fixture
def connection(network):
    connections = SshConnections(accept_new=False)
    yield connections.open(fleet_ssh.resolve("sim1", network.config))
    connections.close_all()


@pytest.fixture
def do(connection):
    def run(command, *, timeout_s=20, **how):
        out, err = Captured(), Captured()
        sent = fleet.on_lifeline(command)
        status = fleet.run_on(connection, sent, out=out, err=err, timeout_s=timeout_s, **how)
        return status, out.text, err.text

    return run


def test_command_runs_as_it_was_typed(do):
    for command, status, out, err in (
        ("echo hi", 0, "hi\n", ""),
        ("echo oops >&2; exit 7", 7, "", "oops\n"),
        ("kill -9 $$", 137, "", None),
        ("""printf '%s\n' "it's" '$HOME' \\"x\\" ü""", 0, 'it\'s\n$HOME\n"x"\nü\n', ""),
        ("cat; echo ended", 0, "ended\n", ""),
        ("true\nfalse", 1, "", ""),
        ("printf '\\377'", 0, "\N{REPLACEMENT CHARACTER}", ""),
        ("head -c 1000000 /dev/zero | tr '\\0' x", 0, "x" * 1000000, ""),
    ):
        got = do(command)
        assert got[:2] == (status, out), command
        assert err is None or got[2] == err


def test_lost_link_is_no_exit_status(do, network, tmp_path):
    stop = f"kill -9 $(ps -o ppid= -p $PPID) & sleep 20 & echo > {tmp_path}/pid; wait"
    with pytest.raises(FleetError, match="the connection broke"):
        do(stop)


def test_sudo_gets_its_password_and_the_command_does_not(connection, network):
    """The password is the first line of standard input, of which the command sees nothing, asked for or not."""
    # It notes its arguments, and reads a password where it is told to.
    sudo = (
        'echo "sudo $1" >&2\n[ "$1" != -S ] || { read -r pw; echo "got $pw" >&2; shift 2; }\n'
        'shift 2\nexec "$@"'
    )
    folder = network.folder / "bin"
    write_programs(folder, {"sudo": sudo})
    for option, said in (("-S", "sudo -S\ngot secret\n"), ("-n", "sudo -n\n")):
        out, err = Captured(), Captured()
        command = fleet.on_lifeline("cat; exit 5", sudo=True, password=option == "-S")
        status = fleet.run_on(
            connection,
            f"PATH={folder}:$PATH {command}",
            out=out,
            err=err,
            timeout_s=20,
            password="secret",
        )
        assert (status, out.text, err.text) == (5, "", said)


@pytest.mark.parametrize(
    ("pieces", "lines"),
    [
        (("a", "b\nc\n", "\nd"), ["ab", "c", "", "d"]),
        # Tabs, line ends of Windows and all letters pass; a robot does not steer the terminal.
        (("\x1b[2Ja\tb\rc\x9b\x07ü\r\n",), ["\\x1b[2Ja\tb\\x0dc\\x9b\\x07ü"]),
        (("x" * (2 * MAX_LINE_LENGTH + 1),), ["x" * MAX_LINE_LENGTH, "x" * MAX_LINE_LENGTH, "x"]),
    ],
    ids=["whole", "escaped", "cut"],
)
def test_lines_are_passed_on_whole(pieces, lines):
    to = StringIO()
    passed = Lines("sim1 | ", to, Lock())
    for piece in pieces:
        passed.write(piece)
    passed.close()
    assert to.getvalue() == "".join(f"sim1 | {line}\n" for line in lines)


def test_kept_output_has_a_bound():
    captured = Captured()
    captured.write("x" * MAX_CAPTURED_LENGTH)
    assert not captured.cut
    captured.write("y")
    captured.close()
    assert (len(captured.text), captured.cut) == (MAX_CAPTURED_LENGTH, True)
