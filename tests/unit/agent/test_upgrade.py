"""A version's folder is made, takes the other's place or gives it back, and tells how it ended."""

import hashlib
import json
import shutil
import subprocess
import time
import venv
from dataclasses import asdict
from pathlib import Path
from zipfile import ZipFile

import pytest
from robotether_agent import systemd, upgrade
from robotether_agent.files import only_one, write_atomic
from robotether_agent.install import find_pip, install
from robotether_agent.install_video import LOCK, install_video
from robotether_agent.problems import AlreadyRunningError, StateUnusableError, UpgradeFailedError
from robotether_agent.status import FILE, Status, read_status
from robotether_agent.upgrade import (
    COMMAND,
    NEW_UNIT,
    PENDING_NAME,
    Layout,
    PendingUpgrade,
    Upgrade,
)


def make_wheel(folder, name, requires="", modules=()):
    path = folder / f"{name}-1.0-py3-none-any.whl"
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"
    if requires:
        metadata += f"Requires-Dist: {requires}\n"
    with ZipFile(path, "w") as archive:
        for module in modules or (f"{name}.py",):
            archive.writestr(module, "")
        archive.writestr(f"{name}-1.0.dist-info/METADATA", metadata)
        archive.writestr(
            f"{name}-1.0.dist-info/WHEEL",
            "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        )
        archive.writestr(f"{name}-1.0.dist-info/RECORD", "")
    return path


@pytest.fixture
def packages(tmp_path):
    make_wheel(tmp_path, "turtle", requires="shell")
    sha256 = hashlib.sha256(make_wheel(tmp_path, "shell").read_bytes()).hexdigest()
    (tmp_path / "requirements.txt").write_text(f"shell==1.0 --hash=sha256:{sha256}\n")
    return tmp_path


def install_from(packages, folder):
    wheel = packages / "turtle-1.0-py3-none-any.whl"
    options = ("--no-index", "--find-links", str(packages))
    return install(folder, wheel, packages / "requirements.txt", options)


def test_wheel_and_what_it_needs_are_all_that_is_there(packages, tmp_path, monkeypatch):
    """No pip is copied, and what PYTHONPATH leads to, as ROS has it, does not count as installed."""
    monkeypatch.setenv("PYTHONPATH", str(packages / "shell-1.0-py3-none-any.whl"))
    folder, synced = tmp_path / "version", []
    monkeypatch.setattr("os.sync", lambda: synced.extend(folder.glob("lib/*/*/turtle.py")))
    assert install_from(packages, folder) == 0
    # The robot may be switched over at once, and nobody can reach one whose new version has empty files.
    assert synced
    (site,) = folder.glob("lib/python*/site-packages")
    assert {path.stem for path in site.glob("*.py")} == {"turtle", "shell"}
    assert not (folder / "bin" / "pip").exists()
    # Compiled once and for all: the agent's user cannot write here.
    assert list(site.glob("__pycache__/turtle.*.pyc"))
    done = subprocess.run([folder / "bin" / "python3", "-Ic", "import turtle, shell"], check=False)
    assert done.returncode == 0


def test_package_with_another_hash_is_not_installed(packages, tmp_path):
    make_wheel(packages, "shell", requires="turtle")
    folder = tmp_path / "version"
    assert install_from(packages, folder) != 0
    assert not list(folder.glob("lib/python*/site-packages/*.py"))


def test_python_without_a_pip_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("sysconfig.get_config_var", {"WHEEL_PKG_DIR": str(tmp_path)}.get)
    with pytest.raises(SystemExit, match="Install python3-venv"):
        find_pip()


@pytest.fixture
def pyav(tmp_path):
    (tmp_path / "wheels").mkdir()
    return make_wheel(tmp_path / "wheels", "av", modules=("av/__init__.py", "av.libs/libx264.so"))


def add_version(folder, pyav, locked="1.0"):
    venv.create(folder, symlinks=True)
    lock = folder / LOCK
    lock.parent.mkdir(parents=True)
    sha256 = hashlib.sha256(pyav.read_bytes()).hexdigest()
    lock.write_text(f"av=={locked} \\\n    --hash=sha256:{sha256}\n")
    [site] = folder.glob("lib/python*/site-packages")
    return site


def test_next_version_has_video_without_a_network(pyav, tmp_path):
    """It links the PyAV of the version before, though its lock has a newer one that nobody can send."""
    offline = ("--no-index", "--find-links", str(pyav.parent))
    old = add_version(tmp_path / "versions/1", pyav)
    assert install_video(tmp_path / "versions/1", offline) == ""
    new = add_version(tmp_path / "versions/2", pyav, "1.1")
    assert install_video(tmp_path / "versions/2", ("--no-index",)) == ""
    for file in ("av/__init__.py", "av.libs/libx264.so", "av-1.0.dist-info/RECORD"):
        assert (new / file).samefile(old / file)


WAS, TARGET = Path("/opt/a/versions/1"), Path("/opt/a/versions/2")


def version(layout, name):
    return layout.base / "versions" / name


class Robot:
    def __init__(self, place):
        self.layout = Layout(place / "opt", place / "unit")
        self.run_dir = place / "run"
        self.run_dir.mkdir()
        self.calls = []
        self.state = "active"
        self.agent = None
        self.layout.use(self.add("1"))
        self.restart()

    def add(self, name, reaches="connected"):
        path = version(self.layout, name)
        for file, text in ((COMMAND, reaches), (NEW_UNIT, f"unit of {name}")):
            (path / file).parent.mkdir(parents=True)
            (path / file).write_text(text)
        (path / COMMAND).chmod(0o755)
        return path

    def restart(self):
        self.calls.append("restart")
        self.end()
        reaches = (self.layout.in_use() / COMMAND).read_text()
        if reaches == "dies":
            raise UpgradeFailedError("cannot do systemctl restart")
        self.agent = subprocess.Popen(["sleep", "60"])
        problem = "" if reaches == "connected" else "cannot reach SSH"
        status = Status(state=reaches, problem=problem, pid=self.agent.pid, written_at=time.time())
        write_atomic(self.run_dir / FILE, json.dumps(asdict(status)), 0o644)

    def become(self, state):
        self.end()
        self.state = state

    def end(self):
        if self.agent is not None:
            self.agent.kill()
            self.agent.wait()

    def status(self):
        return read_status(self.run_dir)

    def change(self, wait_s=5.0):
        return Upgrade(self.layout, self.run_dir, wait_s, stable_s=0)

    def switch(self, target, wait_s=5.0):
        return self.change(wait_s).to(target)

    @property
    def in_use(self):
        return self.layout.in_use().name

    @property
    def written(self):
        return json.loads((self.layout.base / "last-switch.json").read_text())

    @property
    def installed(self):
        return sorted(path.name for path in (self.layout.base / "versions").iterdir())


@pytest.fixture
def robot(tmp_path, monkeypatch):
    made = Robot(tmp_path)
    monkeypatch.setattr(upgrade, "POLL_S", 0.01)
    monkeypatch.setattr(systemd, "restart", made.restart)
    monkeypatch.setattr(systemd, "reload_units", lambda: made.calls.append("reload"))
    monkeypatch.setattr(systemd, "state", lambda: made.state)
    yield made
    made.end()


@pytest.mark.parametrize("name", ["versions/none", "2", "versions/2/bin"])
def test_only_a_whole_version_in_its_place_is_one(robot, name):
    robot.add("2")
    with pytest.raises(UpgradeFailedError, match="cannot switch to"):
        robot.layout.check(robot.layout.base / name)
    robot.layout.check(version(robot.layout, "2"))


def test_a_folder_that_cannot_be_changed_is_told(robot, tmp_path):
    """Upgrade lacks sudo, the disk is read-only, or nothing is installed yet."""
    (robot.layout.base / ".current.new").mkdir()
    with pytest.raises(StateUnusableError, match="run this with sudo"):
        robot.layout.use(robot.add("2"))
    assert robot.in_use == "1"
    with pytest.raises(UpgradeFailedError, match="current leads to no version"):
        Layout(tmp_path / "none").in_use()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd")
def test_systemd_reads_it(tmp_path):
    PendingUpgrade(tmp_path).note(Path("/usr"), TARGET, "connected", 60)
    unit = tmp_path / PENDING_NAME
    unit.write_text(unit.read_text().replace("/usr/bin/robotether-agent", "/bin/true"))
    command = ["systemd-analyze", "verify", "--man=no", str(unit)]
    output = subprocess.run(command, check=False, capture_output=True, text=True).stderr
    assert PENDING_NAME not in output


@pytest.mark.parametrize("state", ["", "connected\nExecStartPre=/bin/sh -c id"])
def test_only_states_that_are_known_reach_the_unit(tmp_path, state):
    """The agent's user writes its state, and root runs the unit."""
    PendingUpgrade(tmp_path).note(WAS, TARGET, state, 60)
    lines = (tmp_path / PENDING_NAME).read_text().splitlines()
    starts = [line for line in lines if line.startswith("Exec")]
    assert len(starts) == 1
    assert starts[0].endswith(f" {TARGET} silent")


class PowerCut(BaseException):
    """Ends a switch as a power cut does: nothing after it is done."""

    @staticmethod
    def now():
        raise PowerCut


def test_a_good_version_takes_over(robot):
    report = robot.switch(robot.add("2"))
    assert (report.result, robot.in_use, robot.status().state) == ("done", "2", "connected")
    assert robot.layout.unit.read_text() == "unit of 2"
    assert robot.calls[1:] == ["reload", "restart"]
    expected = {"result": "done", "was": "1", "wanted": "2", "detail": "2 is in use"}
    assert robot.written == {**robot.written, **expected}


@pytest.mark.parametrize(
    ("reaches", "why"),
    [
        ("dies", "cannot do systemctl restart"),
        ("waiting", "2 was not connected within 0.6 s: it is waiting (cannot reach SSH)"),
    ],
)
def test_a_version_that_does_not_connect_is_taken_back(robot, reaches, why):
    report = robot.switch(robot.add("2", reaches), wait_s=0.6)
    assert (report.result, robot.in_use) == ("rolled_back", "1")
    assert robot.layout.unit.read_text() == "unit of 1"
    assert robot.status().state == "connected"
    assert why in robot.written["detail"]
    assert robot.written["detail"].endswith("1 is in use again, as before")


def test_an_agent_that_was_not_restarted_is_no_new_version(robot, monkeypatch):
    monkeypatch.setattr(systemd, "restart", lambda: None)
    assert robot.switch(robot.add("2"), wait_s=0.1).result == "rolled_back"


def test_a_robot_that_waited_may_go_on_waiting(robot):
    """A server that is down for days must not keep a robot from its update."""
    version(robot.layout, "1").joinpath(COMMAND).write_text("waiting")
    robot.restart()
    report = robot.switch(robot.add("2", "waiting"))
    assert (report.result, robot.in_use) == ("done", "2")


def test_a_service_that_somebody_stopped_stays_stopped(robot):
    """An image that is prepared for cloning must not join by an update."""
    robot.become("inactive")
    report = robot.switch(robot.add("2"))
    assert (report.result, robot.in_use) == ("done", "2")
    assert robot.calls == ["restart", "reload"]


def test_two_versions_are_kept(robot):
    for name in ("2", "3"):
        robot.switch(robot.add(name))
    assert robot.installed == ["2", "3"]
    robot.switch(robot.add("4", "dies"))
    assert robot.installed == ["3", "4"]


@pytest.mark.parametrize(
    ("reaches", "result", "in_use"), [("connected", "done", "2"), ("waiting", "rolled_back", "1")]
)
def test_a_change_that_lost_its_power_gets_its_verdict_at_the_next_boot(
    robot, monkeypatch, reaches, result, in_use
):
    """The old version does it again as its unit says, and judges by how the robot was before."""
    target = robot.add("2", reaches)
    with monkeypatch.context() as cut:
        cut.setattr(systemd, "reload_units", PowerCut.now)
        with pytest.raises(PowerCut):
            robot.switch(target)
    assert (robot.in_use, robot.written["result"]) == ("2", "running")
    robot.become("inactive")
    at_boot = robot.layout.unit.parent / "multi-user.target.wants" / PENDING_NAME
    line = at_boot.read_text().partition("ExecStart=")[2]
    assert line.startswith(f"{robot.layout.base}/versions/1/bin/robotether-agent finish-switch ")
    *_, was, wanted, state = line.split()
    report = robot.change(0.6).finish(Path(was), Path(wanted), state)
    assert (report.result, robot.in_use, robot.written["result"]) == (result, in_use, result)
    assert robot.status().state == "connected"
    assert list(robot.layout.unit.parent.rglob(PENDING_NAME)) == []


@pytest.mark.parametrize(("full_from", "in_use"), [("running", "1"), ("done", "2")])
def test_a_report_that_the_disk_does_not_take_leaves_the_next_boot_alone(
    robot, monkeypatch, full_from, in_use
):
    """Weeks later it would do the switch again, and roll it back where there is no network yet."""
    write = Layout.write

    def write_until_full(layout, report):
        if report.result == full_from:
            raise StateUnusableError("cannot write: the disk is full")
        write(layout, report)

    monkeypatch.setattr(Layout, "write", write_until_full)
    with pytest.raises(StateUnusableError, match="full"):
        robot.switch(robot.add("2"))
    assert (robot.in_use, robot.status().state) == (in_use, "connected")
    assert list(robot.layout.unit.parent.rglob(PENDING_NAME)) == []


def test_one_switch_at_a_time(robot):
    with only_one(robot.layout.lock), pytest.raises(AlreadyRunningError, match="another switch"):
        robot.switch(robot.add("2"))
