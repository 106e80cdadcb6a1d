"""`walker-jax fit`."""

from pathlib import Path
from typing import Any

import walker_jax as wj
from walker_jax.cli import library as lib
from walker_jax.cli.answers import Output, request_for
from walker_jax.cli.commands import command
from walker_jax.cli.options import Choice, argument, named, option, underscored
from walker_jax.refusals import WrongUse


@command(
    examples=(
        "fit walk.csv --slope 0.01 --parameters slope --column theta=stance --unit theta=deg",
        "fit walk.csv --walker point-foot --slope 0.01 --parameters foot-mass --strikes leg",
    ),
    time="Half a minute, most of it compiling.",
    out="fit.zarr",
)
def fit(
    walker: "wj.System",
    output: Output,
    source: Path = argument("FILE"),
    columns: dict[str, str] = named(
        "A coordinate and its column (default: all, by their own names).",
        "COLUMN",
        flags=["--column"],
    ),
    units: dict[str, Any] = named(
        "Unit of a coordinate or of time: deg, ms, or a size.", "UNIT", flags=["--unit"]
    ),
    time: str = option("time", "Column of times."),
    strikes: str | None = option(None, "Column that changes at each heel strike (default: found)."),
    experiment: str | None = option(None, "Column that numbers experiments."),
    parameters: tuple[str, ...] = option(
        (), "A parameter to fit; may be given again.", multiple=True
    ),
    noise: dict[str, float] = named(
        "Standard deviation of a column, or of time (default: found).", "VALUE"
    ),
    shooting: str = option(
        "multiple",
        "Starts of steps: free, or linked by the impact.",
        type=Choice("multiple", "single"),
    ),
    loss: str = option(
        "linear", "The others are for outliers.", type=Choice("linear", "soft_l1", "cauchy")
    ),
    skip: float = option(0.0, "Leave out samples so soon after a heel strike.", least=0),
    bootstrap: int = option(0, "Fits to resampled steps, for intervals.", least=0),
    seed: int = option(0, "Seed of the resampling.", least=0, needs="bootstrap"),
):
    """Fit parameters of a walker to recordings of its steps, with errors.

    FILE holds the recordings: .csv, .parquet, .nc or .mat.

    The walker's own values are the first guesses. Times and angles are in the units of the walker:
    give the sizes of other units by --unit.
    """
    if not parameters:
        raise WrongUse("--parameters must name one parameter or more, not none")
    names = [*map(underscored, parameters)]
    given: Any = {"parameters": names, "noise": noise, "shooting": shooting, "loss": loss}
    given |= {"skip": skip, "bootstrap": bootstrap, "seed": seed}
    # The column of times has its name in the file, unlike names of coordinates.
    units = {time if one == underscored(time) else one: of for one, of in units.items()}
    which: Any = {"time": time, "strikes": strikes, "experiment": experiment}
    recordings = wj.read_recordings(source, columns or None, units=units, **which)
    numbers = [(one.time, one.strikes, *one.values.values()) for one in recordings]
    digest = lib.sha256_of(b"".join(one.tobytes() for row in numbers for one in row))
    request = request_for("fit", walker, recordings=digest, **given)
    system: Any = walker
    data = output.produce(request, lambda: wj.fit(system, recordings, **given).data, "fit")
    fitted, errors = data["value"].values.tolist(), data["covariance"].values.diagonal() ** 0.5
    rows = [*zip(data["parameter"].values.tolist(), fitted, errors.tolist(), strict=True)]
    about, steps = data.attrs, data.sizes["step"]
    squares, free = about["sum_of_squares"], about["degrees_of_freedom"]
    yield {
        "walker": request["walker"],
        "parameters": {name: {"value": value, "error": error} for name, value, error in rows},
        "converged": bool(about["converged"]),
        "sum_of_squares": squares,
        "degrees_of_freedom": free,
        "steps": steps,
    }
    yield f"Fit of {steps} steps, sum of squares {squares:.5g} of {free}"
    yield from (f"  {name} {value:.8g} +- {error:.2g}" for name, value, error in rows)
    if not about["converged"]:
        yield "  the search did not converge: give other first guesses"
    yield from (f"  not told apart: {one}" for one in about["unknown"].split("; ") if one)
    yield output.places()
