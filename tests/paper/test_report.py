"""A page is one file, well formed, with its pictures in it."""

import base64
from html.parser import HTMLParser

from walker_jax.paper import report

VOID = {"meta", "link", "img"}


class Reader(HTMLParser):
    """What is in a page, and whether every element is closed in its turn."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        self.sources += [value or "" for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_a_page_is_well_formed_and_needs_nothing_else():
    png = bytes(range(256))
    blocks = [
        report.picture("Figure 1. A <step>", png, "Angles & rates"),
        report.table("Numbers", ("what", "ours"), [("θ < π/4", "0.7"), ("γ", "differs")]),
    ]
    read = Reader(report.page("A & B", "by C", "intro <1>", blocks))
    assert read.open == []
    assert all(source.startswith("data:") for source in read.sources)
    assert base64.b64decode(read.sources[-1].partition(",")[2]) == png
    for text in ("A & B", "intro <1>", "Figure 1. A <step>", "Angles & rates", "θ < π/4"):
        assert text in read.text


def test_cells_that_differ_stand_out():
    table = report.table("", ("a", "b"), [("1", "differs")])
    assert '<td data-head="b" class="mark">differs</td>' in table
    assert '<td data-head="a">1</td>' in table
