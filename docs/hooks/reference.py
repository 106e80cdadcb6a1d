"""The reference: every public name with its docstring, a page for each room of the package.

Public are the names that `walker_jax/__init__.pyi` lists. On all other pages, a public name in
code, such as `wj.stride`, becomes a link to its place in the reference.
"""

import ast
import re
from pathlib import Path

from mkdocs.structure.files import File

PACKAGE = Path(__file__).parent.parent.parent / "walker_jax"
BESIDE = {
    "figures": "walker_jax.figures",
    "kernels": "walker_jax.kernels",
    "multibody": "walker_jax.multibody",
}
"""Rooms that users import as they are: `from walker_jax import figures`."""
TITLES = {"checks": "errors", "fractals": "fractal sets"}
"""Titles of pages that are not the room's own name."""


def public_names() -> dict[str, str]:
    """The module of each public name."""
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    return {
        name.name: statement.module or ""
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
    }


NAMES = public_names()
ROOM = {name: module.split(".")[1] for name, module in NAMES.items()}


def names_beside(room: str) -> dict[str, str]:
    """The names of a room that is imported as it is, and where each is defined."""
    inits = PACKAGE / room / "__init__.pyi", PACKAGE / room / "__init__.py"
    path = next((one for one in inits if one.exists()), PACKAGE / f"{room}.py")
    found: dict[str, str] = {}
    for statement in ast.parse(path.read_text()).body:
        if isinstance(statement, ast.ImportFrom) and f"walker_jax.{room}" in str(statement.module):
            found |= {name.name: f"{statement.module}.{name.name}" for name in statement.names}
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            found[statement.name] = f"walker_jax.{room}.{statement.name}"
    return found


def lead_of(room: str) -> str:
    """The first paragraph that the room says of itself."""
    path = PACKAGE / room / "__init__.py" if (PACKAGE / room).is_dir() else PACKAGE / f"{room}.py"
    return (ast.get_docstring(ast.parse(path.read_text())) or "").split("\n\n")[0]


def class_at(place: str) -> ast.ClassDef | None:
    """The source of a class, None if the place holds another thing."""
    module, _, name = place.rpartition(".")
    path = (PACKAGE.parent / module.replace(".", "/")).with_suffix(".py")
    statements = ast.parse(path.read_text()).body if path.exists() else []
    return next((s for s in statements if isinstance(s, ast.ClassDef) and s.name == name), None)


def options_of(place: str) -> dict[str, str]:
    """How a class is shown: results with all fields, and constructors before anything else."""
    found = class_at(place)
    if found is None:
        return {}
    if any(isinstance(base, ast.Name) and base.id == "NamedTuple" for base in found.bases):
        return {"show_if_no_docstring": "true"}  # also fields that need no sentence
    functions = [one for one in found.body if isinstance(one, ast.FunctionDef)]
    decorated = lambda one, name: any(getattr(d, "id", "") == name for d in one.decorator_list)
    order = [
        *(one.name for one in functions if decorated(one, "classmethod")),
        *(one.name for one in functions if not one.decorator_list),
        *(one.name for one in functions if decorated(one, "property")),
        *(one.target.id for one in found.body if isinstance(one, ast.AnnAssign)),  # fields
    ]
    if not any(decorated(one, "classmethod") for one in functions):
        return {}
    members = [name for name in order if not name.startswith("_")]
    return {
        "members": f"[{', '.join(members)}]",
        "group_by_category": "false",
        "merge_init_into_class": "true",
    }


def page_of(room: str) -> str:
    """The page of a room in Markdown."""
    entries = {f"wj.{name}": f"{NAMES[name]}.{name}" for name in NAMES if ROOM[name] == room}
    if room in BESIDE:
        entries |= {f"{room}.{name}": place for name, place in names_beside(room).items()}
    title = TITLES.get(room, room).capitalize()
    parts = [
        f"# {title}",
        lead_of(room),
        f"*In the module `{BESIDE.get(room, f'walker_jax.{room}')}`.*",
    ]
    functions_first = sorted(entries.items(), key=lambda entry: class_at(entry[1]) is not None)
    for shown, place in functions_first:
        options = {"heading": shown, "toc_label": shown, **options_of(place)}
        lines = [f"::: {place}", "    options:", *(f"      {k}: {v}" for k, v in options.items())]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def rooms() -> list[str]:
    """Those with public names, in the order of the alphabet."""
    return sorted({*ROOM.values(), *BESIDE})


def on_config(config):
    """Give each room its place in the navigation, after the pages that are listed there."""
    for entry in config.nav:
        if "Reference" in entry:
            titles = {room: TITLES.get(room, room).capitalize() for room in rooms()}
            entry["Reference"] += [{titles[room]: f"reference/{room}.md"} for room in rooms()]
    return config


def on_files(files, *, config):
    for room in rooms():
        files.append(File.generated(config, f"reference/{room}.md", content=page_of(room)))
    return files


def on_page_markdown(markdown, *, page, config, files):
    """Link the public names of the package."""
    if page.file.src_uri.startswith("reference/"):
        return markdown

    def link(found: re.Match) -> str:
        name = found[1]
        return f"[{found[0]}][{NAMES[name]}.{name}]" if name in NAMES else found[0]

    parts = re.split(r"(^```.*?^```|^#.*?$)", markdown, flags=re.M | re.S)
    parts[::2] = [re.sub(r"(?<!\[)`wj\.(\w+)(?:\([^`]*\))?`", link, part) for part in parts[::2]]
    return "".join(parts)
