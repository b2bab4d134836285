"""Who may look at the pages for admins and at the profile, whatever the page."""

from admin_visitor import join
from robotether_server.web import create_app
from web_visitor import paths


def test_nobody_is_sent_to_log_in_and_back(app, browser):
    starts = ("/admin", "/profile", "/drives", "/queue", "/robots", "/wall")
    asked = [path for start in starts for path in paths(app, start, "GET")]
    assert len(asked) > 30
    for path in ["/", *asked]:
        answer = browser.ask("GET", path)
        assert (answer.status_code, answer.location) == (302, f"/login?next={path}"), path


def test_a_user_who_is_no_admin_may_not(app, browser):
    browser.log_in("ann")
    for path in paths(app, "/admin", "GET"):
        answer = browser.ask("GET", path)
        assert answer.status_code == 403, path
        assert "This page is for administrators." in answer.text
    assert "menu-profile" in answer.text
    assert "menu-admin" not in answer.text
    token = browser.csrf_of("/")
    for path in paths(app, "/admin", "POST"):
        assert browser.ask("POST", path, data={"csrf_token": token}).status_code == 403, path


def test_no_form_works_without_the_pages_token(app, browser):
    """Another site cannot send an admin's form."""
    browser.log_in("root")
    for path in paths(app, "/admin", "POST") + paths(app, "/profile", "POST"):
        answer = browser.ask("POST", path)
        assert (answer.status_code, "Cannot accept the form" in answer.text) == (403, True), path


def test_every_form_has_a_page_at_its_path(web_settings):
    """A login that ended in between leads back to something that can be seen."""
    app = create_app(web_settings)
    for start in ("/admin", "/profile"):
        assert set(paths(app, start, "POST")) <= set(paths(app, start, "GET"))


def test_admins_see_everywhere_how_many_wait(browser, program):
    assert join(program, "02:00:00:00:51:77", 1).status_code == 202
    browser.log_in("root")
    for path in ("/", "/admin/robots", "/profile"):
        assert "1 awaiting approval" in browser.ask("GET", path).text
