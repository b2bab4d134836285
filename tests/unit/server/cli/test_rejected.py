"""robotether rejected."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from admin_records import ADD, kinds, show_key
from robotether_server.db import Database

Run = Callable[..., Any]


def test_rejected_key_may_ask_again(run: Run, database: Database) -> None:
    """It is listed with who turned it away, until it is forgiven."""
    run(*ADD)
    show_key(database)
    run("robot", "reject", "sim1", "--fingerprint", "SHA256:abc")
    [one] = json.loads(run("rejected", "list", "--json").out)
    assert (one["robot"], one["fingerprint"], one["rejected_by"]) == ("sim1", "SHA256:abc", "cli")
    row = run("rejected", "list").out.splitlines()[1].split()
    assert (row[0], row[-1]) == (str(one["id"]), "SHA256:abc")
    assert run("rejected", "forgive", one["id"]).out == "key SHA256:abc may ask again\n"
    assert json.loads(run("rejected", "list", "--json").out) == []
    assert kinds(database)[-1] == "key_forgiven"
