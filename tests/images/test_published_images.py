"""What the built images say of themselves, and the lists of what is in them; asked of the engine and of the images."""

import json
import os
import re

import pytest
import robotether_server
from commands import output_of_command
from image_names import image as name_of
from stack import ROOT

# What `make images` builds.
BUILT = ("mysql", "sshd", "nginx", "acme", "prometheus", "server", "sim_robot")
OCI = "org.opencontainers.image."


def bake(*arguments, **variables):
    """Run the build description with these variables; return what it prints."""
    environment = {**os.environ, "CA_BUNDLE": os.environ.get("SSL_CERT_FILE", ""), **variables}
    command = ("docker", "buildx", "bake", *arguments)
    return output_of_command(*command, cwd=ROOT, env=environment, limit_s=600)


def in_image(image, *command):
    run = ("docker", "run", "--rm", "--network", "none", "--entrypoint", command[0])
    return output_of_command(*run, name_of(image), *command[1:])


@pytest.mark.parametrize("image", BUILT)
def test_image_says_what_it_is(image):
    said = output_of_command("docker", "image", "inspect", name_of(image))
    labels = json.loads(said)[0]["Config"]["Labels"]
    assert labels[f"{OCI}title"] == f"Robotether: {image}"
    assert labels[f"{OCI}description"]
    assert labels[f"{OCI}version"] == robotether_server.__version__
    assert labels[f"{OCI}licenses"] == "Apache-2.0"
    assert re.fullmatch("[0-9a-f]{40}", labels[f"{OCI}revision"])
    show = ("git", "show", "--no-patch", "--format=%cI", labels[f"{OCI}revision"])
    committed = output_of_command(*show, cwd=ROOT)
    assert labels[f"{OCI}created"] == committed.strip()


def listed(file):
    sbom = json.loads(file.read_text())
    assert sbom["bomFormat"] == "CycloneDX"
    return {(each["name"], each["version"]) for each in sbom["components"]}


@pytest.mark.release
def test_sbom_lists_what_is_in_the_image(tmp_path):
    bake("sbom_server", "--set", f"*.output=type=local,dest={tmp_path}")
    packages = in_image(
        "server", "dpkg-query", "--show", "--showformat", "${Package} ${Version}\\n"
    )
    debian = {(name, version) for name, version in map(str.split, packages.splitlines())}
    assert debian <= listed(tmp_path / "server.debian.cdx.json")
    script = "import importlib.metadata as m; [print(d.name, d.version) for d in m.distributions()]"
    installed = in_image("server", "/opt/venv/bin/python3", "-c", script)
    python = {(name, version) for name, version in map(str.split, installed.splitlines())}
    assert python == listed(tmp_path / "server.python.cdx.json")
