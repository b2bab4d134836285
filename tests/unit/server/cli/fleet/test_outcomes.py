"""What the table and --json say."""

from __future__ import annotations

from robotether_server.cli.fleet.outcomes import Outcome, as_dict, as_rows, verdict
from robotether_server.cli.fleet.output import Captured

OUTCOMES = [
    Outcome("sim3", None, 10.04, "cannot reach sim3: no answer within 10 s"),
    Outcome("sim2", 0, 0.26),
    Outcome("sim1", 3, 1),
]


def test_table_has_failures_at_its_end() -> None:
    """Next to the prompt, where a person looks."""
    assert as_rows(OUTCOMES) == [
        ("sim2", "0.3", "ok"),
        ("sim1", "1.0", "exit status 3"),
        ("sim3", "10.0", "cannot reach sim3: no answer within 10 s"),
    ]
    assert verdict(OUTCOMES) == "1 of 3 robots: ok"


def test_json_has_all_of_it() -> None:
    """With outputs where they were kept."""
    out = Captured()
    out.write("hi\n")
    assert as_dict(Outcome("sim1", 0, 0.1234, None, out, Captured())) == {
        "robot": "sim1",
        "ok": True,
        "status": 0,
        "problem": None,
        "seconds": 0.123,
        "stdout": "hi\n",
        "stderr": "",
        "cut": False,
    }
    assert as_dict(OUTCOMES[0])["problem"] == "cannot reach sim3: no answer within 10 s"
