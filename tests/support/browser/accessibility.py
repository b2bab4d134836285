"""What axe-core finds on a page."""

from __future__ import annotations

from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
# Of those, what a colour scheme or a size may break.
BY_LOOK = ["color-contrast", "link-in-text-block", "scrollable-region-focusable", "target-size"]
# Of the violations what a person needs to find them.
RUN = """async (only) => {
  const found = await axe.run({ runOnly: only, resultTypes: ['violations'] });
  const words = (node) => `${node.html.slice(0, 120)} ${node.failureSummary}`;
  const violations = found.violations.map(({ id, nodes }) => [id, ...nodes.map(words)]);
  return { violations, passes: found.passes.length };
}"""


def violations(page: Page, rules: list[str]) -> list[Any]:
    """Return each violation of these rules, or of all in the sets RULES, with its places."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(Axe().axe_script)
    found = page.evaluate(RUN, {"type": "tag" if rules is RULES else "rule", "values": rules})
    assert rules is not RULES or found["passes"], f"axe has looked at nothing of {page.url}"
    return list(found["violations"])
