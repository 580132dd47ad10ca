"""The programs of a control box: compiled elsewhere, run here one control cycle at a time, stopped when they err."""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.ur3e.control_box.events import CompileError, ProgramStarted, ProgramStopped, RuntimeException
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.script_builtins import Robot
from drivers.ur3e.control_box.watchdog import Watchdog
from drivers.ur3e.urscript.compile_worker import Compiler
from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.program import Program
from drivers.ur3e.urscript.script import Script

if TYPE_CHECKING:
    from drivers.ur3e.control_box.box import ControlBox

_WAITING = 20  # programs that may wait for the compiler before new ones are refused
_BESIDE = 10  # secondary programs that may run at once
_EXTENSION = ".script"  # .urp programs are PolyScope's own, and are not known here


class LoadResult(Enum):
    """What became of loading a program."""

    LOADED = "loaded"
    NOT_FOUND = "not found"
    BROKEN = "broken"


class Programs:
    """The program that has the arm, the secondary ones beside it, and those that are being compiled."""

    def __init__(self, box: ControlBox, folder: Path | None, seed: int) -> None:
        self._box = box
        self._folder = folder
        self._robot = Robot(box, seed)
        self._compiler = Compiler({name: builtin.timed for name, builtin in self._robot.table.items()})
        self._origins: dict[int, str] = {}
        self._main: Program | None = None
        self._beside: list[Program] = []
        self._text = ""  # of the loaded program
        self.paused = False
        self.name = ""
        self.loaded = ""
        self.ended_at = -math.inf  # [s] controller time at which the last program ended
        self.watchdog: Watchdog | None = None
        self.spoken: deque[str] = deque(maxlen=200)  # latest text messages

    @property
    def state(self) -> RuntimeState:
        """Stopped, playing or paused."""
        if self._main is None:
            return RuntimeState.STOPPED
        return RuntimeState.PAUSED if self.paused else RuntimeState.PLAYING

    @property
    def line(self) -> int:
        """Line in which the program is at present; 0 without one."""
        return 0 if self._main is None else self._main.line

    def submit(self, text: str, origin: str) -> None:
        """Have a program compiled; it starts in the cycle in which that is done."""
        if len(self._origins) >= _WAITING:
            self._box.log(f"{origin}: program refused, {_WAITING} others wait to be compiled")
            return
        self._origins[self._compiler.submit(text)] = origin

    @property
    def compiling(self) -> bool:
        """Whether a program that was sent has not started yet."""
        return bool(self._origins)

    def load(self, name: str) -> LoadResult:
        """Read a program from the folder; only URScript can be."""
        if self._folder is None:
            return LoadResult.NOT_FOUND
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder.resolve()) or not path.is_file():
            return LoadResult.NOT_FOUND
        if path.suffix != _EXTENSION:
            return LoadResult.BROKEN
        try:
            self._text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return LoadResult.BROKEN
        self.stop()
        self.loaded = name
        return LoadResult.LOADED

    def play(self) -> bool:
        """Go on, or start what was loaded."""
        box = self._box
        if box.robot_mode != RobotMode.RUNNING or box.safety_mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            return False
        if self._main is not None:
            self.paused = False
            return True
        if not self.loaded:
            return False
        self.submit(self._text, self.loaded)
        return True

    def pause(self) -> bool:
        """Hold the program where it is."""
        if self._main is None or self.paused:
            return False
        self.paused = True
        return True

    def stop(self) -> bool:
        """End the program, and those beside it."""
        for program in self._beside:
            program.stop()
        self._beside.clear()
        if self._main is None:
            return False
        self._main.stop()
        self._finish()
        return True

    def close(self) -> None:
        """End everything, the compiler too."""
        self.stop()
        self._compiler.close()

    def advance(self) -> None:
        """One control cycle of every program."""
        if self._origins:
            self._take_compiled()
        if self._beside:
            self._beside = [program for program in self._beside if self._tick(program)]
        main = self._main
        if main is not None:
            self._watch()
            if not self.paused and self._main is not None and not self._tick(main) and self._main is main:
                self._finish()
        self._robot.after_programs()

    def _take_compiled(self) -> None:
        for ticket, result in self._compiler.poll():
            origin = self._origins.pop(ticket, "")
            if isinstance(result, ScriptError):
                self._box.events.append(CompileError(result.line, result.column, result.text))
                self._box.log(f"{origin}: program refused, line {result.line}: {result.text}")
            else:
                self._start(result, origin)

    def _start(self, script: Script, origin: str) -> None:
        box = self._box
        program = Program(script, self._robot.table)
        if script.kind == "sec":
            if len(self._beside) >= _BESIDE:
                box.log(f"{origin}: secondary program {script.name!r} refused, {_BESIDE} run already")
                return
            self._beside.append(program)
            return
        if box.robot_mode != RobotMode.RUNNING or box.safety_mode == SafetyMode.PROTECTIVE_STOP:
            box.log(
                f"{origin}: program {script.name!r} refused: robot mode {box.robot_mode.name.lower()}, "
                f"safety mode {box.safety_mode.name.lower()}"
            )
            return
        self.stop()
        self._main, self.paused, self.name = program, False, script.name
        box.events.append(ProgramStarted(script.name))
        box.log(f"{origin}: program {script.name!r} started")

    def _tick(self, program: Program) -> bool:
        """Whether the program goes on."""
        try:
            goes_on = self._robot.run(program)
        except ScriptError as error:
            self._box.events.append(RuntimeException(error.line, error.column, error.text))
            self._box.log(f"program {program.name!r} stopped in line {error.line}: {error.text}")
            return False
        if program.wants_pause:
            program.wants_pause = False
            self.paused = goes_on
        return goes_on

    def _finish(self) -> None:
        self._main, self.paused, self.watchdog = None, False, None
        self.ended_at = self._box.time
        self._robot.after_main()
        self._box.events.append(ProgramStopped(self.name))
        self._box.log(f"program {self.name!r} ended")

    def _watch(self) -> None:
        dog = self.watchdog
        if dog is None or not dog.bites(self._box.fed.get(dog.variable, 0), self._box.time):
            return
        self.watchdog = None
        self._box.log(f"watchdog: {dog.variable} has not come within {dog.period:g} s: {dog.action}")
        if dog.action == "stop":
            self.stop()
        elif dog.action == "pause":
            self.pause()
