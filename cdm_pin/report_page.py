"""The page of a report: its frame, its style, and the few HTML pieces it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{title}: {word}</title>
<style>
:root {{ color-scheme: light; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0 auto; padding: 1rem; max-width: 62rem; font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a;
  background: #fff; }}
h1 {{ font-size: 1rem; font-weight: 600; color: #555; margin: 0 0 .5rem; }}
h2 {{ font-size: 1.3rem; margin: 2.2rem 0 .6rem; border-bottom: 2px solid #ddd; padding-bottom: .2rem; }}
h3 {{ font-size: 1.05rem; margin: 1.4rem 0 .4rem; }}
.verdict {{ border-left: .5rem solid #767676; background: #f4f4f4; padding: .8rem 1rem; border-radius: .3rem; }}
.verdict.good {{ border-color: #009E73; }} .verdict.found {{ border-color: #D55E00; }}
.verdict b {{ display: block; font-size: .95rem; margin-bottom: .3rem; }}
.verdict p {{ font-size: 1.25rem; line-height: 1.4; margin: 0; }}
nav {{ margin: .9rem 0 0; display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; }}
a {{ color: #005a8f; }}
figure {{ margin: .6rem 0; }}
figure svg, .cards svg {{ display: block; }}
figcaption, .key {{ font-size: .88rem; color: #444; }}
.key span {{ display: inline-block; margin-right: 1.2rem; white-space: nowrap; }}
.key svg {{ width: 34px; height: 10px; margin-right: .35rem; vertical-align: middle; }}
.cards {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(min(19rem, 100%), 1fr)); gap: .6rem 1.2rem; }}
.cards figure {{ margin: 0; break-inside: avoid; }}
.scroll {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-size: .95rem; margin: .4rem 0; }}
table.small {{ font-size: .84rem; }}
th, td {{ text-align: left; vertical-align: top; padding: .25rem .9rem .25rem 0; border-bottom: 1px solid #e2e2e2; }}
th {{ font-weight: 600; }}
@media screen and (max-width: 36rem) {{ table.wide thead {{ display: none; }}
  table.wide tr {{ display: block; border-bottom: 1px solid #ccc; padding: .3rem 0; }}
  table.wide td {{ display: block; border: 0; padding: .1rem 0; }}
  table.wide td:not([data-name=""])::before {{ content: attr(data-name) ": "; color: #555; }}
  table.wide td[data-name=""] {{ font-weight: 600; }} }}
@media print {{ body {{ max-width: none; padding: 0; font-size: 11pt; }} nav {{ display: none; }}
  section, figure, tr {{ break-inside: avoid-page; }} section {{ break-inside: auto; }}
  .verdict, svg {{ print-color-adjust: exact; -webkit-print-color-adjust: exact; }} }}
</style>
</head>
<body>
<header>
<h1>{title}</h1>
<div class="verdict {tone}"><b>{sign} {word}</b><p>{sentence}</p></div>
<nav aria-label="Sections">{contents}</nav>
</header>
<main>{sections}</main>
</body>
</html>
"""


def paragraph(words: str) -> str:
    """Give a paragraph of plain words."""
    return f"<p>{escape(words)}</p>"


def figure(picture: str, caption: str) -> str:
    """Give a figure with its caption in plain words."""
    return f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"


def cards(pictures: Sequence[tuple[str, str]]) -> str:
    """Give figures side by side where there is room: pairs of title and SVG."""
    return '<div class="cards">' + "".join(figure(picture, title) for title, picture in pictures) + "</div>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], *, small: bool = False) -> str:
    """Give a table of plain words; where there is no room, a wide one has its cells one below the other."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(
        "<tr>"
        + "".join(f'<td data-name="{escape(name)}">{escape(cell)}</td>' for name, cell in zip(header, row, strict=True))
        + "</tr>"
        for row in rows
    )
    kinds = [kind for kind, yes in (("small", small), ("wide", len(header) > 3)) if yes]
    style = f' class="{" ".join(kinds)}"' if kinds else ""
    return f'<div class="scroll"><table{style}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def key(entries: Sequence[tuple[str, str, str]]) -> str:
    """Give the legend of the lines of a figure: name, colour, dashes."""
    spans = "".join(
        f'<span><svg viewBox="0 0 34 10" aria-hidden="true"><path d="M1 5h32" stroke="{colour}" stroke-width="2.4" '
        f'stroke-dasharray="{dash or "none"}"/></svg>{escape(name)}</span>'
        for name, colour, dash in entries
    )
    return f'<div class="key">{spans}</div>'
