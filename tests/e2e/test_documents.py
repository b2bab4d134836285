"""The documents' commands do what a reader wants."""

import re
import shlex
import subprocess

import documented
import pytest

# Why a command is not run here, and how such commands begin. Where another test runs it, the reason names that one.
NOT_RUN = {
    "prepares the reader's own shell, folder or checkout": (
        r"(cd|cp|mv|mkdir|rm|cat|scp|gzip|zcat|git|export|alias|set|\.|for) |\w+=\S+$"
    ),
    "is how CI runs, or starts and ends the stack that all tests share": (
        r"make |\.venv/|npm |node |tools/(lint|lock|build|up)\b|tools/compose (down|stop|up|--profile)"
    ),
    "starts a stack from nothing: tests/images/test_plain_compose.py": (
        r"(COMPOSE_PROFILES=\S+ )?docker compose up"
    ),
    "builds, copies or starts an image by itself: tests/ansible/test_server.py": (
        r"docker (build|run|save) "
    ),
    "changes a robot's machine: tests/ansible, on hosts that boot systemd": (
        r"(sudo|sh|useradd|python3|\$version\S+|ln|install|systemctl|systemd-run|PYTHONPATH=WHEEL) "
    ),
    "is a playbook, or what one needs: tests/ansible": (
        r"ansible(-\w+)? |tools/build_(collection|agent_(deb|wheel))\b|(\.\./)?tools/agent_wheelhouse"
    ),
    "needs ROS, or a robot that runs it: by hand": r"ros2? |roslaunch |colcon |SERVER=",
    "is for a player with a screen: tests/e2e/test_h264.py": r"(ticket=\$\(|jq |ffplay |mpv |vlc )",
    "needs a swarm: tests/images/test_swarm.py": (
        r"docker (node|stack|exec) |(CELL=\w PUBLIC_HOST=\S+ +)docker stack "
    ),
    "needs a Kubernetes cluster: tests/unit/deploy/test_kubernetes.py reads what is applied": (
        r"kubectl "
    ),
    "needs a second cell: tests/e2e/test_cells.py": (r"robotether cell (drain|resume|remove) [^c]"),
    "makes the secrets of other machines: tests/images/test_secrets.py": r"tools/site_secrets ",
    "needs a second database: tests/images/test_standby.py": r"tools/standby ",
    "needs a person's SSH key on a robot: tests/ansible/test_shell.py": (
        r"ssh turtle|robotether (ssh-config|fleet run ')"
    ),
    "stops a robot of all tests, with a token: tests/unit/server/cli/test_robots.py": (
        r"robotether stop "
    ),
    "needs a robot that waits for an admin: tests/ansible/test_join_line.py": (
        r"robotether robot approve "
    ),
    "backs the whole stack up, or replaces it: tests/images/test_plain_compose.py": (
        r"tools/(backup|restore) "
    ),
    "needs a timer of systemd: tests/ansible/test_server.py": r"journalctl ",
    "needs the profile metrics: tests/images/test_prometheus.py": r"docker compose exec (prometheus|alertmanager) ",
    "starts what lasts, with a token: tests/e2e/test_recordings.py and test_routes.py": (
        r"curl .*/api/v1/(robots/sim1/recordings|recordings/12/stop|routes)$"
    ),
    "needs a recording, and PyAV: tests/e2e/test_recordings.py": r"robotether recording export ",
    "is a script of the reader's own": r"#!/|age |trap ",
}
MAC = "b8:27:eb:12:34:56"
PIN = re.compile(r"sha256//\S+")
IN_WEB = re.compile(r"^(docker |tools/)compose exec web (?=robotether )")


@pytest.fixture
def readers_world(stack):
    """Have the reader's robot there, and another one to remove; leave nothing of what the reader makes."""
    if "ann" in stack.admin.users():  # of a test before
        stack.admin.remove("users", "ann")
    stack.robotether("robot", "add", "turtle", "--mac", MAC)
    stack.robotether("robot", "add", "spare", "--mac", f"{MAC[:-2]}57")
    yield
    for robot in ("turtle", "added", "inserted"):
        stack.robotether("robot", "remove", robot, "--yes")
    stack.robotether("user", "remove", "ann", "--yes")


def with_readers_values(command, host, pin, folder):
    """Put in what the document leaves to its reader; the stack has no PUBLIC_HOST, and nobody to ask."""
    for placeholder, value in {
        f"robot add turtle --mac {MAC}": f"robot add added --mac {MAC[:-2]}58",
        f"'{MAC}', 'turtle'": f"'{MAC[:-2]}59', 'inserted'",
        "robot remove NAME": "robot remove spare --yes",
        "NAME": "turtle",
        "robot invite": "robot invite --host localhost",
        "sha256//...": pin,
        "https://HOST": f"https://{host}",
    }.items():
        command = command.replace(placeholder, value)
    return command


def run_for_reader(stack, command, folder):
    """Run a command where its reader does: on the server, in its containers, on a robot, or anywhere."""
    command = re.sub(r"^(docker |tools/)compose ", "compose ", command)
    match shlex.split(command):
        case ["robotether", *words]:
            stack.robotether(*words)
        case ["robotether-agent", *words]:
            stack.exec("sim1", "robotether-agent", *words)
        case ["compose", "exec", service, *words]:
            stack.exec(service, *words)
        case ["compose", *words]:
            stack.compose(*words)
        case ["curl", *words]:
            subprocess.run(["curl", *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        case _:
            raise AssertionError("is neither run nor in NOT_RUN")


@pytest.mark.usefixtures("readers_world")
def test_commands_of_the_documents_run(stack, tmp_path):
    """Every command ends without an error, in the order of the pages, or NOT_RUN lists it; NOT_RUN lists no other."""
    pin = PIN.search(stack.robotether("robot", "invite", "--host", f"localhost:{stack.https_port}"))
    host = stack.url.removeprefix("https://")
    failed, skipped = [], set()
    commands = [command for page in documented.pages() for command in documented.commands(page)]
    for command in dict.fromkeys(IN_WEB.sub("", command) for command in commands):
        if reasons := {why for why, begins in NOT_RUN.items() if re.match(begins, command)}:
            skipped |= reasons
            continue
        try:
            run_for_reader(stack, with_readers_values(command, host, pin[0], tmp_path), tmp_path)
        except (AssertionError, subprocess.SubprocessError) as error:
            failed.append(f"{command}: {error}")
    assert not failed, "\n".join(failed)
    assert skipped == {*NOT_RUN}
