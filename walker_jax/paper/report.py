"""A page of pictures and tables in one file, readable from disk, on a phone and in the dark."""

import base64
from collections.abc import Sequence
from html import escape

STYLE = """
:root { color-scheme: light dark; --ink: #1a1a1a; --paper: #ffffff; --line: #d0d0d0;
  --faint: #5c5c5c; --mark: #a3271f; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e8e8; --paper: #16181c; --line: #3c4048;
  --faint: #a8adb6; --mark: #ff9d93; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1.5rem 1rem 4rem; color: var(--ink);
  background: var(--paper); font: 1rem/1.55 system-ui, sans-serif; }
h1 { margin: 0; font-size: 1.7rem; line-height: 1.2; }
h2 { margin: 2.8rem 0 0.7rem; font-size: 1.2rem; }
p { max-width: 46rem; margin: 0.6rem 0; }
.faint { color: var(--faint); }
figure { margin: 0; }
img { display: block; width: 100%; height: auto; background: #ffffff; border-radius: 6px;
  border: 1px solid var(--line); padding: 0.5rem; }
figcaption { max-width: 46rem; margin-top: 0.6rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem;
  font-variant-numeric: tabular-nums; }
th, td { padding: 0.35rem 0.7rem 0.35rem 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); }
th { color: var(--faint); font-weight: 600; }
.mark { color: var(--mark); font-weight: 600; }
@media (max-width: 44rem) {
  thead { display: none; }
  tr { display: block; padding: 0.6rem 0; border-bottom: 1px solid var(--line); }
  td { display: block; border: 0; padding: 0.1rem 0; }
  td:empty { display: none; }
  td[data-head]::before { content: attr(data-head) ": "; color: var(--faint); } }
"""


def page(title: str, subtitle: str, intro: str, blocks: Sequence[str], signature: str = "") -> str:
    """Make a page with a heading, an introduction, and blocks of `picture` and `table`.

    The page holds the signature, invisibly.
    """
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en">',
            '<head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta name="generator" content="{escape(signature)}">',
            '<link rel="icon" href="data:,">',  # otherwise browsers ask for a missing icon
            f"<title>{escape(title)}</title><style>{STYLE}</style></head>",
            f'<body><h1>{escape(title)}</h1><p class="faint">{escape(subtitle)}</p>',
            f"<p>{escape(intro)}</p>",
            *blocks,
            "</body></html>",
        ]
    )


def picture(title: str, png: bytes, caption: str) -> str:
    """Make a picture that is kept in the page itself."""
    data = base64.b64encode(png).decode()
    return (
        f"<h2>{escape(title)}</h2><figure>"
        f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Make a table; a narrow page stacks its rows, and cells that say `differs` stand out."""

    def cell(name: str, text: str) -> str:
        label = f' data-head="{escape(name)}"' * bool(name)
        mark = ' class="mark"' * (text == "differs")
        return f"<td{label}{mark}>{escape(text)}</td>"

    lines = ["".join(map(cell, head, row)) for row in rows]
    names = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(f"<tr>{row}</tr>" for row in lines)
    return (
        f'<h2>{escape(title)}</h2><div class="wide"><table><thead><tr>{names}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
