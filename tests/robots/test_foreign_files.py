"""Files that are no planar robots are refused, each by one line that names the part."""

import pytest
from reference import ROOT
from robot_examples import FILES

import walker_jax as wj
from walker_jax.checks import WrongUse

COMPASS = (FILES / "compass.xml").read_text()
BLOCKS = (ROOT / "tests" / "data" / "foreign_robots.txt").read_text().split("\n\n")[1:]
TABLE = {lines[0]: lines[1:] for lines in (block.strip("\n").split("\n") for block in BLOCKS)}


def changed(changes):
    """The file after some changes."""
    text = COMPASS
    for change in changes:
        old, new = (part.replace("\\n", "\n") for part in change.split(" -> ", 1))
        if old.strip():
            assert old in text, old
            text = text.replace(old, new)
        else:
            text = new
    return text


@pytest.mark.parametrize("name", TABLE)
def test_a_foreign_file_is_refused_by_one_line(name, tmp_path):
    *changes, line = TABLE[name]
    file = tmp_path / "robot.xml"
    file.write_text(changed(changes))
    with pytest.raises(WrongUse) as refused:
        wj.robot(file)
    message = str(refused.value)
    assert message == line.replace("{file}", str(file)) and "\n" not in message


def test_the_table_has_at_least_twenty_files():
    assert len(TABLE) >= 20
