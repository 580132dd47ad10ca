"""Everything a program can call, in one table, and the running of programs under it."""

from __future__ import annotations

from inspect import isgeneratorfunction
from typing import TYPE_CHECKING

from drivers.ur3e.control_box.script_io import IoBuiltins
from drivers.ur3e.control_box.script_motion import MotionBuiltins
from drivers.ur3e.control_box.script_sockets import SocketBuiltins
from drivers.ur3e.control_box.script_state import StateBuiltins
from drivers.ur3e.control_box.version import PolyScope
from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.program import Program
from drivers.ur3e.urscript.pure_builtins import pure_builtins

if TYPE_CHECKING:
    from drivers.ur3e.control_box.box import ControlBox

# Steps of a program's budget that a call costs, where it is much more than one: a step is about 0.1 us.
_COSTS = {
    "get_inverse_kin": 600,
    "get_inverse_kin_has_solution": 600,
    "get_forward_kin": 200,
    "get_actual_tool_flange_pose": 200,
    "get_target_tool_flange_pose": 200,
    "is_within_safety_limits": 600,
    "get_mass_matrix": 200,
    "get_coriolis_and_centrifugal_torques": 200,
    "get_jacobian": 200,
    "get_jacobian_time_derivative": 400,
    "get_freedrive_status": 300,
    "movej": 1000,
    "movel": 1500,
    "movep": 1500,
    "movec": 1500,
    "optimovej": 1000,
    "optimovel": 1500,
    "socket_open": 1000,
}
# PolyScope version from which on a function exists; before it, a program that calls it is refused, as on a UR.
_SINCE = {
    "optimovej": (5, 21),
    "optimovel": (5, 21),
    "direct_torque": (5, 23),
    "get_mass_matrix": (5, 23),
    "get_coriolis_and_centrifugal_torques": (5, 23),
    "get_target_joint_accelerations": (5, 23),
    "get_jacobian": (5, 23),
    "get_jacobian_time_derivative": (5, 23),
}


class Robot:
    """The functions of one control box, for all its programs."""

    def __init__(self, box: ControlBox, seed: int) -> None:
        self._running: Program | None = None
        self._motion = MotionBuiltins(box, self._thread)
        self._sockets = SocketBuiltins()
        self._box = box
        self.table: dict[str, Builtin] = dict(pure_builtins(seed))
        for group in (self._motion, StateBuiltins(box), IoBuiltins(box), self._sockets):
            for name in _functions_of(type(group)):
                if _exists(name, box.version):
                    call = getattr(group, name)
                    self.table[name] = Builtin(call, isgeneratorfunction(call), _COSTS.get(name, 1))

    def _thread(self) -> object:
        """The thread that runs now."""
        program = self._running
        return None if program is None else (id(program), program.current)

    def run(self, program: Program) -> bool:
        """One control cycle of a program; whether it goes on. Raises ScriptError if it errs."""
        self._running = program
        try:
            return program.tick()
        finally:
            self._running = None

    def after_programs(self) -> None:
        """Every program has had its cycle."""
        self._motion.after_programs()
        self._sockets.after_programs()

    def after_main(self) -> None:
        """The main program is over: what lives no longer than it does ends too."""
        self._sockets.close_all()
        self._box.hold()
        self._box.external_sensor = False


# What the groups have for the box, not for programs.
_INTERNAL = {"after_programs", "close_all"}


def _functions_of(group: type) -> list[str]:
    return [name for name in vars(group) if not name.startswith("_") and name not in _INTERNAL]


def _exists(name: str, version: PolyScope) -> bool:
    return (version.major, version.minor) >= _SINCE.get(name, (0, 0))
