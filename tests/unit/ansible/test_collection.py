"""The collection has what belongs to it, and names the collections that it needs."""

import json
import sys
import tarfile
from pathlib import Path

import pytest
import yaml
from commands import output_of_command, path_with, run_command

ROOT = Path(__file__).resolve().parents[3]
ANSIBLE = ROOT / "ansible"
BIN = Path(sys.executable).parent
NAME = "robotether.robotether"
# Of files whose names come from the folder: what a user of the collection can name.
PLAYBOOKS = sorted(path.stem for path in (ANSIBLE / "playbooks").glob("*.yml"))
END_S = 120


def ansible(program, *arguments, cwd):
    """Run one of Ansible's programs, for which the folder is all that there is of settings and collections."""
    environ = {
        **path_with(BIN),
        "HOME": str(cwd),
        "LC_ALL": "C.UTF-8",
        "ANSIBLE_COLLECTIONS_PATH": str(cwd),
        "ANSIBLE_NOCOLOR": "1",
    }
    return output_of_command(BIN / program, *arguments, cwd=cwd, env=environ, limit_s=END_S)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """The collection as ansible-galaxy builds it."""
    folder = tmp_path_factory.mktemp("built")
    build = ("collection", "build", ANSIBLE, "--output-path", folder)
    ansible("ansible-galaxy", *build, cwd=folder)
    [built] = folder.glob("*.tar.gz")
    return built


def test_archive_has_what_belongs_to_it(archive):
    listing = ("git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", "--", ".")
    listed = run_command(*listing, cwd=ANSIBLE).stdout
    if not listed:
        pytest.skip("this is not a git checkout")
    tracked = {name for name in listed.split("\0") if name and (ANSIBLE / name).exists()}
    local = {"galaxy.yml", "ansible.cfg", ".ansible-lint"}
    local |= {f"{name}.ini.example" for name in ("robots", "server", "site")}
    local |= {f"collections/ansible_collections/{NAME.replace('.', '/')}"}
    local |= {f"{name}.yml" for name in PLAYBOOKS}
    assert local <= tracked
    with tarfile.open(archive) as opened:
        files = {member.name for member in opened if not member.isdir()}
        links = [member.name for member in opened if member.issym() or member.islnk()]
    assert files == tracked - local | {"MANIFEST.json", "FILES.json"}
    assert links == []


def test_needed_collections_are_those_of_the_roles(archive):
    with tarfile.open(archive) as opened:
        needed = json.load(opened.extractfile("MANIFEST.json"))["collection_info"]["dependencies"]
    used = set()
    for path in (ANSIBLE / "roles").glob("*/*/*.yml"):
        if path.parent.name in {"tasks", "handlers"}:
            used |= {
                ".".join(key.split(".")[:2])
                for key in keys_of(yaml.safe_load(path.read_text()))
                if key.count(".") == 2
            }
    assert used - {"ansible.builtin", NAME} == set(needed)


def keys_of(found):
    """All keys of what YAML says."""
    if isinstance(found, list):
        return set().union(*(keys_of(item) for item in found))
    if isinstance(found, dict):
        return set(found).union(*(keys_of(item) for item in found.values()))
    return set()
