"""Are the stored pictures those that the package draws today? Draws them anew.

    python benchmarks/pictures.py                       # all; hours, most of them for knees.png
    python benchmarks/pictures.py basin.png gallery.md  # these; for a page, all that it draws
    python benchmarks/pictures.py --look knees.png      # it stays as it is, after a look at it

docs/pictures.json keeps digests of each picture: of the colours, signs, words and layout that all
pictures share, of the lines that draw it, those of its benchmark too, and of itself. Where one of
them differs, a test of the gallery says that the picture is out of date. Notebooks keep their
pictures in themselves.
"""

import argparse
import ast
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import nbformat

from walker_jax.figures import layout, style, text

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / "benchmarks"
DOCS, KEPT = ROOT / "docs", ROOT / "docs" / "pictures.json"
BIPED = "figures.modes(wj.systems.SpringMassBiped()).figure.savefig('modes.png')"
COMMANDS = {
    "basin.png": "walker-jax basin --figure basin.png",
    "walk.gif": "walker-jax walk --animate walk.gif",
    "bifurcation.png": "walker-jax bifurcation --from 0.001 --to 0.02 --figure bifurcation.png",
    "robustness.png": "walker-jax robustness --from 0.0007 --to 0.0187 --count 19 "
    "--figure robustness.png",
    "round-foot.png": "walker-jax basin --walker round-foot --method direct "
    "--figure round-foot.png",
    "volume.png": "walker-jax basin --walker round-foot --slope 0.01 --theta 0 1.2 96 "
    "--sum -0.8 0.1 96 --phidot -2.4 0.6 96 --levels 2 --figure volume.png",
    "modes.png": f'python -c "import walker_jax as wj; from walker_jax import figures; {BIPED}"',
    "rough.gif": "python $BENCHMARKS/rough_film.py rough.gif",
    "knees.png": "python $BENCHMARKS/knees.py knees",
    "predictors.png": "python $BENCHMARKS/predictors.py measure && "
    "python $BENCHMARKS/predictors.py compare",
    "space.png": "python $BENCHMARKS/space.py --picture space.png",
    "scaling.png": "python $BENCHMARKS/scaling.py --printed --figure scaling.png",
    "capturability.png": "python $BENCHMARKS/viability.py --picture capturability.png",
    "explorer.gif": "python $BENCHMARKS/explorer_film.py explorer.gif",
}
COMMANDS |= dict.fromkeys(
    ("crisis.png", "leaves.png", "saddle.png"), "python $BENCHMARKS/transients.py --pictures ."
)
"""The command that draws each picture; $BENCHMARKS is this folder."""
SPRING = "spring.png"
PAGES = {
    page: re.findall(r'savefig\("(\w+\.png)"', (DOCS / page).read_text())
    for page in ("gallery.md", "charts.md")
}
PAGES["charts.md"][0] = "chart.png"  # its program saves it as SPRING
PAGES["gallery.md"] = [f"gallery/{name}" for name in PAGES["gallery.md"]]
"""The pictures that the programs of a page draw."""


def digest(text: str | bytes) -> str:
    """Return a short digest."""
    return hashlib.sha256(text if isinstance(text, bytes) else text.encode()).hexdigest()[:16]


def code_of(path: str) -> str:
    """Return the code of a module, without what documents it."""
    source = Path(path).read_text()
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str):
            for number in range(node.lineno - 1, node.end_lineno or node.lineno):
                lines[number] = ""
    return "\n".join(line for line in lines if line.strip() and not line.strip().startswith("#"))


def look() -> str:
    """Return a digest of the colours, signs, words and layout that all pictures share."""
    shared = repr({name: value for name, value in vars(style).items() if name.isupper()})
    return digest("\n".join([shared, *(code_of(str(one.__file__)) for one in (text, layout))]))


def programs(page: str) -> list[str]:
    """Return the Python programs of a page."""
    return re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.S)


def lines_of(name: str) -> str:
    """Return the lines that draw a picture, or all pictures of a notebook."""
    if name.endswith(".ipynb"):
        return "\n".join(c.source for c in read(name).cells if c.cell_type == "code")
    if name in COMMANDS:
        scripts = re.findall(r"\$BENCHMARKS/(\w+\.py)", COMMANDS[name])
        return "\n".join([COMMANDS[name], *((BENCHMARKS / one).read_text() for one in scripts)])
    (page,) = (page for page, pictures in PAGES.items() if name in pictures)
    file = SPRING if name == "chart.png" else Path(name).name
    (saved,) = (one for one in programs(page) if f'savefig("{file}"' in one)
    return saved


def content_of(name: str) -> bytes:
    """Return a picture, or the pictures of a notebook."""
    if not name.endswith(".ipynb"):
        return (DOCS / name).read_bytes()
    cells = (cell for cell in read(name).cells if cell.cell_type == "code")
    outputs = (one.get("data", {}).get("image/png", "") for c in cells for one in c.outputs)
    return "".join(outputs).encode()


def read(name: str) -> nbformat.NotebookNode:
    return nbformat.read(ROOT / name, as_version=4)


def digests_of(name: str) -> dict[str, str]:
    """Return the digests of a picture as it is."""
    return {"look": look(), "lines": digest(lines_of(name)), "itself": digest(content_of(name))}


def every_picture() -> list[str]:
    """Return all stored pictures of the pages, and the notebooks."""
    found = (one for kind in ("*.png", "*.gif", "*/*.png") for one in DOCS.glob(kind))
    notebooks = (one.relative_to(ROOT) for one in (ROOT / "notebooks").glob("*.ipynb"))
    return sorted(map(str, [*(one.relative_to(DOCS) for one in found), *notebooks]))


def out_of_date() -> dict[str, list[str]]:
    """Return the digests of each picture that are not those that were kept with it."""
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    found = {}
    for name in every_picture():
        now, then = digests_of(name), kept.get(name, {})
        if now != then:
            found[name] = [part for part in now if now[part] != then.get(part)]
    return found


def drawn_with(name: str) -> list[str]:
    """Return all pictures that a picture's command or page draws, or a page, with itself."""
    if name in COMMANDS:
        return [one for one, command in COMMANDS.items() if command == COMMANDS[name]]
    pages = (own for page, own in PAGES.items() if name == page or name in own)
    return next(pages, [name])


def draw(name: str) -> None:
    """Draw a picture, and all that its command or page draws, or those of a notebook."""
    if name.endswith(".ipynb"):
        subprocess.run([sys.executable, ROOT / "notebooks" / "run.py", ROOT / name], check=True)
    elif name in COMMANDS:
        with tempfile.TemporaryDirectory() as folder:
            paths = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
            paths |= {"PYTHONPATH": str(ROOT), "BENCHMARKS": str(BENCHMARKS)}
            run = {"shell": True, "cwd": folder, "env": os.environ | paths, "check": True}
            subprocess.run(COMMANDS[name], **run)
            for one in drawn_with(name):
                shutil.copy(Path(folder) / one, DOCS / one)
    else:
        page = name if name in PAGES else next(p for p, own in PAGES.items() if name in own)
        os.chdir(DOCS / "gallery" if page == "gallery.md" else DOCS)
        names: dict = {"__name__": "pictures"}
        for program in programs(page):
            exec(program, names)
        if page == "charts.md":
            os.replace(SPRING, "chart.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="pictures, pages or notebooks; by default, all")
    parser.add_argument("--look", action="store_true", help="keep them as they are")
    asked = parser.parse_args()
    done: set[str] = set()
    for name in asked.names or every_picture():
        if name in done:
            continue
        if not asked.look:
            draw(name)
        kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
        for one in [name] if asked.look and name not in PAGES else drawn_with(name):
            kept[one] = digests_of(one)
            done.add(one)
        KEPT.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
        print(name, flush=True)


if __name__ == "__main__":
    main()
