"""Tables of the commands, and their JSON."""

import json

from admin_records import ADD, claim
from relay_server import cell_settings
from robotether_server.cli import common
from robotether_server.db import cells
from robotether_server.times import utc_now


def test_nothing_steers_the_terminal(capsys):
    """What a stranger gave as a name is spelt out, in tables and records, and makes no line of its own."""
    name = "\x1b[2Jroot\nann\u202e\x9b"
    common.print_table(("WHO", "X"), [(name, "1")])
    common.print_fields([("who", name)])
    out = capsys.readouterr().out
    spelt = r"\x1b[2Jroot\nann\u202e\x9b"
    assert out == f"{'WHO'.ljust(len(spelt))}  X\n{spelt}  1\nwho  {spelt}\n"


def test_each_list_is_a_table_and_json(run, database, relay_database, tmp_path):
    run(*ADD)
    run("user", "add", "ann")
    for words in (
        ("group", "add", "crew"),
        ("site", "add", "lab"),
        ("grant", "ann", "sim1", "drive"),
        ("token", "create", "--user", "ann", "--name", "ci"),
    ):
        assert run(*words).status == 0
    claim(database)
    with relay_database.transaction() as tx:
        cells.write_heartbeat(tx, cell_settings("a"), cells.CellCounts(), utc_now())
    for words in (
        "audit",
        "cell list",
        "grant list",
        "group list",
        "robot list",
        "robot pending",
        "site list",
        "token list",
        "user list",
    ):
        heads, row, *_ = run(*words.split()).out.splitlines()
        assert heads.isupper(), words
        first = json.loads(run(*words.split(), "--json").out)[0]
        names = [value for value in first.values() if isinstance(value, str) and value.isalnum()]
        assert any(name in row.split() for name in names), words
