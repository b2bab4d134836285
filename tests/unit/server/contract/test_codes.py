"""Each code that something ends or is refused with has its sentences, on pages and in the scripts."""

import inspect
import re
from pathlib import Path
from typing import get_args

import robotether_server
from robotether_agent.enrolment.join import ADVICE, PENDING_ADVICE
from robotether_common.guard import REFUSED_KINDS
from robotether_common.session import ByeCode
from robotether_server import problems
from robotether_server.api.description import PROBLEMS
from robotether_server.contract.codes import CLOSE_CODES, DRIVE_ENDS, REFUSALS, SESSION_ENDS
from robotether_server.relay.channels.rosbridge.message_validator import Kind
from robotether_server.relay.http import close_reasons
from robotether_server.relay.robots.drive_log import GUARD

ROOT = Path(__file__).resolve().parents[4]
SCRIPTS = Path(robotether_server.__file__).parents[1] / "frontend" / "src"
# What is written of drives and sessions that a relay left open.
BY_OTHERS = {"relay_restarted", "cell_removed"}


def test_every_refusal_has_words():
    assert set(REFUSALS) == {*get_args(Kind), *(GUARD + kind for kind in REFUSED_KINDS)}


def test_every_close_reason_has_its_code():
    written = re.findall(r'CloseReason\(\s*"([a-z_]+)"', inspect.getsource(close_reasons))
    assert set(written) == set(CLOSE_CODES)


def test_every_ending_of_a_session_has_words():
    assert set(SESSION_ENDS) == set(get_args(ByeCode)) | BY_OTHERS


def test_scripts_have_words_of_their_own_for_known_ends_alone():
    source = (SCRIPTS / "texts" / "panels.js").read_text()
    inside = source.split("export const endReasons = {", 1)[1].split("\n};", 1)[0]
    own = set(re.findall(r"^  (\w+):", inside, re.MULTILINE))
    assert own
    assert own <= set(DRIVE_ENDS)


def test_scripts_close_codes_are_those_of_the_relay():
    """Each number is one that the relay closes with, and what it stands for has the code's name."""
    source = (SCRIPTS / "client" / "connection.js").read_text()
    numbers = {name: code.number for name, code in CLOSE_CODES.items()}
    lost = re.findall(r'(\d{4}): lostControl\("(\w+)"\)', source)
    assert lost
    assert [(number, name) for number, name in lost if numbers[name] != int(number)] == []
    known = {int(number) for number in re.findall(r"^ +(\d{4}): ", source, re.MULTILINE)}
    assert known <= set(numbers.values())
    constants = {
        "GIVE_UP": "control_given_up",
        "TOO_BIG": "message_too_big",
        "RIGHTS_ENDED": "rights_ended",
    }
    for constant, name in constants.items():
        assert f"export const {constant} = {numbers[name]};" in source


def problem_codes():
    """The codes of the server's problems and of what ends requests, and those that nginx answers by itself."""
    classes = (kind for _, kind in inspect.getmembers(problems, inspect.isclass))
    of_nginx = re.findall(r'"code": "(\w+)"', (ROOT / "images/nginx/nginx.conf").read_text())
    assert of_nginx
    return {
        *of_nginx,
        *CLOSE_CODES,
        *(kind.code for kind in classes if issubclass(kind, problems.RobotetherError)),
        *(problems.HttpError(status, "").code for status in PROBLEMS),
    }


def test_described_codes_are_those_of_problems():
    """The API's description names no code that nothing answers."""
    described = " ".join(description for _, description in PROBLEMS.values())
    named = set(re.findall(r"\b[a-z]+(?:_[a-z]+)+\b", described))
    assert "grant_missing" in named
    assert named <= problem_codes()


def test_codes_that_clients_know_are_those_of_problems():
    scripts = "".join(path.read_text() for path in SCRIPTS.rglob("*.js"))
    compared = {code for code in re.findall(r'\bcode === "(\w+)"', scripts) if "_" in code}
    assert compared
    assert compared | ADVICE.keys() | PENDING_ADVICE.keys() <= problem_codes()
