"""Pages whose text stands elsewhere in the repository, and the links between those and docs/."""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent.parent
PAGES = {
    "changelog.md": "CHANGELOG.md",
    "contributing.md": "CONTRIBUTING.md",
    "security.md": "SECURITY.md",
    "notebooks/index.md": "notebooks/README.md",
    "speed.md": "benchmarks/README.md",
}
"""Pages of the site, and the files that they show."""
PLACES = {source: page for page, source in PAGES.items()} | {"README.md": "index.md"}
"""Where the site has what stands at a path of the repository outside docs/."""


def on_files(files, *, config):
    for page, source in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text()))
    return files


def on_page_markdown(markdown, *, page, config, files):
    """Make links to files lead to the pages that show them."""
    own = page.file.src_uri
    place_of_own = own if own.startswith("notebooks/") else f"docs/{own}"
    source = ROOT / PAGES.get(own, place_of_own)

    def lead(link: re.Match) -> str:
        target, anchor = link[1], link[2] or ""
        if "://" in target:
            return link[0]
        path = (source.parent / target).resolve().relative_to(ROOT).as_posix()
        place = PLACES.get(path) or re.sub(r"\.ipynb$", ".md", path.removeprefix("docs/"))
        up = "../" * page.file.src_uri.count("/")
        return f"]({up}{place}{anchor})"

    return re.sub(r"\]\(([^)#\s]+)(#[^)]*)?\)", lead, markdown)
