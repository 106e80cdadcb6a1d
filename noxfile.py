"""The daily tasks, each in an environment of its own: `nox -s tests`; `nox -l` lists them.

In an environment that has [dev], each is the one command that it shows.
"""

import nox

nox.options.sessions = ["tests", "lint"]
nox.options.reuse_existing_virtualenvs = True


@nox.session
def tests(session: nox.Session) -> None:
    """Run the tests; arguments after -- go to pytest."""
    session.install("-e", ".[dev]")
    session.run("pytest", *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Check format, style and types."""
    session.install("-e", ".[dev]")
    session.run("ruff", "format", "--check", ".")
    session.run("ruff", "check", ".")
    session.run("pyright")


@nox.session
def tidy(session: nox.Session) -> None:
    """Mend format and style, and write the tables of docs/data.md anew."""
    session.install("-e", ".[dev]")
    session.run("ruff", "format", ".")
    session.run("ruff", "check", "--fix", ".")
    session.run("python", "tests/storage/test_schema.py")


@nox.session
def site(session: nox.Session) -> None:
    """Build the site: open site/index.html."""
    session.install(".[docs]")
    session.run("mkdocs", "build", "--strict")


@nox.session
def notebooks(session: nox.Session) -> None:
    """Run the notebooks, and keep what they show."""
    session.install("-e", ".[dev]")
    session.run("python", "notebooks/run.py")


@nox.session
def build(session: nox.Session) -> None:
    """Build wheel and source distribution in dist/, and try both."""
    session.run(".ci/build", "dist", external=True)


@nox.session
def matrix(session: nox.Session) -> None:
    """Try every Python, by a few tests, both ends of the dependencies, and poor machines."""
    session.run("python", ".ci/matrix.py", *session.posargs)


@nox.session
def readme(session: nox.Session) -> None:
    """Compute every number that the README quotes: half an hour."""
    session.install(".[bench]")
    session.run("python", "benchmarks/verify_readme.py", "--readme", *session.posargs)


@nox.session
def claims(session: nox.Session) -> None:
    """Compute every number that docs/claims.md lists: an hour and a half."""
    session.install(".[bench,dev]")
    session.run("python", "benchmarks/verify_readme.py", *session.posargs)


@nox.session
def ci(session: nox.Session) -> None:
    """All that a change must pass: all tests on the newest Python, and a part on the oldest."""
    session.run(".ci/run", *session.posargs, external=True)
