"""Does what the pages print still come out?

    python benchmarks/pages.py                 # README.md, docs, notebooks/README.md: half an hour
    python benchmarks/pages.py quickstart fit  # these pages
    python benchmarks/pages.py --list          # what would run, and what would not

Each page begins in an empty folder, and without compiled programs unless `WALKER_JAX_CACHE_DIR` has
them. Its blocks run in their order as they are printed: Python in one process for each page,
commands one after the other, also those of tables and in the text. The files that they name are
there: those of docs/robots, and blocks of Python that begin with their name, `# torque.py`. A block
whose comment before it begins with `not run` does not run.

What a block of Python prints is compared with the comments behind its lines of `print`, or with the
block of text that follows it: words must be the same, numbers equal to their printed digits. The
exit code is 1 if something differs or fails, or if a block took over six seconds of processor time
and nothing around it says how long it takes.
"""

import argparse
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
LONG = 6.0
"""Seconds of processor time that a page must tell of."""
NOISE = 1e-9
"""Numbers below this are rounding errors of something that is zero: both must be below."""
HEAVY = "quickstart walkers README gallery results networks viability cli".split()
"""Pages that take longest, which come last."""
NEVER = (
    *("pip install", "pytest", "jupyter", "python ", "walker-jax --install"),
    "walker-jax fit walk.csv",  # a recording that a reader has
)
"""Commands that change the reader's environment, or are tested elsewhere."""
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d[\d,]*)?\.?\d+\.?(?:e[-+]?\d+)?")
FENCE = re.compile(
    r"(?:<!-- ([^>]*) -->\n)?^```(\w+)\n(.*?)^```\n(?:\n```text\n(?!>>> )(.*?)^```)?", re.M | re.S
)
"""The comment before a block, its language, its lines, and what it prints."""
DRIVER = """
import contextlib, io, json, sys, time
names, replies = {"__name__": "page"}, sys.stdout
for line in sys.stdin:
    text, failure, began = io.StringIO(), None, (time.perf_counter(), time.process_time())
    with contextlib.redirect_stdout(text):
        try:
            exec(compile(json.loads(line), "block", "exec"), names)
        except BaseException as error:
            failure = f"{type(error).__name__}: {error}"[:300]
    spent = time.perf_counter() - began[0], time.process_time() - began[1]
    print(json.dumps([text.getvalue(), failure, *spent]), file=replies, flush=True)
"""


class Block(NamedTuple):
    """Something that a page prints to be run."""

    line: int
    kind: str
    """`python`, `command` or `not run`."""
    source: str
    expected: str | None
    """What comes out, if the page prints that."""
    told: bool
    """Whether the page tells how long it takes."""

    def difference(self, printed: str) -> str | None:
        """Return how what came out differs from what the page prints; None if it does not."""
        if self.expected is None:
            return None
        words = [" ".join(NUMBER.sub("#", text).split()) for text in (self.expected, printed)]
        if words[0] != words[1]:
            return f"printed {printed.strip()[:300]!r}"
        pairs = zip(NUMBER.findall(self.expected), NUMBER.findall(printed), strict=True)
        return next((f"{new} for {old}" for old, new in pairs if not same_number(old, new)), None)


class Made(NamedTuple):
    """What a block gave."""

    printed: str
    failure: str | None
    seconds: float
    processor: float


def same_number(printed: str, given: str) -> bool:
    """Whether a number is equal to a printed one, to the digits of that."""
    digits, _, power = printed.replace(",", "").partition("e")
    unit = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    value, other = (float(text.replace(",", "")) for text in (printed, given))
    return max(abs(value), abs(other)) < NOISE or abs(value - other) <= 0.5 * unit * (1 + 1e-9)


def read_blocks(page: Path) -> list[Block]:
    """Return the blocks of a page, and the commands in its text, in their order."""
    text = page.read_text()
    found = []
    for match in FENCE.finditer(text):
        line = text.count("\n", 0, match.start(3)) + 1
        told = tells_time(text, match.start(), match.end())
        for kind, source, expected in read_fence(*match.groups()):
            found.append((match.start(), Block(line, kind, source, expected, told)))
    plain = FENCE.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    for match in re.finditer(r"`([^`]+)`", plain):
        words = match[1].split()
        row = page.name == "cli.md" and plain[: match.start()].endswith("\n| ")
        if row and re.fullmatch(r"[a-z]+( .*)?", match[1]):
            words = ["walker-jax", *words]
        if words[0] == "walker-jax" and len(words) > 2 - row and words[1] != "...":
            line = text.count("\n", 0, match.start()) + 1
            told = tells_time(text, match.start(), match.end())
            found.append((match.start(), Block(line, *read_command(" ".join(words)), None, told)))
    return [block for _, block in sorted(found, key=lambda pair: pair[0])]


def read_fence(
    comment: str | None, language: str, source: str, output: str | None
) -> Iterator[tuple[str, str, str | None]]:
    """Yield kind, source and expected text of what a block between fences asks to be run."""
    if (comment or "").startswith("not run"):
        yield "not run", comment or "", None
    elif language == "python":
        printed = re.findall(r"^print\(.*\)  # (.*)$", source, re.M)
        yield "python", source, output or "\n".join(printed) or None
    elif language == "text" and source.startswith(">>> "):
        first, rest = source.split("\n", 1)
        yield "python", first.removeprefix(">>> "), rest
    elif language in ("bash", "console"):
        lines = re.sub(r"\\\n", " ", source).splitlines()
        commands = [one.removeprefix("$ ") for one in lines if one and not one.startswith("#")]
        for one in commands:  # the last of which prints the text below
            yield *read_command(one), output if one is commands[-1] else None


def read_command(command: str) -> tuple[str, str]:
    """Return the kind of a command, and the command without comment and installations."""
    command = re.sub(r"\s+#.*$", "", re.sub(r"^pip install .*? && ", "", command))
    return ("not run" if command.startswith(NEVER) else "command"), command


def tells_time(text: str, start: int, end: int) -> bool:
    """Whether the block, a paragraph beside it, or a sentence on the page tells how long."""
    before = text[:start].rstrip().rpartition("\n\n")[2]
    after = text[end:].lstrip().partition("\n\n")[0]
    page = " ".join(re.findall(r"on this page\s[^.]*", text))
    beside = before + text[start:end] + after + page
    return bool(re.search(r"second|minute|hour|\d s\b", beside))


class Run:
    """A page's folder and its process of Python."""

    def __init__(self, folder: Path):
        self.folder, self.started = folder, []
        paths = [str(Path(sys.executable).parent), os.environ["PATH"]]
        cache = {"WALKER_JAX_CACHE_DIR": str(folder / ".cache"), "MPLBACKEND": "agg"}
        self.around = {**cache, **os.environ, "PATH": os.pathsep.join(paths)}
        self.python: subprocess.Popen | None = None

    def make(self, block: Block) -> Made:
        """Run a block, with the files that it names."""
        for name, text in FILES.items():
            named = name in block.source or f"from {Path(name).stem} import" in block.source
            if named and not (self.folder / name).exists():
                (self.folder / name).write_text(text)
        return (self.run_python if block.kind == "python" else self.run_command)(block.source)

    def run_python(self, source: str) -> Made:
        if self.python is None:
            self.python = self.start([sys.executable, "-c", DRIVER], subprocess.PIPE)
        assert self.python.stdin and self.python.stdout
        self.python.stdin.write(json.dumps(source) + "\n")
        self.python.stdin.flush()
        return Made(*json.loads(self.python.stdout.readline()))

    def run_command(self, command: str) -> Made:
        began, spent = time.perf_counter(), processor_time()
        stays = command.startswith("walker-jax explore") or command.endswith("&")
        process = self.start(["bash", "-c", "exec " * stays + command.removesuffix("&")], None)
        assert process.stdout
        if stays:  # a server, until it tells its address
            out = next((line for line in process.stdout if "://" in line), "")
            failure = None if out else "no address"
        else:
            out = process.stdout.read()
            last = (out.strip().splitlines() or [""])[-1]
            failure = f"exit code {process.returncode}: {last}" if process.wait() else None
        return Made(out, failure, time.perf_counter() - began, processor_time() - spent)

    def start(self, command: list[str], stdin: int | None) -> subprocess.Popen:
        streams = {"stdin": stdin, "stdout": subprocess.PIPE}
        streams["stderr"] = None if stdin else subprocess.STDOUT
        place = {"cwd": self.folder, "env": self.around, "text": True, "start_new_session": True}
        self.started.append(subprocess.Popen(command, **streams, **place))
        return self.started[-1]

    def end(self) -> None:
        """End what still runs."""
        for process in self.started:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
            process.communicate()


def processor_time() -> float:
    """Return the seconds of processors that ended children took."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def check(block: Block, made: Made) -> str:
    """Say in words whether a block gave what the page says: `equal`, `runs`, or what is wrong."""
    silent = "takes long, and the page does not say so"
    silent = silent if made.processor > LONG and not block.told else None
    well = "runs" if block.expected is None else "equal"
    return made.failure or block.difference(made.printed) or silent or well


def run_page(page: Path) -> list[str]:
    """Run a page, print its part of the table, and return what is wrong."""
    wrong, commands = [], set()
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder))
        try:
            for block in read_blocks(page):
                if block.kind != "not run" and block.source not in commands:
                    commands.add(block.source)
                    made = run.make(block)
                    said, place = check(block, made), f"{page.name}:{block.line}"
                    wrong += [] if said in ("equal", "runs") else [f"{place} {said}"]
                    seconds = f"{made.seconds:6.1f} s {made.processor:6.1f} s"
                    first = block.source.splitlines()[0][:60]
                    print(f"{place:26} {seconds}  {said:6} {first}", flush=True)
        finally:
            run.end()
    return wrong


def find_files() -> dict[str, str]:
    """Return the files that pages print or have beside them, by name."""
    beside = (path for path in (ROOT / "docs" / "robots").iterdir() if path.is_file())
    found = {path.name: path.read_text() for path in beside}
    for page in find_pages([]):
        for *_, source, _ in FENCE.findall(page.read_text()):
            if named := re.match(r"# (\w+\.py)\n", source):
                found.setdefault(named[1], source)
    return found


def find_pages(names: list[str]) -> list[Path]:
    """Return the pages of these names, or all, the heavy ones last."""
    docs = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "notebooks" / "README.md"]
    docs = [page for page in docs if page.stem not in ("claims", "numbers")]  # verify_readme.py's
    pages = sorted([ROOT / "README.md", *docs], key=lambda page: page.stem in HEAVY)
    return [page for page in pages if not names or page.stem in names]


FILES = find_files()

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Run what the pages print.")
    parser.add_argument("pages", nargs="*")
    parser.add_argument("--list", action="store_true")
    given = parser.parse_args()
    found = find_pages(given.pages)
    for page in found if given.list else ():
        for block in read_blocks(page):
            print(f"{page.name}:{block.line}", block.kind, block.source.splitlines()[0][:80])
    wrong = [] if given.list else [one for page in found for one in run_page(page)]
    print(*wrong, sep="\n")
    sys.exit(bool(wrong))
