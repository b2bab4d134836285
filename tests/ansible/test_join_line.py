"""The install line, run for real on Debian hosts that boot systemd, against the running stack."""

import re

import pytest
from inside import run_inside
from playbooks import invite
from robot_hosts import CA_BUNDLE, ROOT, VIDEO_WHEELHOUSE, WHEELHOUSE

INSTALLER = "/root/join.sh"
# A container's interface is virtual, so the agent would find none by itself.
USUAL = f"--interface eth0 --wheelhouse {WHEELHOUSE}"
# What enrolling makes on a robot, whoever looks for it.
TRACES = (
    "/opt/robotether-agent",
    "/etc/robotether",
    "/var/lib/robotether-agent",
    "/run/robotether-agent",
    "/etc/systemd/system/robotether-agent.service",
    "/etc/systemd/system/multi-user.target.wants/robotether-agent.service",
    "/usr/local/bin/robotether-agent",
)
DIGITS = re.compile(r"[0-9a-f]{64}")


class Robot:
    """A host, with what these tests do on it."""

    def __init__(self, host):
        self.host = host
        # A site whose pip needs a CA bundle of its own says so to all of the machine.
        host.put((ROOT / "agent" / "join.sh").read_bytes(), INSTALLER)
        host.put(f"[global]\ncert = {CA_BUNDLE}\n".encode(), "/etc/pip.conf")

    def install(self, line, options=USUAL):
        # `sh` must get nothing when curl fails, and its end is what counts, as for a person at the prompt.
        wanted = ("bash", "-c", f"{line} {options}")
        done = run_inside(self.host.container, *wanted, merged=True, limit_s=300)
        return done.returncode == 0, done.stdout

    def traces(self):
        look = (
            f"for path in {' '.join(TRACES)}; do [ -e $path ] || [ -L $path ] && echo $path; done"
        )
        return self.host.run(f"{look}; id -un robotether 2>/dev/null || true").split()

    def state(self):
        """All that a second run must leave as it is: files, their times, and the service's start."""
        folders = (
            "/opt/robotether-agent /etc/robotether /var/lib/robotether-agent /etc/systemd/system"
        )
        listed = self.host.run(
            f"find {folders} -not -name __pycache__ -not -name '*.pyc' -printf '%p %m %u %T@ %l\\n'"
        )
        return listed + self.host.run("systemctl show robotether-agent -p ExecMainPID,NRestarts")

    def key(self):
        public = "/var/lib/robotether-agent/id_ed25519.pub"
        return self.host.run(f"ssh-keygen -lf {public}").split()[1]


@pytest.fixture(scope="module")
def machine(hosts):
    """A host on which nothing is installed between the tests."""
    return Robot(hosts.boot("machine"))


@pytest.fixture
def robot(stack, machine):
    """The machine as it was delivered, which the server has never seen."""
    assert machine.traces() == []
    yield machine
    good, said = machine.install("sh -s -- --uninstall --yes < " + INSTALLER, "")
    if row := rows(stack).get(machine.host.mac):
        stack.admin.remove("robots", row["name"])
    assert good, said


def without_token(line):
    return re.sub(r" --token \S+", "", line)


def rows(stack):
    return {row["mac"]: row for row in stack.admin.ask("GET", "/robots")["robots"]}


def online(stack, mac):
    row = rows(stack).get(mac)
    return bool(row and row["online"])


def test_bad_input_leaves_nothing_behind(stack, token, robot):
    """Each wrong line says what is wrong and undoes what it did; the right one, in the next tests, does the work."""
    line = invite(stack, token)["command"]
    port = stack.https_port
    wrong_pin = DIGITS.sub("0" * 64, line)
    bad = [
        # The server alone knows it, after the installation: all of that is undone.
        (re.sub(r"rj_\S+", "rj_" + "A" * 43, line), USUAL, "[token_invalid]"),
        (re.sub(r"--token \S+", "--token x'y", line), USUAL, "unexpected EOF"),
        (wrong_pin, USUAL, "its certificate has the SHA-256"),
        (line, f"{USUAL} --server cloud:1", "cannot get https://cloud:1/agent/manifest"),
        (line, f"{USUAL} --server https://cloud:{port}/", "without https://"),
        (line, f"--wheelhouse {WHEELHOUSE}", "no physical network interface"),
        (line, f"{USUAL} --frobnicate", "there is no such option"),
        (line, f"{USUAL} --token", "its value is missing"),
    ]
    for wrong, options, sentence in bad:
        good, said = robot.install(wrong, options)
        assert not good, f"{options}: {said}"
        assert sentence in said, f"{options}: {said}"
        assert robot.traces() == [], said


# What a host may lack, how it is taken away and given back, and the sentence that it gets.
LACKS = {
    "systemd": (
        "mount -t tmpfs none /run/systemd/system 2>/dev/null; mv /usr/bin/systemctl /root/",
        "mv /root/systemctl /usr/bin/; umount /run/systemd/system",
        "has no systemd",
    ),
    "a newer Python": (
        "printf '#!/bin/sh\\ncase \"$*\" in *version_info*) exit 1 ;; *) echo Python 3.9.2 ;; esac\\n'"
        " > /usr/local/bin/python3; chmod +x /usr/local/bin/python3",
        "rm /usr/local/bin/python3",
        "Python 3.9.2, and 3.10 is needed",
    ),
    "disk space": (
        "mount -t tmpfs -o size=20m none /opt",
        "umount /opt",
        "MB are needed",
    ),
    "a writable disk": ("mount -t tmpfs -o ro none /opt", "umount /opt", "mounted read-only"),
}


def test_lacking_machine_is_left_alone(stack, token, robot):
    line = invite(stack, token)["command"]
    options = "--interface eth0"
    for what, (take, give, sentence) in LACKS.items():
        robot.host.run(take)
        try:
            good, said = robot.install(line, options)
        finally:
            robot.host.run(give)
        assert not good, f"{what}: {said}"
        assert sentence in said, f"{what}: {said}"
        assert robot.traces() == [], f"{what}: {said}"
    good, said = robot.install(line.replace("sudo sh", "sudo -u pi sh"), options)
    assert not good
    assert "run it with sudo" in said
    assert robot.traces() == []


def test_line_makes_a_robot_and_again_changes_nothing(stack, token, robot):
    robot.host.ros_listens_on("0.0.0.0")
    line = invite(stack, token)["command"]
    # Without --wheelhouse: as most robots do, with packages from the index; but PyAV, which is large, from a folder.
    robot.host.run(f"echo 'find-links = {VIDEO_WHEELHOUSE}' >> /etc/pip.conf")
    good, said = robot.install(line, "--interface eth0 --name turtle")
    robot.host.run("sed -i /find-links/d /etc/pip.conf")
    assert good, said
    assert f"done: this robot is turtle, at https://cloud:{stack.https_port}/robots/turtle" in said
    stack.wait("turtle online", lambda: online(stack, robot.host.mac), "relay", "sshd")
    assert not robot.host.succeeds("test -e /etc/robotether/token")
    assert "token" not in robot.host.run("cat /etc/robotether/agent.toml")

    # Everybody in its network drives past the guard: robot, installer and server's page say so.
    exposed = "SELECT ros_exposed FROM robot_sessions ORDER BY id DESC LIMIT 1"
    assert "WARNING: rosbridge answers at " in said
    stack.wait("the server's warning", lambda: stack.sql(exposed) == [["1"]], "relay")
    doctor = robot.host.run("robotether-agent doctor", check=False)
    assert re.search(r"^warning +rosbridge +answers at [0-9.]+: anyone", doctor, re.MULTILINE)
    robot.host.ros_listens_on("127.0.0.1")

    assert "libx264 encodes H.264" in doctor

    before = robot.state()
    good, said = robot.install(line, "--interface eth0 --name turtle")
    assert good, said
    assert "nothing to do" in said
    assert robot.state() == before

    # Every clone of an image of a machine with a key would be that robot.
    good, said = robot.install(line, f"{USUAL} --image")
    assert not good
    assert "which every clone would have" in said

    good, said = robot.install(without_token(line), "--uninstall")
    assert not good
    assert "Add --yes" in said
    assert robot.state() == before
    good, said = robot.install(without_token(line), "--uninstall --yes")
    assert good, said
    assert robot.traces() == []
    stack.wait("turtle offline", lambda: not online(stack, robot.host.mac), "relay")


@pytest.mark.release
def test_missing_packages_are_installed(stack, token, robot):
    robot.host.run("apt-get purge -y -qq python3-venv python3.11-venv")
    good, said = robot.install(invite(stack, token)["command"])
    assert good, said
    assert "python3-venv (they stay" in said
    assert robot.host.succeeds("python3 -c 'import ensurepip, venv'")


@pytest.mark.release
def test_run_on_a_robot_upgrades_and_keeps_what_is_its_own(stack, token, robot):
    """A changed option reaches the settings, what a person wrote there stays, and so do key and name."""
    line = without_token(invite(stack, token)["command"])
    good, said = robot.install(invite(stack, token)["command"], f"{USUAL} --name keeper")
    assert good, said
    key = robot.key()
    robot.host.run("echo 'log_level = \"debug\"' >> /etc/robotether/agent.toml")
    # An older version runs: the same files under another name.
    robot.host.run(
        "cd /opt/robotether-agent/versions && cp -a * 0.0.9-aaaaaaaaaaaa"
        ' && sed -i "s#/versions/0.1[^/]*/#/versions/0.0.9-aaaaaaaaaaaa/#" 0.0.9-aaaaaaaaaaaa/bin/*'
        " && ln -sfn versions/0.0.9-aaaaaaaaaaaa ../current && systemctl restart robotether-agent"
    )
    stack.wait("online", lambda: online(stack, robot.host.mac), "relay")
    good, said = robot.install(line, f"{USUAL} --rosbridge-url ws://127.0.0.1:9099")
    assert good, said
    assert "switching from 0.0.9-aaaaaaaaaaaa to 0.1.0-" in said
    assert "0.0.9" not in robot.host.run("readlink /opt/robotether-agent/current")
    config = robot.host.run("cat /etc/robotether/agent.toml")
    assert 'log_level = "debug"' in config
    assert 'rosbridge_url = "ws://127.0.0.1:9099"' in config
    assert robot.key() == key
    assert rows(stack)[robot.host.mac]["name"] == "keeper"


@pytest.mark.release
def test_clones_of_an_image_are_robots_of_their_own(stack, token, hosts, robot):
    """An image with a fleet token holds no key; each clone makes its own at its first boot and comes up."""
    good, said = robot.install(invite(stack, token, uses=2)["command"], f"{USUAL} --image")
    assert good, said
    assert not robot.host.succeeds("test -e /var/lib/robotether-agent/id_ed25519")
    assert not robot.host.succeeds("systemctl is-active robotether-agent")
    assert robot.host.run("stat -c '%a %U:%G' /etc/robotether/token").split() == [
        "640",
        "root:robotether",
    ]
    image = robot.host.container.commit(repository="robotether-test/golden", tag=str(id(robot)))
    try:
        clones = [hosts.boot(name, image=image.id) for name in ("clone-a", "clone-b")]
        for clone in clones:
            stack.wait("clone online", lambda mac=clone.mac: online(stack, mac), "relay", "sshd")
        public = "cat /var/lib/robotether-agent/id_ed25519.pub"
        assert len({clone.run(public).split()[1] for clone in clones}) == 2
        assert len({rows(stack)[clone.mac]["name"] for clone in clones}) == 2
    finally:
        # Also one that has not booted: it holds the image.
        for clone in [host for host in hosts.booted if host is not robot.host]:
            hosts.remove(clone)
        hosts.engine.images.remove(image.id, force=True)
