r"""Formulas, $...$ and $$...$$, as MathML, which browsers show without any program."""

import html
import re

from latex2mathml.converter import convert

MARKED = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\s*\\[(\[](?P<formula>.*?)\\[)\]]\s*</(?P=tag)>', re.S
)
"""What the Markdown extension arithmatex makes of a formula."""


FUNCTION = "<mi>(?:cos|det|sin|tan)</mi>"
POWER = f"<msup>{FUNCTION}<mn>2</mn></msup>"
SPACE = '<mspace width="0.1667em" />'


def on_page_content(page_html, *, page, config, files):
    def mathml(found: re.Match) -> str:
        display = "block" if found["tag"] == "div" else "inline"
        formula = convert(html.unescape(found["formula"]).strip(), display=display)
        # The thin spaces about the name of a function, which the converter leaves out.
        formula = re.sub(rf"({POWER}|(?<!<msup>){FUNCTION})(?!<mo|</)", rf"\1{SPACE}", formula)
        return re.sub(rf"(?<=</mi>|</mn>)({FUNCTION}|{POWER})", rf"{SPACE}\1", formula)

    return MARKED.sub(mathml, page_html)
