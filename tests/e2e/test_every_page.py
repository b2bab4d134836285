"""Every page of the application is accessible: to an admin, an operator and who is logged out, in each look.

The pages are those of Flask's own map of addresses: a new one is looked at without being named here.
"""

import re
from contextlib import closing
from pathlib import Path

import pytest
from accessibility import BY_LOOK, RULES, violations
from page_users import PageUsers
from pages import expect_no_sideways_scroll, expect_small_map, resize
from playwright.sync_api import expect
from robotether_server.settings.server import DatabaseSettings
from robotether_server.web import create_app
from web_visitor import web_settings_of

DESKTOP, PHONE, SMALL_PHONE, ZOOMED = (1280, 800), (390, 844), (320, 640), (640, 400)
# They answer a program, or are a site of its own.
NO_PAGES = re.compile(
    r"/(api|static|docs|agent|healthz|favicon\.ico|join\.sh|agent\.deb)\b|.*/(download|file)$"
)
OPERATOR, GROUP, SITE = "eve-of-pages", "all-pages", "pages-hall"
# What stands for the parts of an address below it, the first that fits; a number is that of a table's newest row.
PARTS = {
    "/admin/users/": {"name": OPERATOR},
    "/admin/groups/": {"name": GROUP, "user": OPERATOR},
    "/admin/sites/": {"name": SITE, "robot": "sim2"},
    "/": {"name": "sim1", "place": "1"},
}
# What is ticked where a page is about that.
TICKED = {
    "/admin/selected-robots/": "?robot=sim1",
    "/admin/selected-users/": f"?user={OPERATOR}&group={GROUP}&scope=all&level=drive",
}
TABLES = {
    "grant_id": "grants",
    "key_id": "user_ssh_keys",
    "recording_id": "recordings",
    "rejected_id": "key_claims",
    "route_id": "routes",
    "token_id": "api_tokens",
}
# Their rows need not exist: the question that such a page asks has the template of all questions.
MAY_BE_ABSENT = ("<int:", "/pending/")
# What hides more than it shows, but an ellipsis, and words for a screen reader alone.
CUT = """() => [...document.querySelectorAll('main *, header *')].filter((e) => {
  const style = getComputedStyle(e);
  const hides = ['hidden', 'clip'].includes(style.overflowX) && style.clipPath === 'none';
  const shows = style.textOverflow !== 'ellipsis' && e.checkVisibility() && e.textContent.trim();
  return hides && shows && e.scrollWidth > e.clientWidth + 1;
}).map((e) => e.outerHTML.slice(0, 120))"""
# All of a page that is rarely needed, and of a list's lines the first.
UNFOLD = """() => [...document.querySelectorAll('details.fold'), document.querySelector('details.line')]
  .forEach((e) => e?.setAttribute('open', ''))"""
MOVING = """() => {
  const runs = document.getAnimations().map((one) => one.effect?.target?.outerHTML.slice(0, 120));
  const may = [...document.querySelectorAll('body *')].filter((e) => ['', '::before', '::after'].some((part) => {
    const style = getComputedStyle(e, part || null);
    return style.animationName !== 'none' || parseFloat(style.transitionDuration) > 0;
  }));
  return [...runs, ...may.map((e) => e.outerHTML.slice(0, 120))];
}"""
# What is pressed or typed into has an edge (a tile that is pressed is a picture), what is chosen differs from what
# stands beside it by more than a ground, and what has the focus an outline.
EDGELESS = r"""() => [...document.querySelectorAll(
    'button, .button, select, textarea, input:not([type=checkbox], [type=range], [type=hidden])')]
  .filter((e) => e.checkVisibility() && !e.matches('.skip, .tile-enlarge')).filter((e) => {
    const style = getComputedStyle(e);
    return parseFloat(style.borderTopWidth) === 0 || /^rgba.*, 0\)$/.test(style.borderTopColor);
  }).map((e) => e.outerHTML.slice(0, 120))"""
UNMARKED = """() => [...document.querySelectorAll('[aria-current], [aria-pressed=true]')]
  .filter((e) => e.checkVisibility()).filter((e) => {
    const other = [...e.parentElement.children].find((o) => o !== e && o.matches(e.tagName));
    if (!other) return false;
    const shape = (s) => [s.borderBottomColor, s.borderBottomWidth, s.textDecorationLine, s.backgroundColor].join();
    return shape(getComputedStyle(e)) === shape(getComputedStyle(other));
  }).map((e) => e.outerHTML.slice(0, 120))"""
FOCUS = """() => {
  const all = [...document.querySelectorAll('main a, main button, main select, main input, main summary')];
  const one = all.find((e) => e.checkVisibility() && !e.disabled && e.type !== 'hidden');
  if (!one) return '';
  one.focus({ focusVisible: true });
  const style = getComputedStyle(one), after = getComputedStyle(one, '::after');
  return [style, after].some((s) => s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 2) ? '' : one.outerHTML;
}"""


def rules_of_pages():
    """Return the addresses of all pages, with their parts as Flask names them."""
    nowhere = DatabaseSettings("127.0.0.1", 1, "none", "none", "none")
    app = create_app(web_settings_of(nowhere, Path("/nonexistent")))
    rules = [item.rule for item in app.url_map.iter_rules() if "GET" in (item.methods or ())]
    return [rule for rule in rules if not NO_PAGES.match(rule)]


def address(rule, numbers):
    """Return the rule with its parts filled in, and a box ticked where a page is about those."""
    parts = next(parts for start, parts in PARTS.items() if rule.startswith(start)) | numbers
    ticked = next((query for start, query in TICKED.items() if rule.startswith(start)), "")
    return re.sub(r"<(?:\w+:)?(\w+)>", lambda part: parts[part[1]], rule) + ticked


class Looks:
    """Looks at one page after another in all that it may look like; each content once."""

    def __init__(self, page, url):
        self.page, self.url = page, url
        self.found = []
        self._path = ""
        self._seen = set()
        self._questions = 0

    def look(self, path):
        self._path = path
        self._be(DESKTOP, color_scheme="light")
        response = self.page.goto(self.url + path)
        assert "text/html" in response.headers["content-type"], path
        if self.page.get_by_test_id("small-map").count():
            expect_small_map(self.page)
        text = self.page.evaluate(
            "document.title + document.querySelector('main').textContent.replace(/\\d+/g, '')"
        )
        if text not in self._seen:
            self._seen.add(text)
            self._look_closely()
        return response.status

    def _look_closely(self):
        self.page.evaluate(UNFOLD)
        self._axe("", RULES)
        self._questions += self.page.locator(".confirm").count()
        if self.page.locator(".confirm").count() and self._questions > 2:
            return  # they differ in their words alone
        self._be(DESKTOP, color_scheme="dark")
        self._axe("dark", BY_LOOK)
        self._be(PHONE, color_scheme="dark")
        self._axe("dark on a phone", RULES)
        self._be(PHONE, color_scheme="light")
        self._axe("on a phone", BY_LOOK)
        self._look_at_contrast()
        self._be(SMALL_PHONE)
        expect_no_sideways_scroll(self.page)
        self._be(ZOOMED, reduced_motion="reduce")
        expect_no_sideways_scroll(self.page)
        self._expect_none("cut at 200 %", CUT)
        self._expect_none("moving although motion is reduced", MOVING)
        self._be(DESKTOP, reduced_motion="no-preference")

    def _look_at_contrast(self):
        for scheme in ("light", "dark"):
            self._be(PHONE, color_scheme=scheme, contrast="more")
            self._axe(f"{scheme}, more contrast", ["color-contrast-enhanced"])
            self._expect_none(f"without an edge, {scheme}, more contrast", EDGELESS)
        self._be(DESKTOP, forced_colors="active", contrast="no-preference", color_scheme="light")
        self._expect_none("without an edge in forced colours", EDGELESS)
        self._expect_none("like the others in forced colours", UNMARKED)
        self._expect_none("without an outline in forced colours", FOCUS)
        self._be(DESKTOP, forced_colors="none")

    def _be(self, size, **media):
        self.page.emulate_media(**media)
        resize(self.page, *size)

    def _axe(self, look, rules):
        found = violations(self.page, rules)
        self.found += [f"{self._path} {look}: {violation}" for violation in found]

    def _expect_none(self, what, script):
        found = self.page.evaluate(script)
        if found:
            self.found.append(f"{self._path} is {what}: {found}")


@pytest.fixture(scope="module")
def operator(stack, browser):
    """The page of an operator, who is in a group and has driven; a site has a robot."""
    admin = stack.admin
    with closing(PageUsers(stack, browser)) as people:
        people.let(OPERATOR, "drive", "sim1")
        stack.wait_until_drivable("sim1")
        admin.ask("POST", "/groups", {"name": GROUP})
        admin.ask("PUT", f"/groups/{GROUP}/members/{OPERATOR}")
        admin.ask("POST", "/sites", {"name": SITE})
        stack.sql(
            "INSERT INTO drives (robot, user_name, fence, ended_at, end_code, distance_m, top_speed_m_s) "
            f"VALUES ('sim1', '{OPERATOR}', 1, NOW(6) + INTERVAL 8 SECOND, 'client_left', 12.3, 0.5)"
        )
        yield people.browse(OPERATOR)
    stack.sql(f"DELETE FROM drives WHERE user_name = '{OPERATOR}'")
    for kind, name in (("users", OPERATOR), ("groups", GROUP), ("sites", SITE)):
        admin.remove(kind, name)


def _numbers(stack):
    columns = ", ".join(f"(SELECT IFNULL(MAX(id), 0) FROM {table})" for table in TABLES.values())
    [row] = stack.sql(f"SELECT {columns}")
    return dict(zip(TABLES, row, strict=True))


# They take over a minute; for every change test_accessibility.py looks at the pages that people drive by.
@pytest.mark.release
@pytest.mark.usefixtures("operator")
def test_pages_of_an_admin(page, stack):
    looks, numbers = Looks(page, stack.url), _numbers(stack)
    for rule in rules_of_pages():
        status = looks.look(address(rule, numbers))
        assert status == 200 or any(part in rule for part in MAY_BE_ABSENT), f"{rule}: {status}"
    assert looks.look("/robots/nobody") == 404
    assert not looks.found, "\n".join(looks.found)


@pytest.mark.release
def test_pages_of_an_operator(operator, stack):
    looks = Looks(operator, stack.url)
    for rule in rules_of_pages():
        if not rule.startswith("/admin"):
            looks.look(address(rule, _numbers(stack)))
    assert looks.look("/admin/robots") == 403
    assert not looks.found, "\n".join(looks.found)


@pytest.mark.release
def test_pages_of_who_is_logged_out(context, stack):
    looks = Looks(context.new_page(), stack.url)
    assert looks.look("/login") == 200
    assert looks.look("/nothing") == 404
    assert not looks.found, "\n".join(looks.found)


def test_documents_are_found_by_search_and_load_nothing_from_elsewhere(page, stack):
    """The policy of the pages stops no script of theirs: search runs in one."""
    complaints = []
    hosts = set()
    page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
    page.on("request", lambda request: hosts.add(re.sub(r"^\w+:/*([^/]*).*", r"\1", request.url)))
    page.goto(f"{stack.url}/docs/")
    page.get_by_role("textbox", name="Search").press_sequentially("deadman")
    # Which page is the best one changes with each that is written.
    found = page.locator(".md-search-result__item", has_text="deadman_ms").first
    found.get_by_role("link").first.click()
    expect(page).to_have_url(re.compile(rf"{stack.url}/docs/\w+/"))
    assert complaints == []
    assert hosts == {stack.url.removeprefix("https://")}
