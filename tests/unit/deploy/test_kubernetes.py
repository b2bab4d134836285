"""deploy/kubernetes, against Kubernetes' own schemas, and beside compose/compose.yaml. No cluster runs it here."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
from robotether_server import __version__
from robotether_server.settings import VARIABLES

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "deploy" / "kubernetes"
# The oldest one with all that stands there, and a new one.
VERSIONS = ("1.25", "1.33")
# compose.yaml's service -> the container that does the same.
PROGRAMS = ("nginx", "web", "relay", "sshd", "mysql", "migrate")


def kustomization() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())
    return found


def resources() -> list[dict[str, Any]]:
    """All resources, as the files have them."""
    texts = [(FOLDER / name).read_text() for name in kustomization()["resources"]]
    return [found for text in texts for found in yaml.safe_load_all(text)]


def title(resource: dict[str, Any]) -> str:
    return f"{resource['kind']} {resource['metadata']['name']}"


def pods() -> Iterator[dict[str, Any]]:
    """What each pod is made of."""
    for resource in resources():
        if "template" in resource.get("spec", {}):
            yield resource["spec"]["template"]["spec"]


def containers() -> dict[str, dict[str, Any]]:
    return {one["name"]: one for pod in pods() for one in pod["containers"]}


def environment(container: dict[str, Any]) -> dict[str, str]:
    """The variables of a container with what is known of their values, those of site.env first."""
    lines = (FOLDER / "site.env").read_text().splitlines()
    shared = dict(line.split("=", 1) for line in lines if not line.startswith("#"))
    own = {one["name"]: one.get("value", "") for one in container.get("env", [])}
    return shared | own


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("resource", resources(), ids=title)
def test_resource_fits_the_schema(resource: dict[str, Any], version: str) -> None:
    """Also in that it has no field that Kubernetes does not know."""
    kubernetes_validate.validate(resource, version, strict=True)


@pytest.mark.skipif(shutil.which("kubectl") is None, reason="there is no kubectl")
def test_kustomize_builds_it() -> None:
    """With the generated ConfigMaps, and images with this version's tag alone."""
    done = subprocess.run(
        ["kubectl", "kustomize", str(FOLDER)],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    built = list(yaml.safe_load_all(done.stdout))
    assert {one["metadata"].get("namespace") for one in built if one["kind"] != "Namespace"} == {
        "robotether"
    }
    for resource in built:
        kubernetes_validate.validate(resource, VERSIONS[-1], strict=True)
    images = set(re.findall(r"image: (\S+)", done.stdout))
    assert {image.partition(":")[2] for image in images} == {__version__}


def test_every_image_gets_its_tag() -> None:
    """By the kustomization, and the names of the images are ours."""
    used = {
        one["image"]
        for pod in pods()
        for key in ("containers", "initContainers")
        for one in pod.get(key, [])
    }
    assert {one["name"]: one["newTag"] for one in kustomization()["images"]} == dict.fromkeys(
        used, __version__
    )


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_are_what_they_are_in_compose(name: str) -> None:
    """The same images and commands, with no more rights and memory."""
    ours = containers()[name]
    theirs = yaml.safe_load((ROOT / "compose" / "compose.yaml").read_text())["services"][name]
    assert f"{ours['image']}:" in theirs["image"].replace(
        "${REGISTRY:-local.invalid/}", "local.invalid/"
    )
    assert ours.get("command") == theirs.get("command")
    allowed = ours["securityContext"]
    assert allowed["readOnlyRootFilesystem"]
    assert not allowed["allowPrivilegeEscalation"]
    assert allowed["capabilities"]["drop"] == theirs["cap_drop"]
    assert allowed["capabilities"].get("add") == theirs.get("cap_add")
    # Of compose.yaml's images sshd's alone has root.
    assert allowed.get("runAsNonRoot", False) == (name != "sshd")
    memory = re.sub(r"\$\{\w+:-(\w+)\}", r"\1", theirs["mem_limit"])
    assert ours["resources"]["limits"]["memory"].removesuffix("i").lower() == memory


@pytest.mark.parametrize("name", ["web", "relay", "migrate"])
def test_programs_have_the_settings_that_they_need(name: str) -> None:
    """What compose sets by itself and is no default; what compose leaves to a site has the same default everywhere."""
    ours = environment(containers()[name])
    theirs = yaml.safe_load((ROOT / "compose" / "compose.yaml").read_text())["services"][name]
    for variable, value in theirs["environment"].items():
        if variable not in ours and "${" not in str(value):
            assert VARIABLES[variable].default == str(value), variable
    known = {"CELLS_DOMAIN", "POD_IP", *VARIABLES, *(f"{variable}_FILE" for variable in VARIABLES)}
    assert set(ours) <= known


def test_a_pod_has_no_port_twice() -> None:
    """Its containers share one address."""
    ports = []
    for image in ("nginx", "server", "sshd"):
        text = (ROOT / "images" / image / "Dockerfile").read_text()
        [exposed] = re.findall(r"^EXPOSE (.*)$", text, re.MULTILINE)
        ports += exposed.split()
    # What nginx passes on to sshd is for itself.
    ports += re.findall(
        r"listen 127\.0\.0\.1:(\d+)", (ROOT / "images" / "nginx" / "nginx.conf").read_text()
    )
    assert sorted(ports) == sorted(set(ports))


def parts(file: Path) -> dict[str, tuple[str, str]]:
    """Variable -> (host, port) of nginx's parts.conf."""
    found = re.findall(r"^set \$(\w+) (.+):(\d+);$", file.read_text(), re.MULTILINE)
    return {name: (host, port) for name, host, port in found}


def test_nginx_finds_the_parts_at_its_own_address() -> None:
    """All that it knows of, at the ports that they have."""
    ours = parts(FOLDER / "parts.conf")
    for name, (_host, port) in parts(ROOT / "images" / "nginx" / "parts.conf").items():
        assert ours[name] == ("127.0.0.1", port)


def test_each_program_sees_its_own_secrets_alone() -> None:
    """Of the whole Secret only what make-secrets, which runs first, hands out to it."""
    for name, container in containers().items():
        mounts = [one for one in container["volumeMounts"] if one["name"] == "secrets"]
        assert [one["subPath"] for one in mounts] == [name]
        assert "site-secrets" not in {one["name"] for one in container["volumeMounts"]}
