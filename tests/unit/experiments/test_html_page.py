"""The Markdown page as HTML."""

from html.parser import HTMLParser

from paper.html_page import render

MARKDOWN = """# Experiments & more

Text <script>alert(1)</script>.

## First

| a | b |
|---|---|
| 1 | **2** |

![A curve](curve.svg)

## First
"""


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.seen: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append(tag)
        self.ids += [str(value) for name, value in attrs if name == "id"]
        self.links += [str(value) for name, value in attrs if name == "href"]


def tags(html: str) -> Tags:
    parser = Tags()
    parser.feed(html)
    return parser


def test_html_in_the_markdown_is_shown_and_not_obeyed() -> None:
    """There is no script on the page, whatever a failure's text says."""
    html = render(MARKDOWN)
    assert "script" not in tags(html).seen
    assert "&lt;script&gt;" in html


def test_tables_and_figures_are_there() -> None:
    """What the Markdown has is what the HTML has."""
    html = render(MARKDOWN)
    assert "<td><strong>2</strong></td>" in html
    assert '<img src="curve.svg" alt="A curve" />' in html
    assert "<title>Experiments &amp; more</title>" in html


def test_contents_lead_to_every_chapter() -> None:
    """Also when two have the same heading."""
    seen = tags(render(MARKDOWN))
    assert len(seen.links) == 2
    assert len(set(seen.links)) == 2
    assert {link.removeprefix("#") for link in seen.links} <= set(seen.ids)
