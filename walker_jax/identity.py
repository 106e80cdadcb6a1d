"""Is this the same code? One walk over it, for programs in memory and on disk, and for stores.

A program is made of functions as they are when they are traced, a stored result by the code that
computed it. Each is used again only for the same code, which reads the same values. What counts:

- of a function its code, defaults and closure, and the globals that it reads, those of modules too;
- of a class its bases and attributes; of what is made of functions, such as a bound method, these;
- of containers, arrays and plain values what they hold.

So it is with a user's own code; that of Python, of this package or installed counts by its name.
`Walk` is for programs of this process, `ForStores` for stores, and `program_cache.ReachedCode` for
programs on disk.
"""

import ast
import contextlib
import dis
import functools
import hashlib
import os
import re
import secrets
import sys
import types
from collections.abc import Hashable, Iterator, Sequence
from importlib.machinery import all_suffixes
from pathlib import Path
from typing import Any

import jax
import numpy as np

PACKAGE = __name__.partition(".")[0]
USED = "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy", "llvmlite"
"""Packages on whose version a program depends."""
KNOWN = {PACKAGE, *USED, *sys.builtin_module_names, "collections"}
"""Where code comes from that versions tell apart."""
FOLDER, STANDARD = Path(__file__).parent, Path(os.__file__).parent
PLAIN = {str, bytes, bool, int, float, complex, range, slice, type(None), type(...)}
"""Types of values that their words tell from all others."""
LARGEST = 2**16
"""Bytes of an array that a process compares by its values; a larger one is equal to itself."""
MOST = 4096
"""Codes, trees, modules and files of which it is remembered what they are, each."""
PARTS = "__wrapped__ __func__ __self__ fget func args keywords fun jvp fwd bwd".split()
"""Attributes that hold what something is made of, a function among them."""
DERIVED = set(
    "__dict__ __weakref__ __doc__ _abc_impl __annotations__ __module__ __annotate_func__ "
    "__annotations_cache__ __static_attributes__ __firstlineno__ __dataclass_params__ "
    "__parameters__ __orig_bases__".split()
)
"""Attributes of classes that Python derives from the others, or takes from the lines of a file."""
DEFINED = types.FunctionType | type
READING = "LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"
ADDRESS = re.compile(r" at 0x[0-9a-f]+")
token_of_process = secrets.token_hex()
"""It stands for what cannot be told from something else."""


class AsItIs:
    """A user's function, equal to another one of the same code that reads the same values.

    As a static argument of `jax.jit` it is traced again where what it reads has changed.
    """

    def __init__(self, function: Any, state: Hashable = None):
        self.function = function
        self.state = Walk().describe(function) if state is None else state

    def __call__(self, *args):
        return self.function(*args)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, AsItIs) and self.state == other.state

    def __hash__(self) -> int:
        return hash(self.state)


class Walk:
    """Describes code so that equal descriptions, within a process, are of the same code."""

    largest = LARGEST

    def __init__(self):
        self.found: list[Any] = []
        """Things with a description of their own, kept so that their ids stay their own."""
        self.numbers: dict[int, int] = {}

    def describe(self, *values: Any) -> tuple[Hashable, ...]:
        """The words of values, and then of all that these refer to, each thing once."""
        words = tuple(map(self.words, values))
        return words, *map(self.describe_found, self.found)  # to which more is added meanwhile

    def words(self, value: Any) -> Hashable:
        """A value in words, or the number of its description."""
        if type(value) in PLAIN:
            return None if value is None else (type(value).__name__, repr(value))
        if id(value) in self.numbers:
            return self.numbers[id(value)]
        if isinstance(value, types.CodeType):
            return words_of_code(value)
        if isinstance(value, types.CellType):
            with contextlib.suppress(ValueError):  # it may be empty
                return self.words(value.cell_contents)
            return ()
        if isinstance(value, tuple):
            kind = None if type(value) is tuple else self.words(type(value))
            return kind, *map(self.words, value)
        if type(value) in (set, frozenset):
            in_order = sorted(value, key=lambda one: ADDRESS.sub("", repr(one)))
            return "set", *map(self.words, in_order)
        if (values := values_in(value, self.largest)) is not None:
            return values
        self.found.append(value)
        return self.numbers.setdefault(id(value), len(self.found) - 1)

    def describe_found(self, value: Any) -> Hashable:
        if type(value) is list:
            return "list", *map(self.words, value)
        if type(value) in (dict, types.MappingProxyType):
            return "dict", *((self.words(key), self.words(value[key])) for key in value)
        if isinstance(value, types.FunctionType):
            return self.describe_function(value)
        if isinstance(value, type):
            return self.describe_class(value)
        name, parts = getattr(value, "__qualname__", None), parts_of(value)
        own = is_own(home_of(type(value)))
        if isinstance(value, types.ModuleType) or (name and not parts and not own):
            return self.name(value)
        if own or not parts:
            return self.describe_thing(value), *map(self.words, parts)
        return self.words(type(value)), name, *map(self.words, parts)

    def describe_function(self, function: types.FunctionType) -> Hashable:
        closure = self.words(function.__closure__)
        if not self.opens(function):
            return self.name(function), closure
        more = function.__defaults__, function.__kwdefaults__, vars(function) or None
        return self.describe_code(function), closure, *map(self.words, more)

    def describe_code(self, function: types.FunctionType) -> Hashable:
        read = ((name, self.words(value)) for name, value in globals_of(function).items())
        return words_of_code(function.__code__), *read

    def describe_class(self, kind: type) -> Hashable:
        if not self.opens(kind):
            return self.name(kind)
        named = ((one, self.words(vars(kind)[one])) for one in sorted(vars(kind).keys() - DERIVED))
        return self.name(kind), self.words(kind.__bases__), *named

    def opens(self, definition: Any) -> bool:
        """Whether more counts of a definition than its name."""
        return is_own(home_of(definition))

    def name(self, definition: Any) -> Hashable:
        """The name by which a definition counts: within a process it is itself."""
        return AsItIs(definition, id(definition))

    def describe_thing(self, value: Any) -> Hashable:
        """Within a process a thing is itself, or what it says that it is equal to."""
        alike = type(value).__eq__ is not object.__eq__
        with contextlib.suppress(Exception):  # whatever its class raises
            hash(value)
            return self.words(type(value)), value if alike else self.name(value)
        return self.words(type(value)), self.name(value)


def parts_of(value: Any) -> list[Any]:
    """The parts of something that is made of functions; none of anything else."""
    parts = [getattr(value, name, None) for name in PARTS]
    made = any(part is not None for part in parts) and any(map(callable, (value, *parts)))
    return parts if made else []


def values_in(value: Any, largest: int) -> Hashable:
    """The values of an array; None for anything else, and for a larger one."""
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        with contextlib.suppress(TypeError):  # of a tracer, or of a key
            if value.dtype != object and value.nbytes <= largest:
                return str(value.dtype), value.shape, hash_content(np.asarray(value).tobytes())
    return None


def hash_content(content: Any) -> str:
    content = content if isinstance(content, bytes) else repr(content).encode()
    return hashlib.sha256(content).hexdigest()


@functools.lru_cache(MOST)
def words_of_code(code: types.CodeType) -> str:
    """A hash of what a code does, wherever it stands in its file."""
    names = code.co_qualname, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    words = code.co_code, code.co_exceptiontable, names, counts, Walk().words(code.co_consts)
    return hash_content(words)


def globals_of(function: types.FunctionType) -> dict[str, Any]:
    """Values that a function reads by the names around it, and within modules among these.

    What is installed does not change. Of this package's own names those in lower case do.
    """
    found, own, inside = {}, is_own(home_of(function)), names_used(function.__code__)
    read = names_used(function.__code__, *READING) if own else inside
    spaces = [("", function.__globals__, read)]
    for place, space, names in spaces:
        for name, value in ((one, space[one]) for one in names if one in space):
            if isinstance(value, types.ModuleType):
                changes = is_own(value) or top_of(value) == PACKAGE
                if changes and all(vars(value) is not one for _, one, _ in spaces):
                    spaces.append((f"{place}{name}.", vars(value), inside))
            elif own or name.isupper() or isinstance(value, DEFINED) or parts_of(value):
                found[f"{place}{name}"] = value
    return found


@functools.lru_cache(MOST)
def names_used(code: types.CodeType, *how: str) -> list[str]:
    """The names that a code and those within it use, by some instructions or by any."""
    names = set(code.co_names)
    if how:
        names = {one.argval for one in dis.get_instructions(code) if one.opname in how}
    inner = (one for one in code.co_consts if isinstance(one, types.CodeType))
    return sorted(names.union(*(names_used(one, *how) for one in inner)))


def home_of(definition: Any) -> types.ModuleType | None:
    """The module of a definition; of a compiled package that names modules freely, the package."""
    if isinstance(definition, types.ModuleType):
        return definition
    name = getattr(definition, "__module__", None)
    if isinstance(definition, types.FunctionType):  # a decorator's has the names of another one
        name = definition.__globals__.get("__name__")
    return sys.modules.get(str(name)) or sys.modules.get(str(name).partition(".")[0])


def top_of(home: types.ModuleType | None) -> str:
    """The package that a module is in."""
    return getattr(home, "__name__", "").partition(".")[0]


def file_of(home: types.ModuleType | None) -> Path | None:
    """The file of a module's code, if there is one."""
    path = Path(str(getattr(home, "__file__", None)))
    return path if path.name.endswith((*all_suffixes(),)) and path.is_file() else None


def root_of(home: types.ModuleType, path: Path) -> Path:
    """The folder in which a module of this file is, or the package that it is in."""
    spec = getattr(home, "__spec__", None)
    name = home.__name__ if spec is None else spec.name  # that of a program is __main__
    depth = name.count(".") + (path.name == "__init__.py")
    return path.parents[min(depth, len(path.parents) - 1)]


@functools.lru_cache(MOST)
def is_own(home: types.ModuleType | None) -> bool:
    """Whether a module is of a user's own: not known, and not installed."""
    path = file_of(home)
    installed = home is not None and path is not None and holds_packages(root_of(home, path))
    return not is_known(home) and not installed


def is_known(home: types.ModuleType | None) -> bool:
    """Whether a module is of this package, of one that it uses, or of Python."""
    path = file_of(home)
    return top_of(home) in KNOWN or (path is not None and is_known_file(path))


def is_known_file(path: Path) -> bool:
    """Whether a file is of this package or of the standard library."""
    if path.is_relative_to(STANDARD):
        return path.relative_to(STANDARD).parts[0] not in ("site-packages", "dist-packages")
    return path.is_relative_to(FOLDER)


@functools.cache
def holds_packages(folder: Path) -> bool:
    """Whether packages are installed in a folder: they are not of one project."""
    return folder == STANDARD or any(folder.glob("*.dist-info"))


def code_fingerprint(kind: type, parts: tuple = ()) -> str:
    """A hash of the code of a system's class, and of other parts of it, such as the function of a
    map; empty for a class of the package without them.

    It covers the files of the class and of its bases, and what these import from the same folder or
    package, as they were when they were loaded. Where a class has no file, it covers its functions
    and what they use. Data that the code reads from other files is not covered.
    """
    walk = ForStores(kind)
    if not walk.bases and not parts:
        return ""
    described = walk.describe(*walk.bases, *parts)
    return hash_content([described, sorted(walk.sources.items())])[:16]  # alike once in 2^64


class ForStores(Walk):
    """Describes code for other processes: its files, as they were loaded; what it is without."""

    largest = sys.maxsize

    def __init__(self, kind: type = object):
        super().__init__()
        self.bases = [one for one in kind.__mro__ if not is_known(home_of(one))]
        self.sources: dict[str, bytes] = {}
        """Contents of files, by their paths from the folder in which their module or package is."""
        for one in self.bases:
            self.add_file_of(one)

    def opens(self, definition: Any) -> bool:
        return super().opens(definition) or definition in self.bases

    def name(self, definition: Any) -> Hashable:
        self.add_file_of(definition)
        name = getattr(definition, "__qualname__", None)
        return name, getattr(home_of(definition), "__name__", None)

    def describe_code(self, function: types.FunctionType) -> Hashable:
        if self.add_file_of(function):
            return self.name(function)
        for name in names_used(function.__code__, "IMPORT_NAME"):
            for path in located(Path.cwd(), name.split(".")):
                self.add_file(path, Path.cwd())
        return super().describe_code(function)

    def describe_class(self, kind: type) -> Hashable:
        """One that a function makes may hold what is in no file."""
        in_file = "<locals>" not in kind.__qualname__ and self.add_file_of(kind)
        return self.name(kind) if in_file else super().describe_class(kind)

    def describe_thing(self, value: Any) -> Hashable:
        """As pickle does. What cannot be pickled is equal to nothing in another process."""
        try:
            return self.words(value.__reduce_ex__(2))
        except Exception:  # whatever its class raises
            return token_of_process, id(value)

    def add_file_of(self, definition: Any) -> bool:
        """Add the file of a definition that is looked at; whether there is one."""
        home = home_of(definition)
        path = file_of(home) if self.opens(definition) else None
        if home is not None and path is not None:
            self.add_file(path, root_of(home, path))
        return path is not None

    def add_file(self, path: Path, root: Path) -> None:
        """Add a file, and what it imports from below the root; if installed, of its package."""
        name, own = path.relative_to(root).as_posix(), path.relative_to(root).with_suffix("").parts
        if name in self.sources or is_known_file(path):
            return
        self.sources[name] = source = read_loaded(path)
        imports = imports_in(source) if path.suffix == ".py" else []
        for level, words in [(0, own), *imports]:  # to import a module is to import its packages
            base = path.parents[level - 1] if level else root
            within = level > 0 or words[0] == own[0] or not holds_packages(root)
            if within and base.is_relative_to(root):
                for other in located(base, words):
                    self.add_file(other, root)


kept: dict[Path, tuple[object, bytes]] = {}
"""Contents of files, and what stood for their modules then: a file in use may be edited."""


def read_loaded(path: Path) -> bytes:
    """The content of a module's file when that was loaded last, or at the first call after that."""
    modules = ((str(getattr(one, "__file__", "")), one) for one in [*sys.modules.values()])
    same = (one for file, one in modules if file.endswith(path.name) and Path(file) == path)
    module = next(same, None)
    loaded = getattr(module, "__spec__", None) or module  # to load it anew makes another
    if loaded is None or path not in kept or kept[path][0] is not loaded:
        kept[path] = loaded, path.read_bytes()
    return kept[path][1]


@functools.lru_cache(MOST)
def imports_in(source: bytes) -> list[tuple[int, Sequence[str]]]:
    """Imports of a program, anywhere in it: the dots before a name, and its words."""
    found: list[tuple[int, Sequence[str]]] = []
    with contextlib.suppress(SyntaxError, ValueError):  # it cannot be imported either
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                found += [(0, one.name.split(".")) for one in node.names]
            elif isinstance(node, ast.ImportFrom):
                stem = node.module.split(".") if node.module else []
                found += [(node.level, [*stem, one.name]) for one in node.names]
    return found


def located(folder: Path, words: Sequence[str]) -> Iterator[Path]:
    """Files that are run to import a name from a folder; its last words may be within a module."""
    for word in words:
        for path in (folder / word / "__init__.py", folder / f"{word}.py"):
            if path.is_file():
                yield path
                break
        folder /= word
