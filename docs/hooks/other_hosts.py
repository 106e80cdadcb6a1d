"""No page loads anything from another host: the site works without a network."""

import re
from html.parser import HTMLParser
from pathlib import Path

from mkdocs.exceptions import PluginError

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""What a browser loads by itself, unlike the target of an <a>."""
ELSEWHERE = re.compile(r"(?:https?:)?//")


class Loads(HTMLParser):
    """The addresses of other hosts that a page loads from."""

    def __init__(self):
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag, attrs):
        address = dict(attrs).get(LOADED.get(tag, ""))
        if address and ELSEWHERE.match(address):
            self.found.append(address)


def on_post_build(*, config):
    site = Path(config.site_dir)
    found: list[str] = []
    for path in site.rglob("*.html"):
        page = Loads()
        page.feed(path.read_text())
        found += [f"{path.relative_to(site)} loads {address}" for address in page.found]
    for path in site.rglob("*.css"):
        addresses = re.findall(
            r"""(?:url\(|@import\s+)["']?((?:https?:)?//[^"')]+)""", path.read_text()
        )
        found += [f"{path.relative_to(site)} loads {address}" for address in addresses]
    if found:
        raise PluginError("a page loads from another host:\n" + "\n".join(found))
