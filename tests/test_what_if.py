"""Other strategies on the holes that a log found."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_reexecution import GOLDEN, Item, changed, said

from runtime import messages as m
from runtime import topics as t
from runtime.component import COMPONENTS
from runtime.errors import LogError, PluginError
from runtime.experiment.what_if import Logged, LoggedHole, logged, swept, what_if
from runtime.log.file import open_log
from runtime.world import Gap

MM = 1e-3
IGBT = COMPONENTS["igbt"]


def of(name: str) -> Logged:
    with open_log(GOLDEN / f"{name}.mcap") as log:
        return logged(log)


def goal() -> m.SearchGoal:
    return of("spiral").holes[0].goal


@settings(max_examples=12, deadline=None)
@given(
    place=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    tried=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=12),
    seed=st.integers(0, 99),
)
def test_places_agree_with_every_attempt(
    place: tuple[float, float], tried: list[tuple[float, float]], seed: int
) -> None:
    """The hole is somewhere, attempts tell what they meet there, and each place drawn would have told the same."""
    truth = Gap(IGBT, place[0] * MM, place[1] * MM, 0.0, 0.0, 0.0)
    points = [(x * MM, y * MM) for x, y in tried]
    blocked = [point for point in points if not truth.feasible(*point)]
    entered = (truth.x + 0.05 * MM, truth.y)
    assert truth.feasible(*entered)
    hole = LoggedHole(goal(), len(blocked) + 1, tuple(swept([point]) for point in blocked), entered)
    places, agree = hole.places(np.random.default_rng(seed), 10)
    assert agree
    margin = 2e-6  # [m] the area is known by its rim in 360 directions
    for x, y in places.tolist():
        drawn = Gap(IGBT, x, y, 0.0, 0.0, 0.0)
        assert drawn.feasible(*entered, 1.02)
        assert not any(drawn.feasible(*point, 0.98) for point in blocked)
    assert max(math.dist(each, (truth.x, truth.y)) for each in places.tolist()) < 1.2 * MM + margin


def test_places_after_a_slide_lie_where_it_ended_and_not_where_it_passed() -> None:
    path = [(-1.0 * MM, 0.0), (1.0 * MM, 0.0)]
    hole = LoggedHole(goal(), 1, (swept(path, 0.9 * MM),), (0.0, 0.0), slid_in=True)
    places, agree = hole.places(np.random.default_rng(1), 20)
    assert agree
    assert places[:, 0].min() > -0.1 * MM
    assert np.abs(places[:, 1]).max() < 0.7 * MM


def test_a_hole_that_was_not_found_is_ruled_out_where_it_was_tried_alone() -> None:
    hole = LoggedHole(goal(), 1, (swept([(0.0, 0.0)]),), None)
    assert hole.rules_out([(0.0, 0.0)])
    assert not hole.rules_out([(0.1 * MM, 0.0)])
    around = tuple(swept([(x * 0.05 * MM, y * 0.05 * MM)]) for x in range(-9, 10) for y in range(-9, 10))
    assert LoggedHole(goal(), len(around), around, None).rules_out([(0.02 * MM, 0.01 * MM)])
    assert not hole.rules_out([(0.0, 0.0), (2 * MM, 0.0)])


@pytest.mark.parametrize("name", ["linear", "spiral", "hybrid"])
def test_the_recorded_strategy_needs_in_the_model_about_what_it_needed(name: str) -> None:
    """Without belief or board to share, a strategy of fixed patterns meets the same blocks and the same hole again."""
    log = of(name)
    again = what_if(log, draws=6).outlook(name)
    assert again.found == [log.found] * 6
    assert again.bounded == [0] * 6
    assert min(again.attempts) <= log.attempts * 1.5
    first = log.holes[0]
    assert len(first.blocked) == first.attempts - 1


def test_draws_are_the_same_each_time_and_for_every_strategy() -> None:
    log = of("spiral")
    some, others = what_if(log, draws=3), what_if(log, draws=3)
    assert some.draws == others.draws
    assert some.outlook("bayes") == others.outlook("bayes")
    with pytest.raises(PluginError, match="no strategy 'tarot' is installed; known: bayes,"):
        some.outlook("tarot")


def test_a_search_begins_from_the_evidence_of_the_log() -> None:
    """The golden sessions are the second of their board type: without what the first found, more attempts are due."""
    log = of("meta")
    assert log.holes[0].goal.seats
    blank = replace(log, holes=tuple(replace(hole, goal=replace(hole.goal, seats=[], misses=[])) for hole in log.holes))
    # Boards are numbered on from what is known, so the searches have other numbers then.
    renumbered = replace(
        blank,
        holes=tuple(replace(hole, goal=replace(hole.goal, search=i)) for i, hole in enumerate(blank.holes, 1)),
    )
    assert what_if(log, draws=4).outlook("meta").attempts != what_if(renumbered, draws=4).outlook("meta").attempts


def test_the_table_and_what_it_is_worth(capsys: pytest.CaptureFixture[str]) -> None:
    log = of("exhausted")
    code, out, _ = said(capsys, "replay", GOLDEN / "exhausted.mcap", "--what-if", "linear, spiral")
    assert code == 0
    rows = [line for line in out.splitlines() if " of 2 " in line]
    assert [row.split("  ")[0] for row in rows] == ["spiral, as recorded", "spiral, again in the model", "linear"]
    assert rows[0].split()[3:5] == [str(log.attempts), f"{log.attempts / 2:.2f}"]
    assert "the statistical model, not physics" in out
    assert "One log is one example" in out
    assert "A hole that the log never found" not in out
    code, out, _ = said(capsys, "replay", GOLDEN / "exhausted.mcap", "--what-if", "meta")
    assert code == 0
    assert next(line for line in out.splitlines() if line.startswith("meta")).split()[1] == ">="
    assert "A hole that the log never found is only bounded" in out


def test_a_hole_that_was_never_found_counts_up_to_what_was_tried(tmp_path: Path) -> None:
    log = of("exhausted")
    assert log.found == 1
    outlook = what_if(log, draws=3).outlook("meta")
    assert all(bounded in (0, 1) for bounded in outlook.bounded)
    assert all(found <= 1 for found in outlook.found)

    def all_blocked(item: Item) -> Item:
        if item.topic == t.ATTEMPT.name:
            return replace(item, message=replace(item.message, outcome=m.Outcome.BLOCKED))
        if item.topic == t.SEARCH_RESULT.name:
            return replace(item, message=replace(item.message, ending=m.Ending.EXHAUSTED))
        return item

    with open_log(changed(GOLDEN / "linear.mcap", tmp_path / "x.mcap", all_blocked)) as file:
        nothing = logged(file)
    assert nothing.found == 0
    outlook = what_if(nothing, draws=2).outlook("linear")
    # What it tried before is ruled out, so it goes at least as far as the log; its next place nothing rules out.
    assert outlook.attempts[0] > nothing.attempts
    assert outlook.attempts[0] == outlook.attempts[1]
    assert outlook.found == [0, 0]


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def no_search(item: Item) -> Item | None:
        return None if item.topic == t.SEARCH_RESULT.name else item

    without = changed(GOLDEN / "linear.mcap", tmp_path / "without.mcap", no_search)
    for arguments, words in (
        ((GOLDEN / "linear.mcap", "--what-if", "tarot"), "no strategy 'tarot' is installed; known: bayes,"),
        ((GOLDEN / "linear.mcap", "--what-if", ","), "names no strategy"),
        ((without, "--what-if", "bayes"), "holds no finished search"),
    ):
        code, out, err = said(capsys, "replay", *arguments)
        assert (code, out) == (2, "")
        assert words in err
        assert err.count("\n") == 1
    with pytest.raises(LogError), open_log(without) as log:
        logged(log)
