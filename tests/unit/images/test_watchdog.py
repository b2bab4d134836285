"""The watchdog around the health checks of compose's services, with a first process and a service of its own."""

import re
from pathlib import Path

import pytest
import yaml
from commands import run_command

WATCHDOG = Path(__file__).resolve().parents[3] / "compose" / "watchdog"
# The first process is a shell, the service a program that is stopped: who waits for it sees its end.
SERVICE = """
sleep 1000 &
kill -STOP $!
for check in "$@"; do sh "$0" $check; done
if grep -q '^State:.T' /proc/$!/status 2>/dev/null; then echo "there to the end"; fi
kill -KILL $! 2>/dev/null
wait $!
"""


def service_after(folder, *checks):
    """Run the watchdog with these commands, one after the other, beside a service; return what was printed."""
    watchdog = folder / "watchdog"
    watchdog.write_text(WATCHDOG.read_text().replace("/dev/shm", str(folder)))
    command = ["unshare", "--pid", "--fork", "--mount-proc", "sh", "-c", SERVICE]
    return run_command(*command, watchdog, *checks).stdout


@pytest.mark.daemon
@pytest.mark.parametrize(
    ("checks", "printed"),
    [
        (("true", "false", "false", "false"), "killing the service"),
        (("false", "false", "false", "false"), "there to the end\n"),
        (("true", "false", "false", "true", "false", "false"), "there to the end\n"),
        (("true", "false", "false", "sleep 4.5", "false", "false"), "there to the end\n"),
    ],
    ids=["hangs", "never-healthy-yet", "not-in-a-row", "slow"],
)
def test_a_service_is_killed_by_the_third_failure_in_a_row(tmp_path, checks, printed):
    """The first start takes as long as it does; a busy machine fails a check now and then, and is slow."""
    said = service_after(tmp_path, *checks)
    assert printed in said
    assert ("there to the end" in said) != ("killing" in said)


SERVICES = yaml.safe_load((WATCHDOG.parent / "compose.yaml").read_text())["services"]
# Those that are there for ever, except simulated robots, which nobody depends on.
LASTING = sorted(
    name
    for name, service in SERVICES.items()
    if service["restart"] != "no" and not name.startswith("sim")
)


@pytest.mark.parametrize("name", LASTING)
def test_service_is_watched_and_docker_waits_longer(name):
    """A check that Docker ends by itself is not counted."""
    [limit_s] = re.findall(r"TIME_LIMIT_S=(\d+)", WATCHDOG.read_text())
    check = SERVICES[name]["healthcheck"]
    assert "/usr/lib/robotether/watchdog" in " ".join(check["test"])
    assert int(check["timeout"].rstrip("s")) > int(limit_s)
