"""Data sets of basins: one table for each kind."""

from walker_jax.storage.kind import AREA, DIFFERS, FAILS, SECTION, STATE, TIME, WALKER, Kind
from walker_jax.storage.kind import Variable as V

VOLUME = "rad³·g/l"
FATE = "`Outcome` of the last stride; -1 if not computed"
NUMBER = "number of the attractor; -1 for none"
STRIDES = "before the attractor or the failure"
FRAME = {
    "lower": V("axis", "real", "", "the grid's lower ends"),
    "upper": V("axis", "real", "", "the grid's upper ends"),
    "shear": V("coordinate axis", "real", "", "a state is origin + shear · place"),
    "origin": V("coordinate", "real", STATE, "the state where all axes are 0"),
}
"""What the axes of a grid are in the section."""
REFINEMENT = {
    "followed": V("level", "integer", "cells", "that were followed"),
    "boundary": V("level", "integer", "cells", "with a neighbour of another fate"),
    "checked": V("", "integer", "", "starts of the check"),
    "mistaken": V("", "integer", "", "of these, starts that the grid has wrong"),
    "strides_made": V("", "integer", "strides", "in all"),
}
"""How the cells of a refined grid were followed and checked."""
BASINS = {
    "basin": Kind(
        "Fates over a grid, whose axes are its coordinates (`basin`).",
        {
            "fate": V("*grid", "integer", "", FATE),
            "attractor": V("*grid", "integer", "", NUMBER),
            "strides": V("*grid", "integer", "", STRIDES),
            "number": V("number", "integer", "", "of the attractor"),
            "period": V("number", "integer", "strides", "0 for a motion without a period"),
            "states": V("number phase coordinate", "real", STATE, "the cycle; NaN after it"),
            "cells": V("number", "integer", "", "that converge to it"),
            "area": V("number", "real", AREA, "of these cells"),
            "at_border": V("", "integer", "cells", "of basins that are at the grid's border"),
            "artefact": V(
                "number", "boolean", "", "a cycle of cells, not an attractor", "cell map"
            ),
            "cycles": V("number", "integer", "", "cycles of cells that belong to it", "cell map"),
            "falling": V("number", "integer", "", "centres that fall", "cell map"),
        },
        WALKER | SECTION | {"method": "`cell-map`, `direct` or `direct, refined`"},
    ),
    "viability": Kind(
        "The viability kernel over a grid, and the actions that lead to a target (`viable`).",
        {
            "viable": V("*grid", "boolean", "", "some choice keeps it on the grid for ever"),
            "inner": V("*grid", "boolean", "", "so for all of the cell", "with bounds"),
            "outer": V("*grid", "boolean", "", "perhaps so for some of the cell", "with bounds"),
            "safe_actions": V("*grid", "integer", "", "actions that keep it viable"),
            "lasting": V("*grid", "integer", "strides", "the most that can be made; -1 if viable"),
            "failure": V("*grid", "integer", "", "`Outcome` that ends these; 0 if viable"),
            "capture": V("*grid", "integer", "strides", "the fewest to the target; -1 for none"),
            "action": V("*grid", "integer", "", "leads there, or keeps it viable; -1 for none"),
            "mapped": V("level", "integer", "cells", "mapped at this level", "with bounds"),
            "level_inner_area": V(
                "level", "real", AREA, "of `inner` cells after it", "with bounds"
            ),
            "level_outer_area": V(
                "level", "real", AREA, "of `outer` cells after it", "with bounds"
            ),
            "axis": V("axis", "text", "", "names of the grid's axes"),
            **FRAME,
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
    "proof": Kind(
        "Starts that walk for ever, by proof, and that fall (`prove_basin`).",
        {
            "proved": V(
                "cell", "integer", "", "1: all of it walks for ever, -1: none of it, 0: open"
            ),
            "strides": V("cell", "integer", "", "made before that was known, or given up"),
            "level": V("cell", "integer", "", "how often the first cells were halved"),
            "place": V("cell axis", "integer", "", "the cell's number along each axis"),
            "axis": V("axis", "text", "", "names of the grid's axes"),
            "lower": V("axis", "real", "", "the grid's lower ends"),
            "upper": V("axis", "real", "", "the grid's upper ends"),
            "count": V("axis", "integer", "", "cells of level 0"),
            "shear": V("coordinate axis", "real", "", "a state is shear · place"),
            "trap_centre": V("coordinate", "real", STATE, "c of the trap, ‖Lᵀ(x - c)‖ ≤ size"),
            "trap_factor": V("coordinate column", "real", "", "its L"),
            "trap_size": V("", "real", "", "its size"),
        },
        WALKER
        | SECTION
        | {
            "period": "strides from the trap into itself",
            "radius": "of the disc about the gait that the cells cover; 0 for a window",
            "all_walk": "whether all cells are proved to walk, which is then a theorem",
            "area_lower": f"starts of the disc or window that walk have at least this; {AREA}",
            "area_upper": "and at most this: cells left open count too",
            "verified_strides": "made for the cells",
        },
    ),
    "refined basin": Kind(
        "A basin over the finest grid of a refinement (`refine`).",
        {
            "total_area": V("", "real", AREA, "of all basins, corrected by a check"),
            "total_area_error": V("", "real", AREA, "its standard error"),
            **REFINEMENT,
        },
        {},
        "basin",
    ),
    "refined volume": Kind(
        "A refined basin over three dimensions, where an area is a volume (`refine`). Instead of "
        "arrays over all cells of the finest grid it has runs of equal cells along the last axis. "
        "`slice_basin` cuts basins of two dimensions from it.",
        {
            "first_cell": V("run", "integer", "", "first cell of a run, in C order over the grid"),
            "run_fate": V("run", "integer", "", "`Outcome` of the last stride from its cells"),
            "run_attractor": V("run", "integer", "", NUMBER),
            "axis": V("axis", "text", "", "names of the grid's axes, each with its centres"),
            **FRAME,
            "number": V("number", "integer", "", "of the attractor"),
            "period": V("number", "integer", "strides", "0 for a motion without a period"),
            "states": V("number phase coordinate", "real", STATE, "the cycle; NaN after it"),
            "cells": V("number", "integer", "", "that converge to it"),
            "area": V("number", "real", VOLUME, "volume of these cells"),
            "total_area": V("", "real", VOLUME, "volume of all basins, corrected by a check"),
            "total_area_error": V("", "real", VOLUME, "its standard error"),
            "at_border": V("", "integer", "cells", "of basins that are at the grid's border"),
            **REFINEMENT,
        },
        WALKER | SECTION | {"method": "`direct, refined`"},
    ),
    "boundary": Kind(
        "A basin, and the boundary between its fates and attractors (`boundary`).",
        {
            "basin_entropy": V("", "real", "", "mean over all boxes"),
            "boundary_entropy": V("", "real", "", "mean over boxes with several regions"),
            "boundary_entropy_error": V("", "real", "", "its standard error"),
            "boundary_crowded": V(
                "", "real", "", "share of these boxes with three regions or more"
            ),
            "boundary_excess": V("", "real", "", "of the boundary's dimension over a plane's"),
            "boundary_excess_error": V("", "real", "", "its standard error"),
            "boundary_fractal": V("", "boolean", "", "whether that shows a fractal boundary"),
            "region": V("region_number", "integer", "", "`Outcome` of the walkers in a region"),
            "region_attractor": V("region_number", "integer", "", "its attractor; -1 for none"),
            "spacing": V("spacing", "integer", "cells", "of the points that are compared"),
            "wada_share": V("spacing", "real", "", "share of a boundary that another lacks"),
            "edge_fates": V("edge beside", "integer", "", "`Outcome` of regions that touch"),
            "edge_attractors": V("edge beside", "integer", "", "their attractors; -1 for none"),
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
        "A refined basin, and the robustness of its most attracting gait (`robustness`).",
        {
            "note": V("", "text", "", DIFFERS),
            "gait_period": V("", "integer", "strides", "0 where no gait attracts"),
            "gait_state": V("coordinate", "real", STATE, "nearest to the failing state"),
            "multiplier": V("", "real", "", "modulus of the largest Floquet multiplier"),
            "step_time": V("", "real", TIME, "mean of the cycle"),
            "return_strides": V("", "real", "strides", "characteristic return time"),
            "least_disturbance": V("", "real", "", "after which the walker does not return"),
            "direction": V("coordinate", "real", "", "of the least disturbance"),
            "failing_state": V("coordinate", "real", STATE, "to which it leads"),
            "failure": V("", "integer", "", FAILS),
            "failing_strides": V("", "integer", "strides", "before that"),
            "least_fall": V("", "real", "", "least disturbance after which it falls"),
            "fall_direction": V("coordinate", "real", "", "of that disturbance"),
            "fall_state": V("coordinate", "real", STATE, "to which it leads"),
            "fall_failure": V("", "integer", "", FAILS),
            "fall_strides": V("", "integer", "strides", "before that"),
            "step_down": V("", "real", "leg length", "after which it does not return"),
            "step_down_failure": V("", "integer", "", FAILS),
            "step_down_fall": V("", "real", "leg length", "after which it falls"),
            "stability": V("", "real", "", "share of random disturbances that it survives"),
            "stability_low": V("", "real", "", "end of its 95 % interval"),
            "stability_high": V("", "real", "", "the other end"),
            "median_strides": V("", "real", "strides", "until it has returned"),
            "slowest_strides": V("", "real", "strides", "the most until then"),
            "in_time": V("", "real", "", "share of disturbances over in 10 strides"),
            "mean_strides": V("", "real", "strides", "mean until then"),
            "pace": V("", "real", "strides", "mean, for each unit of the disturbance"),
            "median_pace": V("", "real", "strides", "the median of that"),
            "mean_shock": V("", "real", "", "mean size of the disturbances survived"),
            "largest_shock": V("", "real", "", "the largest of them"),
            "dimension": V("", "real", "", "of the boundary of the basin"),
            "dimension_low": V("", "real", "", "end of its 95 % interval"),
            "dimension_high": V("", "real", "", "the other end"),
            "steps_to_fall": V("", "real", "strides", "mean on rough ground", "`ground`"),
            "steps_to_fall_low": V("", "real", "strides", "end of its 95 % interval", "`ground`"),
            "steps_to_fall_high": V("", "real", "strides", "the other end", "`ground`"),
        },
        {"disturbances": "size of random disturbances, as a share of the state of the gait"},
        "refined basin",
    ),
    "robustness table": Kind(
        "Robustness over values of a parameter, with its name as dimension (`robustness_table`). "
        "Integers are real numbers, NaN for a walker without a gait.",
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
            "reason": V("*parameters", "text", "", "why it failed, otherwise empty"),
            "fate": V("*parameters *grid", "integer", "", FATE),
            "attractor": V("*parameters *grid", "integer", "", NUMBER),
            "strides": V("*parameters *grid", "integer", "", STRIDES),
            "attractors": V("*parameters", "integer", "", "number of attractors"),
            "attractor_number": V(
                "*parameters own", "integer", "", "of each, alike in all basins; -1 for none"
            ),
            "attractor_period": V(
                "*parameters own", "integer", "strides", "0 without a period; -1 for none"
            ),
            "attractor_states": V(
                "*parameters own phase coordinate", "real", STATE, "the cycle; NaN after it"
            ),
            "area": V("*parameters", "real", AREA, "of all cells that converge"),
            "gait_period": V("*parameters", "integer", "strides", "0 where no gait attracts"),
            "gait_state": V("*parameters coordinate", "real", STATE, "NaN where no gait attracts"),
            "note": V("*parameters", "text", "", DIFFERS),
            "multiplier": V("*parameters", "real", "", "largest modulus, of this gait"),
            "step_time": V("*parameters", "real", TIME, "of this gait"),
            "step_length": V("*parameters", "real", "leg length", "of this gait"),
            "speed": V("*parameters", "real", "√(gl)", "of this gait"),
            "cost_of_transport": V("*parameters", "real", "", "of this gait"),
        },
        WALKER | SECTION,
    ),
    "zoom": Kind(
        "Basins in ever narrower windows around a point (`zoom`). Axes are offsets in the widest.",
        {
            "fate": V("frame *grid", "integer", "", FATE),
            "attractor": V("frame *grid", "integer", "", NUMBER),
            "factor": V("frame", "real", "", "by which the window is narrower"),
            "ahead": V("frame", "integer", "strides", "of the centre alone, before all starts"),
        },
        WALKER | SECTION | {"origin": "the point, on the section"},
    ),
    "basins over slopes": Kind(
        "Basins at several slopes (Figure 7 of the paper).",
        {
            "slope": V("slope", "real", "rad", "of the ground"),
            "fate": V("slope *grid", "integer", "", FATE),
            "attractor": V("slope *grid", "integer", "", NUMBER),
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
