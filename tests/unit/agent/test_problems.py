"""The exception tree, its codes, and what the boot service makes of its exit codes."""

from __future__ import annotations

import re
from pathlib import Path

from robotether_agent import problems
from robotether_agent.problems import AgentError, ServerKeyChangedError, SettingsInvalidError

UNIT = Path(__file__).parents[3] / "agent/systemd/robotether-agent.service"


PROBLEMS = [
    member
    for member in vars(problems).values()
    if isinstance(member, type) and issubclass(member, AgentError)
]


def test_the_drawn_tree_is_the_real_one():
    drawn = set(re.findall(r"[A-Z]\w+[A-Z]\w+", problems.__doc__ or ""))
    assert drawn == {problem.__name__ for problem in PROBLEMS}


def test_systemd_does_not_restart_what_a_person_must_look_at():
    line = re.search(r"^RestartPreventExitStatus=(.*)$", UNIT.read_text(), re.MULTILINE)
    assert line is not None
    codes = {int(code) for code in line[1].split()}
    assert codes == {ServerKeyChangedError.exit_code, SettingsInvalidError.exit_code}
