"""The reference: every public name with its docstring, a page for each room of the package.

Public are the names that `walker_jax/__init__.pyi` lists, and those of the modules that it lists.
Below a function is the class that it returns, if that has no public name. On all other pages, a
public name in code, such as `wj.stride` or `wj.systems.HenonMap`, becomes a link to its place in
the reference.
"""

import ast
import re
from pathlib import Path

from mkdocs.structure.files import File

PACKAGE = Path(__file__).parent.parent.parent / "walker_jax"
TITLES = {"checks": "errors", "fractals": "fractal sets"}
"""Titles of pages that are not the room's own name."""


def names_in(stub: Path) -> dict[str, str]:
    """The module of each name that a stub imports."""
    return {
        name.name: statement.module or ""
        for statement in ast.parse(stub.read_text()).body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
    }


NAMES = names_in(PACKAGE / "__init__.pyi")
BESIDE = sorted(name for name, module in NAMES.items() if module == "walker_jax")
"""Rooms that users import as they are: `from walker_jax import figures`."""


def names_beside(room: str) -> dict[str, str]:
    """The names of a room that is imported as it is, and the module of each."""
    inits = PACKAGE / room / "__init__.pyi", PACKAGE / room / "__init__.py"
    path, own = next(one for one in inits if one.exists()), f"walker_jax.{room}"
    found = {name: at for name, at in names_in(path).items() if at.startswith(f"{own}.")}
    defined = ast.FunctionDef, ast.ClassDef
    return found | {one.name: own for one in statements_of(own) if isinstance(one, defined)}


def statements_of(module: str) -> list[ast.stmt]:
    """The source of a module."""
    path = PACKAGE.parent / module.replace(".", "/")
    paths = path.with_suffix(".py"), path / "__init__.py"
    return next((ast.parse(one.read_text()).body for one in paths if one.exists()), [])


SHOWN = {f"wj.{name}": f"{module}.{name}" for name, module in NAMES.items() if name not in BESIDE}
SHOWN |= {
    f"wj.{room}.{name}": f"{module}.{name}"
    for room in BESIDE
    for name, module in names_beside(room).items()
}
"""Each public name, and the place where it is defined."""


def lead_of(room: str) -> str:
    """The first paragraph that the room says of itself."""
    path = PACKAGE / room / "__init__.py" if (PACKAGE / room).is_dir() else PACKAGE / f"{room}.py"
    return (ast.get_docstring(ast.parse(path.read_text())) or "").split("\n\n")[0]


def class_at(place: str) -> ast.ClassDef | None:
    """The source of a class, None if the place holds another thing."""
    module, _, name = place.rpartition(".")
    found = (s for s in statements_of(module) if isinstance(s, ast.ClassDef) and s.name == name)
    return next(found, None)


def classes_returned(place: str) -> dict[str, str]:
    """The classes of results that a function returns, and where each is defined."""
    module, _, function = place.rpartition(".")
    statements = statements_of(module)
    returns = [
        one.returns
        for one in statements
        if isinstance(one, ast.FunctionDef) and one.name == function and one.returns
    ]
    named = {node.id for one in returns for node in ast.walk(one) if isinstance(node, ast.Name)}
    homes = {
        name.name: one.module or ""
        for one in statements
        if isinstance(one, ast.ImportFrom)
        for name in one.names
    }
    places = {name: f"{homes.get(name, module)}.{name}" for name in sorted(named)}
    return {name: place for name, place in places.items() if class_at(place)}


RESULTS = {
    name: at
    for place in SHOWN.values()
    for name, at in classes_returned(place).items()
    if at not in SHOWN.values()
}
"""Classes of results without public names."""


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
    entries = {name: at for name, at in (SHOWN | RESULTS).items() if at.split(".")[1] == room}
    title = TITLES.get(room, room).capitalize()
    parts = [
        f"# {title}",
        lead_of(room),
        f"*In the module `walker_jax.{room}`.*",
    ]
    functions_first = sorted(entries.items(), key=lambda entry: class_at(entry[1]) is not None)
    for shown, place in functions_first:
        options = {"heading": shown, "toc_label": shown, **options_of(place)}
        lines = [f"::: {place}", "    options:", *(f"      {k}: {v}" for k, v in options.items())]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def rooms() -> list[str]:
    """Those with public names, in the order of the alphabet."""
    return sorted({place.split(".")[1] for place in SHOWN.values()})


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
        return f"[{found[0]}][{SHOWN[found[1]]}]" if found[1] in SHOWN else found[0]

    parts = re.split(r"(^```.*?^```|^#.*?$)", markdown, flags=re.M | re.S)
    parts[::2] = [re.sub(r"(?<!\[)`(wj\.[\w.]+)(?:\([^`]*\))?`", link, part) for part in parts[::2]]
    return "".join(parts)
