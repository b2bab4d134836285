"""The alerts and the page that says what to do."""

import json
import re
from pathlib import Path
from string import Template

import pytest
import yaml
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models.dashboard import Dashboard
from robotether_server.services.history import CHARTS_OF_ROBOT, CHARTS_OF_SITE

ROOT = Path(__file__).resolve().parents[3]
DASHBOARD = json.loads((ROOT / "deploy" / "grafana" / "robotether.json").read_text())
# What asks Prometheus for numbers by their names.
READERS = (
    "images/prometheus/rules.yml",
    "server/robotether_server/services/history.py",
)


def test_each_alert_has_a_section_and_each_section_an_alert():
    rules = yaml.safe_load((ROOT / "images" / "prometheus" / "rules.yml").read_text())
    alerts = [rule for group in rules["groups"] for rule in group["rules"] if "alert" in rule]
    page = "docs/howto/metrics.md"
    sections = re.findall(r"^### (\w+)$", (ROOT / page).read_text(), re.MULTILINE)
    assert sections == [rule["alert"] for rule in alerts]
    for rule in alerts:
        assert rule["annotations"]["what_to_do"] == f"{page}#{rule['alert'].lower()}"


def test_dashboard_has_the_queries_of_the_page_health():
    shown = [target["expr"] for panel in DASHBOARD["panels"] for target in panel.get("targets", ())]
    charts = {"": CHARTS_OF_SITE, 'robot="$robot"': CHARTS_OF_ROBOT}
    assert shown == [
        Template(chart.query).substitute(of=of, step="$__rate_interval")
        for of, charts_of in charts.items()
        for chart in charts_of
    ]


def test_dashboard_has_nothing_that_grafanas_own_types_do_not_know():
    """They drop what they do not know. Grafana does so without a word, and the panel is another than was meant."""
    register_default_plugins()
    read = Dashboard.from_json(DASHBOARD)
    assert missing(DASHBOARD, json.loads(JSONEncoder().encode(read))) == []


def missing(value, kept, path="dashboard"):
    """The paths of all that is in `value`, and not the same in `kept`."""
    if isinstance(value, dict) and isinstance(kept, dict):
        pairs = [(f"{path}.{name}", item, kept.get(name)) for name, item in value.items()]
    elif isinstance(value, list) and isinstance(kept, list) and len(value) == len(kept):
        pairs = [
            (f"{path}[{place}]", *pair) for place, pair in enumerate(zip(value, kept, strict=True))
        ]
    else:
        return [] if value == kept else [path]
    return [lost for name, item, other in pairs for lost in missing(item, other, name)]


SERVER = ROOT / "server" / "robotether_server"
SOURCES = [*(SERVER / "relay").glob("*.py"), SERVER / "api" / "web_metrics.py"]


@pytest.mark.parametrize("file", READERS)
def test_what_is_read_is_there(file):
    """An alert or a curve of a number that has another name now would never come."""
    code = "".join(path.read_text() for path in SOURCES)
    names = set(re.findall(r"robotether_(?:relay|robot|web)_(\w+)", (ROOT / file).read_text()))
    assert names
    for name in names:
        base = name.removesuffix("_bucket")
        assert f'{base}"' in code or f'{base.removesuffix("_total")}"' in code, name
