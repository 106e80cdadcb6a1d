"""`walker-jax fit`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.commands import command
from walker_jax.cli.options import (
    Choice,
    Group,
    argument,
    named,
    number,
    option,
    underscored,
    whole,
)
from walker_jax.refusals import WrongUse


class Recorded(Group, theme="Recordings"):
    """The file, and the meaning of its columns."""

    file: Path = argument("FILE", "Recordings: .csv, .parquet, .nc or .mat.")
    column: dict[str, str] = named(
        "A coordinate and its column (default: all, by their own names).", "COLUMN"
    )
    unit: dict[str, Any] = named("Unit of a coordinate or of time: deg, ms, or a size.", "UNIT")
    time: str = option("time", "Column of times.", "--time")
    strikes: str | None = option(None, "Column that changes at each heel strike (default: found).")
    experiment: str | None = option(None, "Column that numbers experiments.")

    def read(self) -> Any:
        """Read the recordings."""
        how: Any = {"time": self.time, "units": self.unit, "strikes": self.strikes}
        return wj.read_recordings(self.file, self.column or None, experiment=self.experiment, **how)


class How(Group, theme="Fit"):
    """The parameters, and what is known of them and of the noise."""

    parameters: tuple[str, ...] = option(
        (), "A parameter to fit; may be given again.", "--parameters", metavar="NAME", multiple=True
    )
    noise: dict[str, float] = named(
        "Standard deviation of a column, or of time (default: found).", "VALUE"
    )
    shooting: str = option(
        "multiple",
        "Starts of steps: free, or linked by the impact.",
        type=Choice("multiple", "single"),
    )
    loss: str = option(
        "linear", "The others are for outliers.", type=Choice("linear", "soft_l1", "cauchy")
    )
    skip: float = number(0.0, "Leave out samples so soon after a heel strike.", least=0)
    bootstrap: int = whole(0, "Fits to resampled steps, for intervals.", least=0)
    seed: int = whole(0, "Seed of random numbers.", least=0)

    def settings(self) -> dict[str, Any]:
        """Return the arguments of the library's `fit`."""
        if not self.parameters:
            raise WrongUse("--parameters must name one parameter or more, not none")
        names = {"parameters": [*map(underscored, self.parameters)], "noise": self.noise}
        others = ("shooting", "loss", "skip", "bootstrap", "seed")
        return names | {name: getattr(self, name) for name in others}


@command(
    *(Recorded, How, Output(Path("fit.zarr"))),
    examples=(
        "fit walk.csv --slope 0.01 --parameters slope --column theta=stance --unit theta=deg",
        "fit walk.csv --walker point-foot --slope 0.01 --parameters foot-mass --strikes leg",
    ),
    time="Half a minute, most of it compiling.",
)
def fit(walker: "wj.System", recorded: Recorded, how: How, output: Output) -> None:
    """Fit parameters of a walker to recordings of its steps, with errors.

    The walker's own values are the first guesses. Times and angles are in the units of the walker:
    give the sizes of other units by --unit.
    """
    from walker_jax.identity import sha256_of

    given, recordings = how.settings(), recorded.read()
    numbers = [(one.time, one.strikes, *one.values.values()) for one in recordings]
    digest = sha256_of(b"".join(one.tobytes() for row in numbers for one in row))
    request = request_for("fit", walker, recordings=digest, **given)
    system: Any = walker
    data = output.produce(request, lambda: wj.fit(system, recordings, **given).data, "fit")
    rows = rows_of(data)
    answer = {
        "parameters": {name: {"value": value, "error": error} for name, value, error in rows},
        "converged": bool(data.attrs["converged"]),
        "sum_of_squares": data.attrs["sum_of_squares"],
        "degrees_of_freedom": data.attrs["degrees_of_freedom"],
        "steps": data.sizes["step"],
    }
    unknown = [one for one in data.attrs["unknown"].split("; ") if one]
    lines = [*in_words(data, rows), *(f"  not told apart: {one}" for one in unknown)]
    output.tell({"walker": request["walker"]} | answer, lines)


def rows_of(data: Any) -> list[tuple[str, float, float]]:
    """Return name, value and error of each parameter."""
    names, values = data["parameter"].values.tolist(), data["value"].values.tolist()
    variances = data["covariance"].values.diagonal()
    return list(zip(names, values, (variances**0.5).tolist(), strict=True))


def in_words(data: Any, rows: list[tuple[str, float, float]]) -> Iterator[str]:
    """Write the parameters with their errors."""
    squares, free = data.attrs["sum_of_squares"], data.attrs["degrees_of_freedom"]
    yield f"Fit of {data.sizes['step']} steps, sum of squares {squares:.5g} of {free}"
    for name, value, error in rows:
        yield f"  {name} {value:.8g} +- {error:.2g}"
    if not data.attrs["converged"]:
        yield "  the search did not converge: give other first guesses"
