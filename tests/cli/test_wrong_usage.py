"""Command lines that cannot be are refused in one line, before anything is written."""

import re
import shlex

import pytest

WRONG = """
walk --theta nan | theta
walk --thetadot inf | thetadot
walk --strides -1 | strides
walk --strides 1000001 | strides
walk --theta 0.9 --animate walk.gif | theta
walk --animate walk.png | walk.png
walk --walker giraffe | --walker | giraffe | --list-walkers
walk --foot-mass 0.1 | --foot-mass | simplest | --slope
walk --walker round-foot --theta 0.2 | --thetadot
walk --phidot 0.2 | --phidot | theta, thetadot
basin --slope 0 | slope
basin --slope -0.01 | slope
basin --slope nan | slope
basin --slope inf | slope
basin --slope steep | slope
basin --theta 0.4 0 10 | theta
basin --theta 0.2 0.2 10 | theta
basin --theta 0 0.4 0 | theta
basin --theta 0 0.4 1.5 | theta
basin --theta nan 0.4 10 | theta
basin --sum 0 -1 10 | sum
basin --theta 0 0.4 1000000 --sum 0 1 1000000 | cells
basin --theta 0 0.4 100000 --sum 0 1 20000 | cells
basin --sum 0 1 10 --thetadot -1 0 10 | --thetadot
basin --method guess | method
basin --method direct --strides 0 | strides
basin --out no/such/folder/b.zarr | no/such/folder
basin --out / | /
basin --figure b.xyz | b.xyz
basin --figure b.jpg | b.jpg
basin --out b.png | b.png
basin --out . | --out
basin --strides 50 | --strides
basin --colour red | --colour
basin extra | extra
basin --walker round-foot --foot-radius 1 | --foot-radius | --leg-length | 1
basin --walker round-foot --leg-length 0 | --leg-length | 0
basin --walker round-foot --leg-mass inf | --leg-mass | inf
basin --phidot 0 1 5 | --phidot | theta, thetadot
basin --at-phidot 0 | --at-phidot | theta, thetadot
basin --walker round-foot --phidot 0 1 5 --at-phidot 0 | --phidot | --at-phidot
basin --walker round-foot --at-phidot nan | at-phidot | nan
basin --walker round-foot --at-phidot 0 --method cell-map | method | slice
sweep --walker point-foot --over slope=0.001:0.02:30000000 | N of at most 1048576
sweep --walker point-foot --over slope=0.001:0.02:2000 --over foot-mass=0.1:0.2:1000
  | at most 1048576 combinations
gait --walker point-foot --foot-mass -1 | --foot-mass | -1
gait --walker point-foot --foot-mass nan | --foot-mass | nan
gait --phidot 0.2 | --phidot | --guess
gait --walker round-foot --guess 0.2 -0.2 | --phidot
gait --slope 0 | slope
gait --period 0 | period
gait --guess nan 0 | --guess must be finite, not nan
gait --guess 0.2 inf | --guess must be finite, not inf
gait --guess 0.2 | guess
gait --all --guess 0.2 -0.2 | --all
gait --figure m.jpg | m.jpg
gait --figure no/such/folder/m.png | no/such/folder
bifurcation --walker spring --hip-stiffness -1 | --hip-stiffness | -1
bifurcation --from 0.02 --to 0.01 | --from
bifurcation --from 0 | slope
bifurcation --slope 0.01 | --slope is not for this command: give --from and --to
bifurcation --to nan | slope
bifurcation --period-max 0 | period-max
bifurcation --strides 0 | strides
bifurcation --out b.png | b.png
bifurcation --figure b.gif | b.gif
robustness --from 0.01 | --to
robustness --count 5 | --from
robustness --from 0.02 --to 0.01 | --from
robustness --from 0 --to 0.01 | slope
robustness --from 0.01 --to 0.02 --count 1 | count
robustness --levels -1 | levels
robustness --levels 9 | levels
robustness --disturbances 0 | --disturbances
robustness --disturbances nan | disturbances
robustness --strides 0 | strides
robustness --theta 0 0.4 10 | --sum
robustness --theta 0 0.4 1 --sum 0 0.4 5 | 2 cells
robustness --at-phidot 0.1 | --at-phidot
robustness --walker round-foot --at-phidot 0.1 | --theta
robustness --out r.png | r.png
robustness --figure r.gif | r.gif
optimise | --over is required
optimise --over slope | --bound is required for slope: slope=LO:HI
optimise --over mass --bound mass=1:2 | not 'mass'
optimise --over slope --bound slope=0.1 | --bound must be NAME=LO:HI, not slope=0.1
optimise --over slope --bound slope=0.2:0.1 | --bound of slope must be finite
optimise --over slope --bound slope=0:0.1 | slope must be above 0 and below 1.5708, not 0
optimise --over slope --bound slope=0.1:0.2 --bound foot_mass=1:2
  | --bound is of foot-mass, which is not free: add --over foot-mass
optimise --over slope --bound slope=0.001:0.015 --objective beauty | --objective must be one of area
optimise --over slope --bound slope=0.001:0.015 --objective speed --objective speed
  | --objective must be one NAME, or NAME=
optimise --over slope --bound slope=0.001:0.015 --objective speed=1 --objective speed=1
  | --objective is given twice for speed
optimise --over slope --bound slope=0.001:0.015 --bound slope=0.1:0.2
  | --bound is given twice for slope
optimise --over slope --bound slope=0.001:0.015 --objective area=much
  | --objective must be one NAME, or NAME=WEIGHT
optimise --over slope --bound slope=0.001:0.015 --at-least area 1 | 'area'
optimise --over slope --bound slope=0.001:0.015 --at-least speed nan
  | --at-least and --at-most of speed must be finite
optimise --over slope --bound slope=0.001:0.015 --starts 0 | --starts
optimise --over slope --bound slope=0.001:0.015 --theta 0 1 10
  | give --theta and --sum, or none of them
optimise --over slope --bound slope=0.001:0.015 --at-phidot 0.1 | --at-phidot must be left out
"""
"""Command lines, and words of which each is in the message."""
ROWS = [re.split(r"\s+\| ", row) for row in re.split(r"\n(?! )", WRONG.strip())]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_wrong_usage_gets_one_line_and_changes_nothing(run, tmp_path, monkeypatch, row):
    monkeypatch.setattr("walker_jax.checks.memory_of_machine", lambda: 8 * 2**30)
    arguments, *named = row
    code, out, err = run(*shlex.split(arguments))
    assert (code, out) == (2, "") and named
    assert err.startswith("walker-jax: ") and err.count("\n") == 1
    assert not [word for word in named if word not in err]
    assert list(tmp_path.iterdir()) == []
