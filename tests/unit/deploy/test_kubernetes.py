"""deploy/kubernetes against Kubernetes' schemas. No cluster runs these files."""

from pathlib import Path

import kubernetes_validate
import pytest
import yaml
from robotether_server import __version__

FOLDER = Path(__file__).resolve().parents[3] / "deploy" / "kubernetes"
KUSTOMIZATION = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())
RESOURCES = [
    resource
    for name in KUSTOMIZATION["resources"]
    for resource in yaml.safe_load_all((FOLDER / name).read_text())
]


def title(resource):
    return f"{resource['kind']} {resource['metadata']['name']}"


# The oldest version that has all fields in use, and a new one.
@pytest.mark.parametrize("version", ["1.25", "1.33"])
@pytest.mark.parametrize("resource", RESOURCES, ids=title)
def test_resource_fits_the_schema(resource, version):
    kubernetes_validate.validate(resource, version, strict=True)


def test_images_have_the_tag_of_this_version():
    pods = [item["spec"]["template"]["spec"] for item in RESOURCES if "template" in item["spec"]]
    used = {
        initcontainer["image"]
        for pod in pods
        for initcontainer in pod.get("initContainers", []) + pod["containers"]
    }
    tags = {image["name"]: image["newTag"] for image in KUSTOMIZATION["images"]}
    assert tags == dict.fromkeys(used, __version__)
