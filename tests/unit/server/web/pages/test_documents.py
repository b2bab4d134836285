"""The documents' site: pages by their folder, with a policy of their own, and nothing from outside."""

from robotether_server.web.pages import documents

POLICY = "default-src 'self'; script-src 'self' 'sha256-abc'"


def test_its_scripts_run_by_its_own_policy_and_nothing_else_is_sent(program, tmp_path, monkeypatch):
    """A file beside the site as MkDocs builds it is no part of it."""
    made = tmp_path / "site"
    made.mkdir()
    (made / "index.html").write_text("<title>all</title>")
    (made / "policy").write_text(POLICY)
    (tmp_path / "secret").write_text("not published")
    monkeypatch.setattr(documents, "SITE", made)
    with program.ask("GET", "/docs/") as answer:
        assert answer.status_code == 200
        assert answer.headers["Content-Security-Policy"] == POLICY
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
    for path in ("/docs/nothing/", "/docs/../secret", "/docs/%2e%2e/secret"):
        answer = program.ask("GET", path)
        assert answer.status_code == 404
        assert "not published" not in answer.text
