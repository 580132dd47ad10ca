"""A control box on its ports, in real time: what `palpate robot` runs, and tests run in a thread.

with RobotServer(box):
    arm = RTDEControlInterface("127.0.0.1")
"""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Self

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.dashboard import DashboardConversation
from drivers.ur3e.control_box.ports import Limits, Ports
from drivers.ur3e.control_box.realtime import RealtimePackage
from drivers.ur3e.control_box.rtde import RtdePort
from drivers.ur3e.control_box.script_port import PrimaryConversation, RealtimeConversation, SecondaryConversation
from drivers.ur3e.parameters import CYCLE
from runtime.clock import Metronome

_PRIORITY = 20  # of the control loop among real-time processes, where the system lets us
_SWEEP = 500  # cycles between collections of short-lived cyclic garbage
_LATE = CYCLE  # [s] a cycle that begins later than this has lost its beat


@dataclass(frozen=True)
class Numbers:
    """Port numbers; those of a UR controller, which clients have built in. 0: any that is free."""

    dashboard: int = 29999
    primary: int = 30001
    secondary: int = 30002
    realtime: int = 30003
    rtde: int = 30004


@dataclass
class Beat:
    """How well the control loop keeps its time."""

    cycles: int = 0
    overruns: int = 0  # cycles that began later than a whole cycle after they were due
    longest: float = 0.0  # [s] of machine time for one cycle, with its clients


class RobotServer:
    """Serves one control box until it is shut down, or `stop` is called. Raises InputError if a port is taken."""

    def __init__(
        self,
        box: ControlBox,
        host: str = "127.0.0.1",
        numbers: Numbers | None = None,
        *,
        limits: Limits | None = None,
        after_cycle: Callable[[], None] | None = None,
    ) -> None:
        self.box = box
        self.host = host
        self.beat = Beat()
        self.real_time = False  # whether the system gives the loop precedence
        self._after_cycle = after_cycle
        self._rtde = RtdePort(box)
        box.fed = self._rtde.fed
        wanted = numbers or Numbers()
        package = RealtimePackage(box)
        self.ports = Ports(
            host,
            {
                "dashboard": (wanted.dashboard, partial(DashboardConversation, box)),
                "primary": (wanted.primary, partial(PrimaryConversation, box)),
                "secondary": (wanted.secondary, partial(SecondaryConversation, box)),
                "realtime": (wanted.realtime, lambda peer: RealtimeConversation(box, peer, package)),
                "rtde": (wanted.rtde, self._rtde.conversation),
            },
            box.log,
            limits,
        )
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    @property
    def numbers(self) -> Numbers:
        """The ports that are listened on."""
        number = self.ports.number
        names = ("dashboard", "primary", "secondary", "realtime", "rtde")
        return Numbers(*(number(name) for name in names))

    def run(self) -> None:
        """The control loop: 500 times a second what clients sent, the box, what clients get."""
        self.real_time = _take_precedence()
        metronome = Metronome(CYCLE)
        beat, ports, box, rtde = self.beat, self.ports, self.box, self._rtde
        gc.collect()
        gc.freeze()
        was_on = gc.isenabled()
        gc.disable()  # a full collection takes longer than a cycle; short-lived garbage is swept below
        try:
            while not (self._stop.is_set() or box.ended):
                late = metronome.wait()
                if beat.cycles:
                    beat.overruns += late > _LATE
                ports.receive()
                box.cycle()
                rtde.cycle()
                ports.cycle()
                box.events.clear()
                if self._after_cycle is not None:
                    self._after_cycle()
                beat.cycles += 1
                beat.longest = max(beat.longest, CYCLE - metronome.left)
                if beat.cycles % _SWEEP == 0:
                    gc.collect(0)
        finally:
            if was_on:
                gc.enable()
            gc.unfreeze()
            box.programs.close()
            ports.close()

    def stop(self) -> None:
        """End the loop after the cycle under way; from any thread."""
        self._stop.set()

    def _run_in_thread(self) -> None:
        try:
            self.run()
        except BaseException as error:
            self._failure = error

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._run_in_thread, name="control box", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        assert self._thread is not None
        self._thread.join()
        if self._failure is not None and error is None:
            raise self._failure


def _take_precedence() -> bool:
    """Ask the system to run this thread before others, as a controller's would be; whether it agreed."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, OSError):
        return False
    return True
