"""docs/experiments/index.html: the Markdown page as HTML that needs nothing else, for phones and dark rooms too."""

from __future__ import annotations

import html
import re
from itertools import pairwise

from markdown_it import MarkdownIt
from markdown_it.token import Token

STYLE = """
:root { color-scheme: light dark; --ink: #1c2024; --paper: #ffffff; --line: #d5d9de;
  --link: #0b5cad; --faint: #f3f5f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e7ea; --paper: #15181b; --line: #3a4046; --link: #7db8f0; --faint: #1f2428; }
}
body { margin: 0 auto; max-width: 78rem; padding: 1rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1, h2, h3 { line-height: 1.2; }
h2 { margin-top: 2.5rem; border-top: 1px solid var(--line); padding-top: 1rem; }
a { color: var(--link); }
table { display: block; overflow-x: auto; border-collapse: collapse; font-size: .9rem;
  font-variant-numeric: tabular-nums; }
th, td { border: 1px solid var(--line); padding: .25rem .6rem; text-align: left; white-space: nowrap; }
td:nth-child(-n+3) { white-space: normal; min-width: 7rem; }
th { background: var(--faint); }
code { background: var(--faint); padding: .1em .3em; border-radius: .2em; }
img { max-width: 100%; height: auto; background: #ffffff; border-radius: .3rem; }
"""
FRAME = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}</body>
</html>
"""


def render(markdown: str) -> str:
    """A whole HTML document; HTML within the Markdown is shown, and not obeyed."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(markdown)
    headings = list(_named_headings(tokens))
    title = next((text for tag, _, text in headings if tag == "h1"), "")
    links = [
        f'<li><a href="#{name}">{html.escape(text)}</a></li>\n'
        for tag, name, text in headings
        if tag == "h2"
    ]
    body = reader.renderer.render(tokens, reader.options, {})
    contents = f"</h1>\n<nav><ul>\n{''.join(links)}</ul></nav>"
    body = body.replace("</h1>", contents, 1) if links else body
    return FRAME.format(title=html.escape(title), style=STYLE, body=body)


def _named_headings(tokens: list[Token]) -> list[tuple[str, str, str]]:
    """Give each heading an id; tag, id and text of all of them."""
    found: list[tuple[str, str, str]] = []
    for token, content in pairwise(tokens):
        if token.type == "heading_open":
            text = "".join(child.content for child in content.children or [])
            name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
            if any(name == taken for _, taken, _ in found):
                name = f"{name}-{len(found)}"
            token.attrSet("id", name)
            found.append((token.tag, name, text))
    return found
