"""A real UR3e, or a controller simulated on the network, as a plugin: the same job by wire."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from ipaddress import ip_address
from typing import Annotated

from pydantic import Field

from drivers.ur3e.arm import PROTECTIVE_STOP
from drivers.ur3e.real_time_gate import RealTimeGate
from drivers.ur3e.search_service import SearchService
from drivers.ur3e.skill import Felt, InsertionSkill, SkillSettings
from drivers.ur3e.ur_connection import ANSWER_REGISTER, ConnectionLostError, UrConnection
from drivers.ur3e.wired_arm import WiredArm
from drivers.ur3e.workcell import Workcell
from runtime import topics
from runtime.bus import Envelope
from runtime.component import component
from runtime.config import Cell
from runtime.context import Context
from runtime.errors import ArmError, CellError, SessionError
from runtime.messages import NANOSECONDS, SearchGoal
from runtime.quantity import Duration, Frequency, NotNegative, Positive

_SEARCH, _BOARD, _HOLE = 18, 19, 20  # input integer registers; the search number is written last
_SHORTEST_PERMIT = 0.1  # [s] five ticks of session time
_NEAR_BOARD = 3e-3  # [m] of the pin tips above the board: from there straight up is safe
_HOST = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(\.[A-Za-z0-9-]{1,63})*\.?")


@dataclass(frozen=True)
class UrRtde:
    """UR3e e-Series on the network through ur-rtde, PolyScope 5.10 or later; real time, whatever `rate` says.

        robot = "ur_rtde"

        [drivers.ur_rtde]
        address = "192.168.0.10"

    The gripper is on tool digital output 0. With `handshake` the cell's controller (a PLC, or the simulated
    controller) is told which part comes next: board number in general purpose input integer register 19, the hole's
    number on the board from 1 in 20, then the search number in 18. It has the part and the board in place, and answers
    with the search number in output integer register 19. A 0 in 18 takes the question back, and the answer with it: so
    every session begins, with a board in which nothing is yet.
    `part_sensor` is the digital input that is on while the gripper has a part: 0-7 standard, 8-15 configurable, 16-17
    at the tool. Without one a part that was dropped is not noticed: a peck without it ends at depth like a seated one.

    Without `handshake` nobody answers: the arm waits `feed_time` before each part, at home if the board is a fresh one,
    for a person or a feeder that needs no word.

    The arm begins by going straight up from where it stands, and then to its home configuration. Without a permit the
    speed slider is held at 0: an operational stop, no safety function. The light curtain of a real arm has to be wired
    to the controller's safeguard input. An emergency stop that the interlock hears of takes the power from the drives
    as well, once the arm stands, and ends the session; the one that counts is wired to the controller.

    `simulated = true` says that the controller at `address` is a simulated one, so that what is learnt there is
    never taken for evidence of a real board; an address on this machine needs it.
    """

    address: str = ""
    simulated: bool = False
    power_on: bool = False  # power the arm on and release its brakes if need be; false: a person does
    speed_limit: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0  # fraction of the speed slider
    handshake: bool = True
    present_timeout: Annotated[Duration, Positive] = 30.0  # [s] for the cell to present a part
    feed_time: Annotated[Duration, NotNegative] = 5.0  # [s]
    watchdog: Annotated[Frequency, Field(ge=1.0, le=100.0)] = (
        10.0  # [Hz] the arm halts if it hears less often from here
    )
    protective_stops: Annotated[int, Field(ge=0, le=40)] = 3  # that are recovered from in one session
    part_sensor: Annotated[int, Field(ge=0, le=17)] | None = None
    workcell: Workcell = field(default_factory=Workcell)
    skill: SkillSettings = field(default_factory=SkillSettings)

    def check(self, cell: Cell, where: str) -> None:
        """Raise CellError for what is no address, permits too short to renew, or a place out of the arm's reach."""
        from drivers.ur3e.reach import unreachable

        _check_address(self.address, self.simulated, f"{where}: drivers.ur_rtde")
        if find_spec("rtde_control") is None:
            raise CellError(f"{where}: robot = \"ur_rtde\" needs the package ur-rtde: pip install 'palpate[ur]'")
        if cell.safety.deadline < _SHORTEST_PERMIT:
            raise CellError(
                f"{where}: safety.deadline: a permit that holds {cell.safety.deadline * 1e3:g} ms ends before the next "
                f"one is there; an arm on the network needs {_SHORTEST_PERMIT * 1e3:g} ms or more"
            )
        beyond = unreachable(cell, self.workcell)
        if beyond:
            raise CellError(f"{where}: {beyond}")

    def run(self, context: Context) -> None:
        """Serve searches until the cell closes; the arm is halted when this returns."""
        _check_address(self.address, self.simulated, "drivers.ur_rtde")
        gate = RealTimeGate(context, context.bus.publisher(topics.CLOCK))
        service = _WiredService(context, self, gate)
        connection = UrConnection(self.address, power_on=self.power_on)
        arm = WiredArm(
            connection,
            speed_limit=self.speed_limit,
            watchdog=self.watchdog,
            gate=gate,
            observe=service.after_cycle,
        )
        try:
            service.equip(arm)
            service.run()
        finally:
            arm.close()


class _WiredService(SearchService):
    """Serves searches with an arm on the network, in a cell that has its own controller, or a person."""

    _arm: WiredArm

    def __init__(self, context: Context, settings: UrRtde, gate: RealTimeGate) -> None:
        super().__init__(context)
        self._settings = settings
        self._gate = gate
        self._board = 0  # number of the board in place
        self._protective_stops = 0

    def equip(self, arm: WiredArm) -> None:
        """Give the service its arm; sets TCP and payload there."""
        cell, settings = self._context.cell, self._settings
        self._arm = arm
        self._skill = InsertionSkill(arm, settings.workcell, cell.board, component(cell.component), settings.skill)

    def after_cycle(self) -> None:
        """What the arm calls after every cycle of the session."""
        held, arm = self._gate.held, self._arm
        self._after_cycle(arm)
        if held.emergency and arm.standing and arm.power_off():
            self._do("halted")
            self._telemetry.publish_status(arm)
            raise SessionError(
                f"{held.reason}: the arm is halted and its drives are without power; power it on, then launch again"
            )

    @property
    def _waiting(self) -> deque[Envelope]:
        return self._gate.waiting

    def _wait_for_arrival(self) -> None:
        self._arm.cycle()

    def _wait_for_first_permit(self) -> None:
        self._arm.begin_session()
        while not (self._gate.permits(self._arm.time) or self._context.stopping):
            self._arm.cycle()

    def _halted(self) -> bool:
        return (self._context.stopping or self._gate.lost) and self._arm.standing

    def _check(self) -> None:
        self._gate.check()

    def _last_words(self, error: ArmError) -> str:
        return str(error) if isinstance(error, ConnectionLostError) else super()._last_words(error)

    def _present(self, goal: SearchGoal) -> None:
        first, fresh = self._board == 0, goal.board != self._board
        if fresh:
            self._do("home")
            self._skill.home()
            self._board = goal.board
        if not self._settings.handshake:
            self._do(f"waiting for {'a board and ' if fresh else ''}a part")
            self._pause(self._settings.feed_time)
            return
        self._do("waiting for the cell to present a part")
        names = [hole.name for hole in self._context.cell.board.holes]
        if first:
            self._arm.announce([(_SEARCH, 0)])
            self._await_cell(lambda answer: answer == 0, "take back what it answered to another session")
        self._arm.announce([(_BOARD, goal.board), (_HOLE, names.index(goal.hole) + 1), (_SEARCH, goal.search)])
        self._await_cell(lambda answer: answer == goal.search, f"present a part for search {goal.search}")

    def _await_cell(self, done: Callable[[int], bool], what: str) -> None:
        timeout = self._settings.present_timeout
        deadline = self._arm.time + round(timeout * NANOSECONDS)
        while not done(self._arm.answer):
            if self._arm.time > deadline:
                raise ArmError(
                    f"the cell did not {what} within {timeout:g} s: output integer register {ANSWER_REGISTER} "
                    f"is {self._arm.answer}"
                )
            self._arm.cycle()

    def _pause(self, duration: float) -> None:
        end = self._arm.time + round(duration * NANOSECONDS)
        while self._arm.time < end:
            self._arm.cycle()

    def _has_part(self) -> bool:
        sensor = self._settings.part_sensor
        return sensor is None or self._arm.digital_input(sensor)

    def _recover(self, felt: Felt) -> None:
        """Release a protective stop met at the board, have the control program again, and go straight up."""
        arm, context = self._arm, self._context
        protective = arm.safety_mode == PROTECTIVE_STOP
        if not (protective or arm.program_ended):
            return
        if protective and not self._attended:  # or else a person has looked
            self._protective_stops += 1
            if self._protective_stops > self._settings.protective_stops:
                raise ArmError(
                    f"{self._protective_stops} protective stops in this session, "
                    f"{self._settings.protective_stops} are allowed: {felt.reason}"
                )
            if felt.tcp_position[2] > context.cell.board.z + self._settings.workcell.approach_height + _NEAR_BOARD:
                raise ArmError(f"{felt.reason}, away from the board; look what was hit, and release the stop by hand")
        self._do("recover")
        context.log(f"{felt.reason}: recovering")
        arm.recover()
        pose = arm.getActualTCPPose()
        pose[2] = max(pose[2], context.cell.board.z + self._settings.workcell.clearance_height)
        if not arm.moveL(pose, self._settings.skill.retract_speed, self._settings.workcell.acceleration):
            raise ArmError("another protective stop on the way up from the board")


def _check_address(address: str, simulated: bool, where: str) -> None:
    """Raise CellError for what is no address, or for one on this machine that is said to be a real arm."""
    if not address:
        raise CellError(f'{where}.address: missing; write the controller\'s, such as address = "192.168.0.10"')
    try:
        loopback = ip_address(address).is_loopback
    except ValueError:
        numeric = re.fullmatch(r"[\d.]+", address) is not None
        if numeric or _HOST.fullmatch(address) is None:
            raise CellError(f"{where}.address: {address!r} is neither an IP address nor a host name") from None
        loopback = address.rstrip(".").lower() == "localhost"
    if loopback and not simulated:
        raise CellError(f"{where}: {address} is this machine, so no real arm: write simulated = true")
