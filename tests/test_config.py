"""Cell files: what is accepted, and what is said of one that is wrong."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from runtime import config, registry
from runtime.cell import Tolerances
from runtime.component import COMPONENTS
from runtime.config import CellFile, load, redacted, redacted_cell, scope_of, shipped
from runtime.errors import CellError, InputError, PluginError

TEXT = (shipped()["igbt"]).read_text()


def write(tmp_path: Path, text: str) -> str:
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return str(path)


def replaced(old: str, new: str) -> str:
    assert old in TEXT, old
    return TEXT.replace(old, new, 1)


@pytest.mark.parametrize("name", shipped())
def test_shipped_cells_are_valid(name: str) -> None:
    cell = load(name).cell
    assert cell.component == name
    assert len(cell.board.holes) == 9
    assert cell.tolerances.abnormal_hole == 7


def test_values_arrive_in_si_units() -> None:
    cell = load("igbt").cell
    assert cell.board.holes[0].x == pytest.approx(-0.03)
    assert cell.board.holes[3].orientation == pytest.approx(3.141592653589793)
    assert cell.tolerances.board_rotation == pytest.approx(2e-3)
    assert cell.safety.deadline == pytest.approx(0.2)


WRONG = {
    "a wrong key": (
        replaced("max_attempts", "max_atempts"),
        r"cell\.toml: search\.max_atempts: unknown key; did you mean 'max_attempts'\?",
    ),
    "a wrong key at the top": (
        replaced("strategy =", "strategie ="),
        r"strategie: unknown key; did you mean 'strateg",
    ),
    "a wrong key in a list": (
        replaced('orientation = "0 deg"', 'turn = "0 deg"'),
        r"board\.holes\.0\.turn: unknown key",
    ),
    "a wrong type": (
        replaced("max_attempts = 150", 'max_attempts = "many"'),
        r"search\.max_attempts: .*integer.*'many'",
    ),
    "no unit": (replaced('radius = "2 mm"', "radius = 2"), r'search\.radius: 2 has no unit; .*"1 m"'),
    "a wrong unit": (replaced('radius = "2 mm"', 'radius = "2 N"'), r"search\.radius: 'N' is no unit of length; .*mm"),
    "out of range": (
        replaced('radius = "2 mm"', 'radius = "-2 mm"'),
        r"search\.radius: .*greater than 0 \(got '-2 mm'\)",
    ),
    "too many": (replaced("boards = 1", "boards = 0"), r"boards: .*greater than or equal to 1 \(got 0\)"),
    "an unknown strategy": (
        replaced('"meta"', '"mega"'),
        r"no strategy 'mega' is installed; did you mean 'meta'\?.*spiral",
    ),
    "an unknown robot": (
        replaced("mujoco_ur3e", "mujoco_ur5"),
        r"no driver 'mujoco_ur5' is installed; .*light_curtain",
    ),
    "an unknown part": (
        replaced('component = "igbt"', 'component = "diode"'),
        r"no part 'diode' is known; .*capacitor",
    ),
    "a polar part without orientation": (
        replaced(', orientation = "0 deg"', ""),
        r"hole '1' needs an orientation, such as orientation = \"0 deg\": igbt is a polar part",
    ),
    "two holes of one name": (replaced('name = "2"', 'name = "1"'), r"the name '1' stands twice"),
    "no hole": (re.sub(r"holes = \[.*?\n\]", "holes = []", TEXT, flags=re.S), r"at least one hole"),
    "no board": (TEXT.split("[board]")[0], r"board: field required"),
    "no such abnormal hole": (
        replaced("abnormal_hole = 7", "abnormal_hole = 70"),
        r"70 is no hole's number; write 1 to 9",
    ),
    "a wrong rate": (replaced('"max"', '"fast"'), r"rate 'fast' is neither 'max' nor a number"),
    "no TOML": ("robot = meta meta\n", r"no valid TOML: .*line 1"),
    "a date": (replaced("seed = 1", "seed = 2026-01-01"), r"cell\.toml: .*date"),
    "settings of an unknown strategy": (TEXT + "\n[strategies.mega]\nx = 1\n", r"no strategy 'mega'"),
    "a wrong setting of a strategy": (
        TEXT + "\n[strategies.spiral]\npich = 1\n",
        r"strategies\.spiral.*pich: unknown key",
    ),
}


@pytest.mark.parametrize(("text", "said"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_cell_file_is_explained_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises((CellError, PluginError)) as caught:
        load(write(tmp_path, text))
    message = str(caught.value)
    assert re.search(said, message), message
    assert "\n" not in message
    assert isinstance(caught.value, InputError)


@pytest.mark.parametrize("name", ["nowhere.toml", "no-such-cell", "."])
def test_a_missing_cell_file_is_explained(name: str) -> None:
    with pytest.raises(CellError, match=r"igbt|directory"):
        load(name)


def test_overrides_replace_the_file() -> None:
    cell = load("igbt", {"strategy": "spiral", "boards": 3, "bus": {"port": 7500}}).cell
    assert (cell.strategy, cell.boards, cell.bus.port, cell.bus.domain) == ("spiral", 3, 7500, 0)


def test_settings_of_a_strategy_are_given_to_it(tmp_path: Path) -> None:
    cell = load(write(tmp_path, TEXT + '\n[strategies.spiral]\nstep = "20 deg"\n')).cell
    made = registry.strategy("spiral", cell.strategies["spiral"], "cell")
    assert made == registry.load(registry.STRATEGIES, "spiral")(step=math.radians(20))


ROLES = ["strategy", "posterior", "assembly", "interlock", "light_curtain", "recorder", "viewer"]


def numbers_in(value: Any) -> set[float]:
    if isinstance(value, dict):
        return set().union(*map(numbers_in, value.values())) if value else set()
    if isinstance(value, list):
        return set().union(*map(numbers_in, value)) if value else set()
    return {value} if isinstance(value, int | float) and not isinstance(value, bool) else set()


@pytest.mark.parametrize("role", ROLES)
def test_only_the_simulation_is_told_the_tolerances_and_the_seed(role: str) -> None:
    cell_file: CellFile = load("igbt", {"seed": 987654321, "tolerances": {"hole_bias": "0.123 mm"}})
    seen = redacted(cell_file.document, role)
    assert "tolerances" not in seen
    assert 987654321 not in numbers_in(seen)
    assert "0.123" not in json.dumps(seen)
    assert redacted_cell(cell_file.cell, role).tolerances == Tolerances()
    assert redacted_cell(cell_file.cell, role).seed == seen["seed"]
    assert config.cell_of(seen, "cell").seed == seen["seed"]


def test_the_simulation_is_told_everything() -> None:
    cell_file = load("igbt", {"seed": 987654321})
    assert redacted(cell_file.document, "arm") == cell_file.document
    assert redacted_cell(cell_file.cell, "arm") is cell_file.cell


def test_evidence_is_kept_apart_by_world() -> None:
    scopes = {
        scope_of(load("igbt", overrides).document)
        for overrides in ({}, {"seed": 2}, {"tolerances": {"hole_bias": "1 mm"}})
    }
    assert len(scopes) == 3
    assert scope_of(load("igbt").document) == scope_of(load("igbt", {"strategy": "spiral", "boards": 4}).document)


def test_every_part_has_what_a_goal_needs() -> None:
    for name, part in COMPONENTS.items():
        assert part.name == name
        assert part.depth > 0
