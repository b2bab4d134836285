"""What a robot installs itself from: open to everybody, and nothing but what the manifest lists."""

import hashlib

import pytest

WHEEL = "robotether_agent-0.1.0-py3-none-any.whl"
CONTENTS = {WHEEL: b"PK\x03\x04wheel", "requirements.txt": b"aiohttp==3\n"}


@pytest.fixture
def folder(web_settings):
    """The folder as the image has it, with a file beside that nobody asked to publish."""
    made = web_settings.agent_files_dir
    made.mkdir()
    for name, content in CONTENTS.items():
        (made / name).write_bytes(content)
    lines = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in CONTENTS.items()]
    (made / "manifest").write_text("".join(lines))
    (made / "join.sh").write_text("#!/bin/sh\necho 'Grüße'\n")
    (made / "secret").write_text("not listed")
    for architecture in ("amd64", "arm64"):
        (made / f"robotether-agent_0.1.0_{architecture}.deb").write_text(architecture)
    return made


def test_package_is_for_the_asked_architecture_and_caches_ask_again(program, folder):
    """After an upgrade no cache mixes old and new files; what is the same is not sent again."""
    packages = {"": "amd64", "?arch=amd64": "amd64", "?arch=arm64": "arm64"}
    files = ("/join.sh", "/agent/manifest", f"/agent/{WHEEL}")
    for path in (*files, *(f"/agent.deb{query}" for query in packages)):
        with program.ask("GET", path) as answer:
            assert answer.cache_control.no_cache
            if path not in files:
                assert answer.text == packages[path.removeprefix("/agent.deb")]
                assert answer.content_type == "application/vnd.debian.binary-package"
            known = {"If-None-Match": answer.headers["ETag"]}
        with program.ask("GET", path, headers=known) as again:
            assert (again.status_code, again.data) == (304, b"")
    answer = program.ask("GET", "/agent.deb?arch=../secret")
    assert answer.status_code == 404
    assert "amd64 or arm64" in answer.text


def test_nothing_else_is_served(program, folder):
    for name in ("secret", "join.sh", "ghost", "..%2fsecret", "%2e%2e/manifest"):
        assert program.ask("GET", f"/agent/{name}").status_code == 404, name
