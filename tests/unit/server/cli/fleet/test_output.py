"""Lines from many robots on one terminal."""

from __future__ import annotations

from io import StringIO
from threading import Lock

from robotether_server.cli.fleet.output import MAX_CAPTURED_LENGTH, MAX_LINE_LENGTH, Captured, Lines


def printed(*pieces: str) -> str:
    to = StringIO()
    lines = Lines("sim1 | ", to, Lock())
    for piece in pieces:
        lines.write(piece)
    lines.close()
    lines.close()
    return to.getvalue()


def test_lines_are_passed_on_whole() -> None:
    """However they were cut on the way; a last one gets its end."""
    assert printed("a", "b\nc\n", "\nd") == "sim1 | ab\nsim1 | c\nsim1 | \nsim1 | d\n"


def test_two_robots_lines_never_mix() -> None:
    """One that is not whole yet waits."""
    to, lock = StringIO(), Lock()
    one, two = Lines("1 ", to, lock), Lines("2 ", to, lock)
    one.write("a")
    two.write("b\n")
    one.write("c\n")
    assert to.getvalue() == "2 b\n1 ac\n"


def test_robot_does_not_steer_the_terminal() -> None:
    """Control characters are shown; tabs, line ends of Windows and all letters pass."""
    text = "\x1b[2Ja\tb\rc\x9b\x07ü\r\n"
    assert printed(text) == "sim1 | \\x1b[2Ja\tb\\x0dc\\x9b\\x07ü\n"


def test_line_without_an_end_is_cut() -> None:
    """Nothing is kept without bound."""
    got = printed("x" * (2 * MAX_LINE_LENGTH + 1)).splitlines()
    assert [len(line) for line in got] == [MAX_LINE_LENGTH + 7, MAX_LINE_LENGTH + 7, 8]


def test_kept_output_has_a_bound() -> None:
    """And says that it was cut."""
    captured = Captured()
    captured.write("x" * MAX_CAPTURED_LENGTH)
    assert not captured.cut
    captured.write("y")
    captured.close()
    assert (len(captured.text), captured.cut) == (MAX_CAPTURED_LENGTH, True)
