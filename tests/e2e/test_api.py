"""The whole API of the running server against its own description: schemathesis makes the requests.

It sends what the description allows and what it does not, and follows what one answer gives to the next request.
Every answer must be described, and no request may end in a mistake of the server.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from stack import ROOT, Stack

SCHEMATHESIS = Path(sys.executable).with_name("schemathesis")
EXAMPLES = 5
LONGEST_RUN_S = 900
# What is printable, and what is a key, no schema can say: random texts are refused although they fit it. And nginx
# refuses TRACE by itself, without the header Allow; tests/unit/transcripts has others.
NOT_CHECKED = "positive_data_acceptance,unsupported_method"
# What runs without robots and without Prometheus says so: 503.
SETTINGS = """[checks.not_a_server_error]
expected-statuses = ["2xx", "3xx", "4xx", "503"]
"""
# The relay's: events never end, and a stop is of robots that other tests drive; tests/unit/server/relay has them.
OF_THE_RELAY = r"/api/v1/(events|stop)$|/(control|lease|release|stop)$|/(topics|services)/"
# Other tests' pages would say that they are recorded.
RECORDS = r"/robots/\{robot\}/recordings$"


@dataclass
class Api:
    """An admin's program, and what was there before it."""

    stack: Stack
    token: str

    def ask(self, method, path):
        headers = {"Authorization": f"Bearer {self.token}"}
        status, answer = self.stack.request(method, f"/api/v1{path}", headers=headers)
        assert status in {200, 204}, answer
        return answer

    def names(self, path, key, member="name"):
        return {str(item[member]) for item in self.ask("GET", path)[key]}

    def records(self):
        """Everything that a request could name, by the name of its place in paths."""
        return {
            "robot": self.names("/robots", "robots"),
            "user": self.names("/users", "users"),
            "token_id": self.names("/tokens", "tokens", "id"),
            "key_id": self.names("/rejected-keys", "rejected_keys", "id"),
            "group": self.names("/groups", "groups"),
            "site": self.names("/sites", "sites"),
            "grant_id": self.names("/grants", "grants", "id"),
        }


@pytest.fixture
def api(stack):
    """Afterwards there is what was there before, and nothing else."""
    api = Api(stack, stack.token("schemathesis"))
    before = api.records()
    yield api
    lists = {"robot": "robots", "user": "users", "group": "groups", "site": "sites"}
    lists |= {"key_id": "rejected-keys", "token_id": "tokens", "grant_id": "grants"}
    for kind, path in lists.items():
        for name in api.records()[kind] - before[kind]:
            api.ask("DELETE", f"/{path}/{name}")
    for join_token in api.ask("GET", "/join-tokens")["join_tokens"]:
        api.ask("DELETE", f"/join-tokens/{join_token['id']}")
    assert api.records() == before


@pytest.mark.release
def test_api_keeps_to_its_description(api, tmp_path):
    """Whatever is sent: described answers, problems in JSON, refusals of what is not allowed, and never a 500."""
    protected = {kind: sorted(names) for kind, names in api.records().items()}
    command = [str(SCHEMATHESIS), "run", f"{api.stack.url}/api/v1/openapi.json"]
    command += ["--header", f"Authorization: Bearer {api.token}", "--tls-verify", "false"]
    command += ["--exclude-path-regex", f"{OF_THE_RELAY}|{RECORDS}"]
    command += ["--exclude-checks", NOT_CHECKED]
    command += ["--max-examples", str(EXAMPLES), "--seed", "1", "--no-color"]
    command += ["--generation-database", "none", "--warnings", "off"]
    (tmp_path / "schemathesis.toml").write_text(SETTINGS)
    hooks = {
        "SCHEMATHESIS_HOOKS": "schemathesis_hooks",
        "PYTHONPATH": str(ROOT / "tests" / "support" / "stack"),
        "PROTECTED": json.dumps(protected),
    }
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=os.environ | hooks,
        timeout=LONGEST_RUN_S,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}\n{api.stack.logs('web')}"
    assert "No issues found" in done.stdout, done.stdout
