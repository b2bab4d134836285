"""Tables of the commands."""

from robotether_server.cli import common


def test_nothing_steers_the_terminal(capsys):
    """What a stranger gave as a name is spelt out, in tables and records, and makes no line of its own."""
    name = "\x1b[2Jroot\nann\u202e\x9b"
    common.print_table(("WHO", "X"), [(name, "1")])
    common.print_fields([("who", name)])
    out = capsys.readouterr().out
    spelt = r"\x1b[2Jroot\nann\u202e\x9b"
    assert out == f"{'WHO'.ljust(len(spelt))}  X\n{spelt}  1\nwho  {spelt}\n"
