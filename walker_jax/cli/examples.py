"""Examples for the help of each command, and the time it takes."""

EXAMPLES = {
    "walk": (
        "walk",
        "walk --theta 0.16 --thetadot -0.17 --strides 20",
        "walk --animate walk.gif",
        "walk --slope 0.009 --ground 0.0005 --seed 1 --strides 100 --animate rough.gif",
    ),
    "explain": (
        "explain --theta 0.3 --thetadot -0.1",
        "explain --walker kneed",
        "explain --system duffing --start x=0.5 --start v=0",
    ),
    "gait": (
        "gait --slope 0.009",
        "gait --walker round-foot --foot-radius 0.3 --figure multipliers.png",
        "gait --walker kneed",
        "gait --walker powered --slope 0 --push-off 0.05",
        "gait --slope 0.0125 --period 3 --all",
        "gait --system duffing --start x=-1.3 --start v=-0.2 --period 3",
    ),
    "bifurcation": (
        "bifurcation --from 0.001 --to 0.022",
        "bifurcation --walker spring --hip-stiffness 1 --to 0.02 --out spring.zarr",
        "bifurcation --system henon --over a --from 0 --to 1.2 --out henon.zarr",
    ),
    "chart": (
        "chart --walker spring --over slope=0.001:0.1:120 --over hip-stiffness=0:1:90",
        "chart --walker round-foot --foot-radius 0.1 --over slope=0.001:0.2:120 "
        "--over foot-radius=0:0.5:90",
        "chart --system henon --a 0.1 --over a=-0.5:1.5:120 --over b=-0.5:0.6:90",
    ),
    "explore": (
        "explore",
        "explore --walker spring --hip-stiffness 1",
        "explore --system henon --a 1.02",
        "explore --no-browser",
    ),
    "basin": (
        "basin",
        "basin --method direct --slope 0.009 --out steep.zarr",
        "basin --walker round-foot --foot-radius 0.3",
        "basin --system henon --a 1.02 --method direct",
    ),
    "boundary": ("boundary", "boundary --slope 0.009 --out steep.zarr"),
    "viable": (
        "viable --walker powered --action push-off=0:0.1:17 --theta 0 0.8 160 --sum -0.4 0.05 180",
        "viable --system torso-wheel --action lean=0.1:0.9:9 --axis thetadot=-1.2:0:30 --axis "
        "psi=-0.4:1.2:32 --axis psidot=-1:1:20",
    ),
    "prove": (
        "prove --radius 0.00223",
        "prove --slope 0.009 --radius 0.00223",
        "prove --theta 0.1 0.2 20 --sum -0.02 0.01 30 --levels 4",
    ),
    "fall": (
        "fall --walker spring --slope 0.01 --hip-stiffness 0.2 --figure fall.png",
        "fall --walker round-foot --slope 0.01 --ground 0.0004",
        "fall --slope 0.009 --push 0.001 --way backward",
    ),
    "robustness": (
        "robustness --slope 0.009",
        "robustness --slope 0.009 --ground 0.0002",
        "robustness --from 0.002 --to 0.018 --count 17 --out slopes.zarr",
    ),
    "continuation": (
        "continuation --over slope=0.002:0.02:37",
        "continuation --walker powered --slope 0 --over push-off=0.02:0.1:17 --out powered.zarr",
    ),
    "optimise": (
        "optimise --over slope --bound slope=0.001:0.02",
        "optimise --walker spring --over hip-stiffness --bound hip-stiffness=0:20",
    ),
    "sweep": (
        "sweep --over slope=0.002:0.01:5",
        "sweep --walker spring --over slope=0.002:0.01:5 --over hip-stiffness=0:9:4 --workers 2",
    ),
    "export": ("export basin.zarr basin.nc",),
    "reproduce": ("reproduce --quick --out quick", "reproduce --out report"),
}
"""Lines to type for each command, without the name of the program."""
DURATIONS = {
    "explain": "3 s, of a kneed walker 20 s.",
    "walk": "A few seconds; a film half a minute.",
    "gait": "A few seconds; twenty for walkers with mass on their legs, when they are compiled.",
    "bifurcation": "Half a minute.",
    "chart": "Half a minute; a minute for walkers with mass on their legs.",
    "explore": "A few seconds until the page opens.",
    "basin": "Five seconds for the paper's grid, and a second for each further million cells.",
    "boundary": "Half a minute.",
    "viable": "Half a minute for the first example.",
    "prove": "Half a minute for the first example, most of it to compile.",
    "fall": "Half a minute.",
    "robustness": "Twenty seconds or more for each slope; minutes for walkers with knees.",
    "continuation": "A minute or two for the example.",
    "optimise": "Half a minute for the area over a slope, an hour for more parameters; fewer "
    "--starts and --scan 0 shorten it.",
    "sweep": "Some seconds for each combination, half a minute with --robust.",
    "export": "A second.",
    "reproduce": "Forty seconds; with --quick less.",
}
"""Time of each command on two cores, as its help says."""
