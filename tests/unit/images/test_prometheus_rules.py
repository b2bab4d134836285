"""The alerts and the page that says what to do."""

import re
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[3]


def test_each_alert_has_a_section_and_each_section_an_alert() -> None:
    rules = yaml.safe_load((ROOT / "images" / "prometheus" / "rules.yml").read_text())
    alerts = [rule for group in rules["groups"] for rule in group["rules"] if "alert" in rule]
    page = "docs/howto/metrics.md"
    sections = re.findall(r"^### (\w+)$", (ROOT / page).read_text(), re.MULTILINE)
    assert sections == [rule["alert"] for rule in alerts]
    for rule in alerts:
        assert rule["annotations"]["what_to_do"] == f"{page}#{rule['alert'].lower()}"


def test_rules_read_what_the_relay_has() -> None:
    """An alert on a number that has another name now would never come."""
    sources = [*(ROOT / "server/robotether_server/relay").glob("*.py")]
    code = "".join(path.read_text() for path in sources)
    rules = (ROOT / "images" / "prometheus" / "rules.yml").read_text()
    for name in set(re.findall(r"robotether_relay_(\w+)", rules)):
        assert f'{name.removesuffix("_bucket").removesuffix("_total")}"' in code, name
