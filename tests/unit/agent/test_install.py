"""A version's folder, made by the robot's own Python and the pip that belongs to it."""

from __future__ import annotations

import hashlib
import subprocess
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest
from robotether_agent.install import find_pip, install
from robotether_agent.install_video import LOCK, install_video


def make_wheel(folder: Path, name: str, requires: str = "", modules: tuple[str, ...] = ()) -> Path:
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
def packages(tmp_path: Path) -> Path:
    make_wheel(tmp_path, "turtle", requires="shell")
    sha256 = hashlib.sha256(make_wheel(tmp_path, "shell").read_bytes()).hexdigest()
    (tmp_path / "requirements.txt").write_text(f"shell==1.0 --hash=sha256:{sha256}\n")
    return tmp_path


def install_from(packages: Path, folder: Path) -> int:
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
def pyav(tmp_path: Path) -> Path:
    (tmp_path / "wheels").mkdir()
    return make_wheel(tmp_path / "wheels", "av", modules=("av/__init__.py", "av.libs/libx264.so"))


def add_version(folder: Path, pyav: Path, locked: str = "1.0") -> Path:
    venv.create(folder, symlinks=True)
    lock = folder / LOCK
    lock.parent.mkdir(parents=True)
    sha256 = hashlib.sha256(pyav.read_bytes()).hexdigest()
    lock.write_text(f"av=={locked} \\\n    --hash=sha256:{sha256}\n")
    [site] = folder.glob("lib/python*/site-packages")
    return site


@pytest.mark.parametrize("locked", ["1.0", "1.1"])
def test_next_version_has_video_without_a_network(pyav, tmp_path, locked):
    """It links the PyAV of the version before, also where its lock has a newer one that nobody can send."""
    offline = ("--no-index", "--find-links", str(pyav.parent))
    old = add_version(tmp_path / "versions/1", pyav)
    assert install_video(tmp_path / "versions/1", offline) == ""
    new = add_version(tmp_path / "versions/2", pyav, locked)
    assert install_video(tmp_path / "versions/2", ("--no-index",)) == ""
    for file in ("av/__init__.py", "av.libs/libx264.so", "av-1.0.dist-info/RECORD"):
        assert (new / file).samefile(old / file)


def test_video_that_cannot_be_had_is_explained(pyav, tmp_path, monkeypatch):
    site = add_version(tmp_path / "versions/1", pyav)
    before = set(site.iterdir())
    assert "av==1.0" in install_video(tmp_path / "versions/1", ("--no-index",))
    monkeypatch.setattr("robotether_agent.install_video.NEEDED_MB", 10**9)
    assert "MB free" in install_video(tmp_path / "versions/1", ("--no-index",))
    assert set(site.iterdir()) == before
