"""The alerts and the page that says what to do."""

import json
import re
from pathlib import Path
from string import Template

import pytest
import yaml
from robotether_server.services.history import CHARTS_OF_ROBOT, CHARTS_OF_SITE

ROOT = Path(__file__).resolve().parents[3]
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


def test_times_of_alerts_are_tested_by_the_intervals_in_use():
    rules = yaml.safe_load((ROOT / "images" / "prometheus" / "prometheus.yml").read_text())[
        "global"
    ]
    tested = yaml.safe_load((ROOT / "tests" / "images" / "prometheus_times.yml").read_text())
    intervals = {test["interval"] for test in tested["tests"]}
    assert intervals == {rules["scrape_interval"]}
    assert tested["evaluation_interval"] == rules["evaluation_interval"]


def test_dashboard_has_the_queries_of_the_page_health():
    dashboard = json.loads((ROOT / "deploy" / "grafana" / "robotether.json").read_text())
    shown = [target["expr"] for panel in dashboard["panels"] for target in panel.get("targets", ())]
    charts = {"": CHARTS_OF_SITE, 'robot="$robot"': CHARTS_OF_ROBOT}
    assert shown == [
        Template(chart.query).substitute(of=of, step="$__rate_interval")
        for of, charts_of in charts.items()
        for chart in charts_of
    ]


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
