"""After a stop: wherever it catches the arm, the same attempt goes on to the same end, and the part is not dropped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest
from cells import cell_text, write_cell

from drivers.ur3e.motion import Speed
from drivers.ur3e.parameters import CYCLE_NS
from drivers.ur3e.simulated_arm import SimulatedArm
from drivers.ur3e.simulated_cell import SimulatedCell
from drivers.ur3e.skill import Felt, InsertionSkill
from drivers.ur3e.workcell import Workcell
from runtime import config, topics
from runtime.cell import Board, Hole, Tolerances
from runtime.component import component
from runtime.in_process import run_in_process
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.messages import Outcome

MM = 1e-3
PART = component("igbt")
HOLE = Hole("h1", 0.0, 0.0, 0.0)
BOARD = Board("single", (HOLE,))
STOP = 500 * CYCLE_NS  # [ns] that the field is interrupted
BRAKING = 100 * CYCLE_NS  # [ns] after which the arm stands
Phase = Callable[[SimulatedArm], bool]


def height(arm: SimulatedArm) -> float:
    """Of the pin tips above the board [m]."""
    return arm.pose[0][2] - BOARD.z


def touching(arm: SimulatedArm) -> bool:
    return arm.controller.compliance is not None


def rising(arm: SimulatedArm) -> bool:
    return arm.controller.twist()[2] > 1e-3


# Name of the phase: whether the arm is in it, whether it carries the part then, path of the attempt
PHASES: dict[str, tuple[Phase, bool, tuple[float, ...]]] = {
    "pick": (lambda arm: arm.scene.part_waiting and height(arm) < 20 * MM, False, (0.0,)),
    "transfer": (lambda arm: arm.holding and height(arm) > 50 * MM and arm.pose[0][1] > -0.1, True, (0.0,)),
    "approach": (lambda arm: arm.holding and 2 * MM < height(arm) < 8 * MM and arm.pose[0][1] > -0.1, True, (0.0,)),
    "descent": (lambda arm: isinstance(arm.controller.motion, Speed) and height(arm) < 0.5 * MM, True, (0.0,)),
    "pressing in": (lambda arm: isinstance(arm.controller.motion, Speed) and height(arm) < -1 * MM, True, (0.0,)),
    "slide": (lambda arm: touching(arm) and arm.pose[0][0] > BOARD.x - 0.5 * MM, True, (-1.0, 1.0)),
    "easing": (lambda arm: touching(arm) and height(arm) < -0.15 * MM, True, (-1.0, 1.0)),
    "retract": (lambda arm: arm.holding and rising(arm) and 0 < height(arm) < 0.9 * MM, True, (3.0,)),
    "release": (lambda arm: not arm.holding and len(arm.scene.standing) == 1, False, (0.0,)),
}


@dataclass
class Course:
    """A part that is fetched, tried and let go, with a stop in one phase."""

    phase: Phase
    held: list[bool] = field(default_factory=list)  # whether the part was in the gripper, during the stop
    speeds: list[float] = field(default_factory=list)  # [rad/s] commanded while the arm is to stand
    begun: int | None = None  # [ns]
    gripped: list[bool] = field(default_factory=list)  # changes of the grip

    def gate(self, time: int) -> bool:
        return self.begun is None or not self.begun <= time < self.begun + STOP

    def observe(self, arm: SimulatedArm) -> None:
        if not self.gripped or self.gripped[-1] != arm.holding:
            self.gripped.append(arm.holding)
        if self.begun is None:
            if self.phase(arm):
                self.begun = arm.time
        elif arm.time < self.begun + STOP:
            self.held.append(arm.holding)
            if arm.time > self.begun + BRAKING:
                self.speeds.append(max(map(abs, arm.controller.qd)))

    def run(self, path: tuple[float, ...]) -> tuple[Felt, SimulatedCell]:
        cell = SimulatedCell(
            BOARD, PART, Tolerances(0.0, 0.0, 0.0, 0.0, 0.0, 0), fidelity="fast", gate=self.gate, observe=self.observe
        )
        skill = InsertionSkill(cell.arm, Workcell(), BOARD, PART)
        cell.begin_search(1, 1, "h1")
        skill.pick()
        felt = skill.slide(HOLE, [(x * MM, 0.0) for x in path])
        if felt.outcome is Outcome.SEATED:
            skill.release()
        return felt, cell


@cache
def undisturbed(path: tuple[float, ...]) -> tuple[Felt, list[bool]]:
    """What is felt, and how the grip changes, if nobody reaches in."""
    course = Course(lambda _: False)
    return course.run(path)[0], course.gripped


@pytest.mark.parametrize("name", PHASES)
def test_an_attempt_goes_on_where_it_was_stopped_and_ends_the_same(name: str) -> None:
    phase, carried, path = PHASES[name]
    expected, gripped = undisturbed(path)
    stopped = Course(phase)
    felt, cell = stopped.run(path)
    assert len(stopped.held) == STOP // CYCLE_NS - 1, "the stop came in this phase"
    assert max(stopped.speeds) == 0.0
    assert set(stopped.held) == {carried}
    assert stopped.gripped == gripped
    assert (felt.outcome, felt.reason) == (expected.outcome, "")
    assert felt.outcome is (Outcome.BLOCKED if name == "retract" else Outcome.SEATED)
    assert len(cell.scene.standing) == (felt.outcome is Outcome.SEATED)
    assert felt.depth == pytest.approx(expected.depth, abs=0.05 * MM)
    assert (felt.x, felt.y) == pytest.approx((expected.x, expected.y), abs=0.15 * MM)
    assert felt.peak_force < max(expected.peak_force, 5.0) + 3.0


def test_the_log_tells_what_a_stop_interrupted_and_that_it_went_on(tmp_path: Path) -> None:
    script = '[safety]\ninterruptions = [{ at = "6.5 s", clear_after = "0.6 s", reset_after = "0.4 s" }]\n'
    cell = write_cell(tmp_path, cell_text(holes=1).replace("[safety]\n", script))
    session = run_in_process(Order(config.load(str(cell)), tmp_path / "logs"))
    with open_log(session.log) as log:
        said = [(line.name, line.msg) for _, line in log.read(topics.ROSOUT) if line.name in ("arm", "interlock")]
        statuses = [(status.safety_mode, status.holding) for _, status in log.read(topics.ARM_STATUS)]
    begin = next(index for index, (_, text) in enumerate(said) if text.startswith("stopped"))
    tripped = next(text for name, text in said if name == "interlock" and "tripped" in text)
    assert "interrupted" in tripped
    doing, goes_on = said[begin][1], next(text for _, text in said[begin:] if text.startswith("goes on"))
    assert doing.startswith("stopped during board 1 hole 1: attempt 1 with igbt, TCP ")
    assert goes_on == "goes on with board 1 hole 1: attempt 1 after 1.00 s"
    assert (5, "igbt") in statuses
