"""What each kind of data set holds: names, dimensions, types, units and attributes.

One table per kind. A dimension `*name` stands for one or more dimensions, which are the same
wherever that name stands, and `?name` for exactly one. States are those at the start of a stride,
on the section. Angles are in rad, times in √(l/g), with leg length l and gravity g.
"""

from typing import TYPE_CHECKING, NamedTuple

from walker_jax.checks import WrongUse

if TYPE_CHECKING:
    import xarray  # which takes half a second to load

TYPES = {"integer": "iub", "real": "fiu", "boolean": "biu", "text": "UOST"}
"""The kinds of NumPy types, by their letters, that each type of variable may have."""
STATE = "rad, rad/√(l/g)"
AREA = "rad²/√(l/g)"
VOLUME = "rad³·g/l"
TIME = "√(l/g)"
NEW = "not in earlier data sets"
KNEES = "walkers with knees"
MAPPED = "cell map; not in earlier data sets"
FAILS = "the `Outcome` of its last stride; -1 for none"
DIFFERS = "the gait of `find_gait`, where another one attracts"


class Variable(NamedTuple):
    """A variable of a data set."""

    dims: str
    """Its dimensions in their order."""
    type: str
    """One of `TYPES`."""
    unit: str
    about: str
    when: str = ""
    """Which data sets have it; empty for all."""


class Kind(NamedTuple):
    """A kind of data set."""

    about: str
    variables: dict[str, Variable]
    attributes: dict[str, str]
    """Those that every data set of this kind has, with their meaning."""
    base: str = ""
    """The kind whose variables and attributes it has too."""


V = Variable
WALKER = {
    "walker": "class of the walker; each parameter is an attribute `walker_` + its name, and "
    "`code` is a fingerprint of a class that is not of the package, and `failures` are the "
    "names of its own failures"
}
SECTION = {"section": "names of the coordinates of a state"}
KINDS = {
    "basin": Kind(
        "Fates over a grid, whose axes are its coordinates (`basin`).",
        {
            "fate": V("*grid", "integer", "", "`Outcome` of the last stride; -1 if not computed"),
            "attractor": V("*grid", "integer", "", "number of the attractor; -1 for none"),
            "strides": V("*grid", "integer", "", "before the attractor or the failure"),
            "number": V("number", "integer", "", "of the attractor"),
            "period": V("number", "integer", "strides", "0 for a motion without a period"),
            "states": V("number phase coordinate", "real", STATE, "the cycle; NaN after it"),
            "cells": V("number", "integer", "", "that converge to it"),
            "area": V("number", "real", AREA, "of these cells"),
            "at_border": V("", "integer", "cells", "of basins that are at the grid's border", NEW),
            "artefact": V("number", "boolean", "", "cells alone, no attractor", MAPPED),
            "cycles": V("number", "integer", "", "of cells that belong to it", MAPPED),
            "falling": V("number", "integer", "", "centres that fall", MAPPED),
        },
        WALKER | SECTION | {"method": "`cell-map`, `direct` or `direct, refined`"},
    ),
    "viability": Kind(
        "What any choice of actions can do, over a grid (`viable`).",
        {
            "viable": V("*grid", "boolean", "", "some choice keeps it on the grid for ever"),
            "inner": V("*grid", "boolean", "", "so from all of the cell", "with bounds"),
            "outer": V("*grid", "boolean", "", "perhaps from some of the cell", "with bounds"),
            "safe_actions": V("*grid", "integer", "", "actions that keep it viable"),
            "lasting": V("*grid", "integer", "strides", "the most that can be made; -1 if viable"),
            "failure": V("*grid", "integer", "", "`Outcome` in which that ends; 0 if viable"),
            "capture": V("*grid", "integer", "strides", "the fewest to the target; -1 for none"),
            "action": V("*grid", "integer", "", "that leads there, or keeps it viable; or -1"),
            "axis": V("axis", "text", "", "names of the grid's axes"),
            "lower": V("axis", "real", "", "the grid's lower ends"),
            "upper": V("axis", "real", "", "the grid's upper ends"),
            "shear": V("coordinate axis", "real", "", "a state is origin + shear · place"),
            "origin": V("coordinate", "real", STATE, "the state where all axes are 0"),
        },
        WALKER
        | SECTION
        | {
            "actions": "names of the parameters that the actions set: each is a variable over "
            "`action_number`",
            "area": f"of viable cells; {AREA}",
            "target_area": "of the target",
        },
    ),
    "refined basin": Kind(
        "A basin over the finest grid of a refinement (`refine`).",
        {
            "total_area": V("", "real", AREA, "of all basins, corrected by a check"),
            "total_area_error": V("", "real", AREA, "its standard error"),
            "followed": V("level", "integer", "cells", "that were followed"),
            "boundary": V("level", "integer", "cells", "with a neighbour of another fate"),
            "checked": V("", "integer", "", "starts of the check"),
            "mistaken": V("", "integer", "", "of these, starts that the grid has wrong"),
            "strides_made": V("", "integer", "strides", "in all"),
        },
        {},
        "basin",
    ),
    "refined volume": Kind(
        "A refined basin over three dimensions, where an area is a volume (`refine`). In place of "
        "an array over all cells of the finest grid it has runs: of cells that follow one on "
        "another along the last axis, and are alike. `slice_basin` makes basins of two dimensions "
        "of it.",
        {
            "first_cell": V("run", "integer", "", "first cell of a run, in C order over the grid"),
            "run_fate": V("run", "integer", "", "`Outcome` of the last stride from its cells"),
            "run_attractor": V("run", "integer", "", "number of the attractor; -1 for none"),
            "axis": V("axis", "text", "", "names of the grid's axes, whose centres it has too"),
            "lower": V("axis", "real", "", "the grid's lower ends"),
            "upper": V("axis", "real", "", "the grid's upper ends"),
            "shear": V("coordinate axis", "real", "", "a state is origin + shear · place"),
            "origin": V("coordinate", "real", STATE, "the state where all axes are 0"),
            "number": V("number", "integer", "", "of the attractor"),
            "period": V("number", "integer", "strides", "0 for a motion without a period"),
            "states": V("number phase coordinate", "real", STATE, "the cycle; NaN after it"),
            "cells": V("number", "integer", "", "that converge to it"),
            "area": V("number", "real", VOLUME, "volume of these cells"),
            "total_area": V("", "real", VOLUME, "volume of all basins, corrected by a check"),
            "total_area_error": V("", "real", VOLUME, "its standard error"),
            "at_border": V("", "integer", "cells", "of basins that are at the border of the grid"),
            "followed": V("level", "integer", "cells", "that were followed"),
            "boundary": V("level", "integer", "cells", "with a neighbour of another fate"),
            "checked": V("", "integer", "", "starts of the check"),
            "mistaken": V("", "integer", "", "of these, starts that the grid has wrong"),
            "strides_made": V("", "integer", "strides", "in all"),
        },
        WALKER | SECTION | {"method": "`direct, refined`"},
    ),
    "boundary": Kind(
        "A basin, and what the boundary between its fates is like (`boundary`).",
        {
            "basin_entropy": V("", "real", "", "mean over all boxes"),
            "boundary_entropy": V("", "real", "", "mean over boxes with several fates"),
            "boundary_entropy_error": V("", "real", "", "its standard error"),
            "boundary_crowded": V("", "real", "", "share of these boxes with three fates or more"),
            "boundary_fractal": V("", "boolean", "", "above log 2 in boxes of two sizes"),
            "region": V("region_number", "integer", "", "`Outcome` of the walkers in a region"),
            "spacing": V("spacing", "integer", "cells", "of the points that are compared"),
            "wada_share": V("spacing", "real", "", "of a boundary, that another one lacks"),
            "edge_fates": V("edge beside", "integer", "", "`Outcome` of regions that touch"),
            "edge_between": V("edge beside", "integer", "", "`Outcome` beside the path's end"),
            "edge_kind": V("edge", "text", "", "`saddle`, the margin that is zero, or empty"),
            "edge_period": V("edge", "integer", "strides", "of the saddle; 0 for none"),
            "edge_saddle": V("edge saddle_phase coordinate", "real", STATE, "its cycle, or NaN"),
            "edge_multipliers": V("edge order part", "real", "", "real and imaginary part"),
            "edge_path": V("edge point coordinate", "real", STATE, "stride by stride; then NaN"),
            "stable_manifold": V(
                "edge branch vertex coordinate", "real", STATE, "of its first state; then NaN"
            ),
        },
        {"side": "cells along a side of a box", "radius": "cells within which boundaries are one"},
        "basin",
    ),
    "robustness": Kind(
        "A refined basin, and what its most attracting gait survives (`robustness`).",
        {
            "note": V("", "text", "", DIFFERS, NEW),
            "gait_period": V("", "integer", "strides", "0 where no gait attracts"),
            "gait_state": V("coordinate", "real", STATE, "nearest to the failing state"),
            "multiplier": V("", "real", "", "modulus of the largest Floquet multiplier"),
            "step_time": V("", "real", TIME, "mean of the cycle"),
            "return_strides": V("", "real", "strides", "characteristic return time", NEW),
            "least_disturbance": V("", "real", "", "after which the walker does not return"),
            "direction": V("coordinate", "real", "", "of the least disturbance"),
            "failing_state": V("coordinate", "real", STATE, "to which it leads"),
            "failure": V("", "integer", "", FAILS),
            "failing_strides": V("", "integer", "strides", "before that"),
            "least_fall": V("", "real", "", "least disturbance after which it falls", NEW),
            "fall_direction": V("coordinate", "real", "", "of that disturbance", NEW),
            "fall_state": V("coordinate", "real", STATE, "to which it leads", NEW),
            "fall_failure": V("", "integer", "", FAILS, NEW),
            "fall_strides": V("", "integer", "strides", "before that", NEW),
            "step_down": V("", "real", "leg length", "after which it does not return"),
            "step_down_failure": V("", "integer", "", FAILS, NEW),
            "step_down_fall": V("", "real", "leg length", "after which it falls", NEW),
            "stability": V("", "real", "", "share of random disturbances that it survives"),
            "stability_low": V("", "real", "", "end of its 95 % interval"),
            "stability_high": V("", "real", "", "the other end"),
            "median_strides": V("", "real", "strides", "until it has returned"),
            "slowest_strides": V("", "real", "strides", "the most until then"),
            "in_time": V("", "real", "", "share of disturbances over in 10 strides", NEW),
            "mean_strides": V("", "real", "strides", "mean until then", NEW),
            "pace": V("", "real", "strides", "mean, for each unit of the disturbance", NEW),
            "median_pace": V("", "real", "strides", "the median of that", NEW),
            "mean_shock": V("", "real", "", "mean size of the disturbances survived", NEW),
            "largest_shock": V("", "real", "", "the largest of them", NEW),
            "dimension": V("", "real", "", "of the boundary of the basin"),
            "dimension_low": V("", "real", "", "end of its 95 % interval"),
            "dimension_high": V("", "real", "", "the other end"),
            "steps_to_fall": V("", "real", "strides", "mean on rough ground", f"`ground`; {NEW}"),
            "steps_to_fall_low": V("", "real", "strides", "end of its 95 % interval", "`ground`"),
            "steps_to_fall_high": V("", "real", "strides", "the other end", "`ground`"),
        },
        {"disturbances": "size of random disturbances, as a share of the state of the gait"},
        "refined basin",
    ),
    "metastable walking": Kind(
        "How long walks last on rough ground, and where in the section they are (`metastability`).",
        {
            "survival": V("", "real", "", "chance not to fall in a stride, after many"),
            "mean_strides": V("", "real", "strides", "until a fall, from the gait on"),
            "mean_strides_error": V("", "real", "strides", "its standard error"),
            "undecided": V("", "integer", "strides", "without an answer, left out"),
            "chance": V("cell", "real", "", "of each cell, of walks that still last"),
            "centre": V("cell direction", "real", STATE, "of each; and phi - 2 theta, in rad"),
            "edges": V("edge direction", "real", STATE, "those of every cell, as vectors"),
            "direction": V("direction", "text", "", "`theta`, `thetadot` and, if rough, `gap`"),
        },
        WALKER
        | SECTION
        | {
            "ground": "standard deviation of steps, in leg lengths, or the function's name",
            "side": "of a cell, in standard deviations of the states",
            "walkers": "in all cells",
            "repetitions": "with other random numbers",
            "key": "of random numbers: its data",
        },
    ),
    "robustness table": Kind(
        "Robustness over values of a parameter, with its name as dimension (`robustness_table`).",
        {},
        {"walker": WALKER["walker"]},
    ),
    "sweep": Kind(
        "Basins over all combinations of parameters, whose names are dimensions (`sweep`).",
        {
            "total_area": V(
                "*parameters",
                "real",
                AREA,
                "of all basins, by refinement; over three dimensions a volume, rad³·g/l",
            ),
            "total_area_error": V("*parameters", "real", AREA, "its standard error"),
            "failed": V("*parameters", "integer", "", "1 where the computation failed"),
            "reason": V("*parameters", "text", "", "why it failed, otherwise empty", NEW),
            "fate": V("*parameters *grid", "integer", "", "as in a basin"),
            "attractor": V("*parameters *grid", "integer", "", "as in a basin"),
            "strides": V("*parameters *grid", "integer", "", "as in a basin"),
            "attractors": V("*parameters", "integer", "", "how many there are"),
            "attractor_number": V(
                "*parameters own", "integer", "", "of each, alike in all basins; -1 for none", NEW
            ),
            "attractor_period": V(
                "*parameters own", "integer", "strides", "0 without a period; -1 for none", NEW
            ),
            "attractor_states": V(
                "*parameters own phase coordinate", "real", STATE, "the cycle; NaN after it", NEW
            ),
            "area": V("*parameters", "real", AREA, "of the cells that converge to one"),
            "gait_period": V("*parameters", "integer", "strides", "0 where no gait attracts", NEW),
            "gait_state": V("*parameters coordinate", "real", STATE, "NaN where no gait attracts"),
            "note": V("*parameters", "text", "", DIFFERS, NEW),
            "multiplier": V("*parameters", "real", "", "its largest modulus"),
            "step_time": V("*parameters", "real", TIME, "of this gait"),
            "step_length": V("*parameters", "real", "leg length", "of this gait"),
            "speed": V("*parameters", "real", "√(gl)", "of this gait"),
            "cost_of_transport": V("*parameters", "real", "", "of this gait"),
        },
        WALKER | SECTION,
    ),
    "gait branches": Kind(
        "Gaits and their bifurcations over a parameter, in order along each branch.",
        {
            "branch": V("gait", "integer", "", "number of the branch"),
            "period": V("gait", "integer", "strides", "of the gait"),
            "value": V("gait", "real", "", "of the parameter"),
            "states": V("gait phase coordinate", "real", STATE, "the cycle; NaN after it"),
            "step_times": V("gait phase", "real", TIME, "of its strides"),
            "multipliers": V("gait order part", "real", "", "Floquet; real and imaginary part"),
            "stable": V("gait", "boolean", "", "all multipliers are within the unit circle"),
            "on_cascade": V("gait", "boolean", "", "on the main cascade of period doublings"),
            "event_fold": V("event", "boolean", "", "a fold, or else a period doubling"),
            "event_branch": V("event", "integer", "", "its branch"),
            "event_period": V("event", "integer", "strides", "of the gait there"),
            "event_value": V("event", "real", "", "of the parameter"),
            "event_states": V("event phase coordinate", "real", STATE, "the cycle there"),
            "event_multipliers": V("event order part", "real", "", "there"),
            "cascade": V("event", "boolean", "", "on the main cascade"),
            "torus_branch": V("torus", "integer", "", "of a Neimark-Sacker point", NEW),
            "torus_period": V("torus", "integer", "strides", "of the gait there", NEW),
            "torus_value": V("torus", "real", "", "of the parameter", NEW),
            "torus_states": V("torus phase coordinate", "real", STATE, "the cycle there", NEW),
            "torus_multipliers": V("torus order part", "real", "", "there", NEW),
        },
        {"parameter": "its name"} | WALKER | SECTION,
    ),
    "bifurcation diagram": Kind(
        "Gait branches, and the attractors that long runs converge to (`bifurcation_diagram`).",
        {
            "sample_value": V("sample", "real", "", "of the parameter"),
            "fate": V("sample start", "integer", "", "`Outcome` of the last stride; -1: no start"),
            "strides": V("sample start", "integer", "", "before that"),
            "attractor_period": V("sample start", "integer", "strides", "0 where none shows"),
            "orbit": V("sample start recent coordinate", "real", STATE, "the last states"),
            "lost": V("side", "real", "", "values between which walking is lost; NaN for none"),
        },
        {},
        "gait branches",
    ),
    "basin fractions": Kind(
        "Attractors over a parameter, and fractions of their basins (`continue_basins`).",
        {
            "value": V("value", "real", "", "of the parameter"),
            "attractor": V("attractor", "integer", "", "its number, the same at all values"),
            "fraction": V("value attractor", "real", "", "of the starts; NaN where it is none"),
            "fraction_low": V("value attractor", "real", "", "end of its 95 % interval"),
            "fraction_high": V("value attractor", "real", "", "the other end"),
            "failed": V(
                "value outcome",
                "real",
                "",
                "fraction of the starts, by `Outcome`; `STRIDE`: near no attractor",
            ),
            "states": V("value attractor phase coordinate", "real", STATE, "NaN where it is none"),
            "period": V("attractor", "integer", "strides", "0 for a motion without a period"),
            "first": V("attractor", "real", "", "lowest value at which it attracts"),
            "last": V("attractor", "real", "", "highest value at which it attracts"),
            "event_attractor": V("event", "integer", "", "whose branch has the bifurcation"),
            "event_value": V("event", "real", "", "of the parameter"),
            "event_fold": V("event", "boolean", "", "a fold, or else a period doubling"),
        },
        {"parameter": "its name", "samples": "number of starts"} | WALKER | SECTION,
    ),
    "optimisation": Kind(
        "The trace of an optimisation (`optimise`).",
        {
            "parameter": V("parameter", "text", "", "those that are free"),
            "measure": V("measure", "text", "", "those that are measured"),
            "run": V("evaluation", "integer", "", "its number; -1 for the scan"),
            "stage": V("evaluation", "integer", "", "its number; -1: scan, -2: start or optimum"),
            "parameters": V("evaluation parameter", "real", "", "that were tried"),
            "value": V("evaluation", "real", "", "of the objective"),
            "value_error": V("evaluation", "real", "", "its standard error"),
            "gradient": V("evaluation parameter", "real", "", "by the parameters"),
            "gradient_error": V("evaluation parameter", "real", "", "its standard error"),
            "measures": V("evaluation measure", "real", "", "all that is measured"),
            "strides": V("evaluation", "integer", "strides", "made for areas"),
            "note": V("start_number", "text", "", "why a run led nowhere", "finished"),
            "found": V("", "boolean", "", "an optimum", "finished"),
        },
        WALKER
        | SECTION
        | {
            "objective": "weights of its measures, as JSON",
            "sign": "1 where a large objective is better, else -1",
            "bounds": "of each parameter, as JSON",
            "limits": "of each measure, as JSON",
            "region": "axes of the grid for areas, as JSON",
        },
    ),
    "optimum": Kind(
        "An optimisation that found an optimum.",
        {
            "start": V("parameter", "real", "", "where the best run began"),
            "optimum": V("parameter", "real", "", "where it ended"),
            "objective_start": V("", "real", "", "as this run measured it"),
            "objective_optimum": V("", "real", "", "as this run measured it"),
            "exact_start": V("", "real", "", "objective on the finest grid"),
            "exact_start_error": V("", "real", "", "its standard error; NaN if unknown"),
            "exact_optimum": V("", "real", "", "objective on the finest grid"),
            "exact_optimum_error": V("", "real", "", "its standard error; NaN if unknown"),
            "at_bound": V("parameter", "integer", "", "-1: at the lower bound, 1: at the upper"),
            "phidot": V("", "real", "rad/√(l/g)", "of the slice that is shown", f"volume; {NEW}"),
            "binding": V("measure", "boolean", "", "whether its limit holds the optimum"),
            "converged": V("", "boolean", "", "no shorter step led higher"),
            "note_start": V("", "text", "", DIFFERS, NEW),
            "note_optimum": V("", "text", "", DIFFERS, NEW),
            "scan_parameters": V("parameter point", "real", "", "of the scan", "scan"),
            "scan_value": V("parameter point", "real", "", "objective of the scan", "scan"),
            "scan_allowed": V("parameter point", "boolean", "", "by the limits", "scan"),
            "fate_start": V("*grid", "integer", "", "`Outcome`; -1: an attractor", "plane grid"),
            "fate_optimum": V("*grid", "integer", "", "`Outcome`; -1: an attractor", "plane grid"),
        },
        {},
        "optimisation",
    ),
    "walk": Kind(
        "Strides joined to a motion (`motion`). Places are along the slope and normal to it.",
        {
            "time": V("frame", "real", TIME, "since the first start"),
            "stride": V("frame", "integer", "", "its number, from 0"),
            "theta": V("frame", "real", "rad", "angle of the stance leg"),
            "phi": V("frame", "real", "rad", "angle between the legs"),
            "thetadot": V("frame", "real", "rad/√(l/g)", "rate of theta"),
            "phidot": V("frame", "real", "rad/√(l/g)", "rate of phi"),
            "knee": V("frame", "real", "rad", "angle of the swing knee, above 0 where bent", KNEES),
            "kneedot": V("frame", "real", "rad/√(l/g)", "rate of knee", KNEES),
            "swing_knee": V("frame axis", "real", "leg length", "place of the swing knee", KNEES),
            "stance": V("frame axis", "real", "leg length", "end of the stance leg"),
            "hip": V("frame axis", "real", "leg length", "place of the hip"),
            "swing": V("frame axis", "real", "leg length", "end of the swing leg"),
            "states": V("start coordinate", "real", STATE, "at the start of each stride"),
            "outcome": V("made", "integer", "", "`Outcome` of each stride"),
            "duration": V("made", "real", TIME, "of each stride; NaN for a failure"),
            "footholds": V("foothold axis", "real", "leg length", "of feet", f"rough; {NEW}"),
        },
        WALKER
        | SECTION
        | {
            "walker_slope": "slope of the ground (rad)",
            "leg_length": "from the hip to the end of the leg",
            "foot_radius": "of the arc of a foot; 0 for point feet",
        },
    ),
    "walk in space": Kind(
        "A motion in space (`motion`). Places are along the slope, to the left and normal to it.",
        {
            "time": V("frame", "real", TIME, "since the first start"),
            "stride": V("frame", "integer", "", "its number, from 0"),
            "yaw": V("frame", "real", "rad", "of the axle; mirrored in every other stride"),
            "lean": V("frame", "real", "rad", "of the axle; mirrored in every other stride"),
            "theta": V("frame", "real", "rad", "angle of the stance leg about the axle"),
            "phi": V("frame", "real", "rad", "angle between the legs"),
            "stance": V("frame axis", "real", "leg length", "centre of the stance leg's disc"),
            "swing": V("frame axis", "real", "leg length", "centre of the swing leg's disc"),
            "stance_hip": V("frame axis", "real", "leg length", "stance leg's end of the axle"),
            "swing_hip": V("frame axis", "real", "leg length", "swing leg's end of the axle"),
            "axle": V("frame axis", "real", "", "its direction"),
            "states": V("start coordinate", "real", STATE, "at the start of each stride"),
            "outcome": V("made", "integer", "", "`Outcome` of each stride"),
            "duration": V("made", "real", TIME, "of each stride; NaN for a failure"),
        },
        WALKER
        | SECTION
        | {
            "walker_slope": "slope of the ground (rad)",
            "walker_disc_radius": "of a disc",
            "walker_leg_length": "from the axle to the sole",
        },
    ),
    "zoom": Kind(
        "Basins in ever narrower windows around a point (`zoom`). Axes are offsets in the widest.",
        {
            "fate": V("frame *grid", "integer", "", "as in a basin"),
            "attractor": V("frame *grid", "integer", "", "as in a basin"),
            "factor": V("frame", "real", "", "by which the window is narrower"),
            "ahead": V("frame", "integer", "strides", "of the centre alone, before all starts"),
        },
        WALKER | SECTION | {"origin": "the point, on the section"},
    ),
    "basins over slopes": Kind(
        "Basins at several slopes (Figure 7 of the paper).",
        {
            "slope": V("slope", "real", "rad", "of the ground"),
            "fate": V("slope *grid", "integer", "", "as in a basin"),
            "attractor": V("slope *grid", "integer", "", "as in a basin"),
            "area": V("slope", "real", AREA, "of all basins"),
        },
        WALKER | SECTION,
    ),
    "areas over slopes": Kind(
        "Area of the basin against the slope (Figure 8 of the paper).",
        {
            "slope": V("slope", "real", "rad", "of the ground"),
            "mapped_area": V("slope", "real", AREA, "by cell mapping"),
            "area": V("slope", "real", AREA, "by refinement; NaN where not computed"),
            "area_error": V("slope", "real", AREA, "its standard error"),
        },
        {},
    ),
}
"""The kinds of data sets by name."""
COUNTS = ("checked", "mistaken", "strides_made")
"""What a refined basin counts, which a walker without a gait lacks in a table."""
KINDS["robustness table"].variables.update(
    {
        # Integers are reals in a table, which has NaN for a walker without a gait.
        name: one._replace(
            dims=f"?parameter {one.dims}".rstrip(),
            type="real" if one.type == "integer" else one.type,
            when="some walker has a gait" if name in COUNTS else one.when,
        )
        for name, one in {
            "at_border": KINDS["basin"].variables["at_border"],
            **KINDS["refined basin"].variables,
            **KINDS["robustness"].variables,
        }.items()
        if "level" not in one.dims
    }
)
KINDS["sweep"].variables.update(
    {
        name: one._replace(
            dims=f"*parameters {one.dims}".rstrip(),
            when="`robust`; " + NEW if one.when else "`robust`",
        )
        for name, one in KINDS["robustness"].variables.items()
        if name not in KINDS["sweep"].variables
    }
)


OF_SLICES = {"phidot"}
"""Arrays that are named as the coordinate whose value they hold."""


def names_in_use(kind: str) -> frozenset[str]:
    """Names of the arrays and dimensions of a kind, which no axis of its grid may have."""
    variables = variables_of(kind)
    dimensions = {name for one in variables.values() for name in one.dims.split()}
    return frozenset(variables.keys() - OF_SLICES | dimensions)


def variables_of(kind: str) -> dict[str, Variable]:
    """The variables of a kind, those of its base among them."""
    base = KINDS[kind].base
    return (variables_of(base) if base else {}) | KINDS[kind].variables


def attributes_of(kind: str) -> dict[str, str]:
    """The attributes of a kind, those of its base among them."""
    base = KINDS[kind].base
    return (attributes_of(base) if base else {}) | KINDS[kind].attributes


def check_dataset(data: "xarray.Dataset", kind: str) -> None:
    """Raise `WrongUse` for a data set that is not of a kind of `KINDS`, and say why in one line."""
    variables, attributes = variables_of(kind), attributes_of(kind)
    missing = [name for name, one in variables.items() if not one.when and name not in data]
    missing += [f"attribute {name}" for name in attributes if name not in data.attrs]
    if missing:
        raise WrongUse(f"data must be of the kind {kind!r}, not one without {', '.join(missing)}")
    bound: dict[str, tuple[str, ...]] = {}
    for name, one in variables.items():
        if name not in data:
            continue
        dims, letter = tuple(map(str, data[name].dims)), data[name].dtype.kind
        if not matches(one.dims, dims, bound):
            expected = f"over ({', '.join(one.dims.split())}), not ({', '.join(dims)})"
            raise WrongUse(f"data must be of the kind {kind!r}, with {name} {expected}")
        if letter not in TYPES[one.type]:
            expected = f"of type {one.type}, not {data[name].dtype}"
            raise WrongUse(f"data must be of the kind {kind!r}, with {name} {expected}")


def matches(pattern: str, dims: tuple[str, ...], bound: dict[str, tuple[str, ...]]) -> bool:
    """Whether dimensions fit a pattern; what its placeholders stand for is added to `bound`."""
    before, placeholder, after = [], "", []
    for name in pattern.split():
        known = bound.get(name, () if name[0] in "*?" else (name,))
        if known:
            (after if placeholder else before).extend(known)
        else:
            placeholder = name
    fixed = len(before) + len(after)
    middle = dims[len(before) : len(dims) - len(after)]
    if dims[: len(before)] != tuple(before) or dims[len(dims) - len(after) :] != tuple(after):
        return False
    if not placeholder:
        return len(dims) == fixed
    if len(dims) <= fixed or (placeholder[0] == "?" and len(middle) > 1):
        return False
    bound[placeholder] = middle
    return True
