"""The loop that paces an arm on the network: RTDE's 500 Hz in, one `cycle` each, and what hangs on it.

Everything happens in the thread of whoever calls. Motions are begun asynchronously and waited for cycle by cycle, so
the permit is looked at, the trace is kept and session time is told every 2 ms, whatever the arm is doing. The same loop
feeds the watchdog of the control program: if it stands still, the program ends and the arm stops by itself.

Without a permit the speed slider goes to 0. The arm slows down along its path, stands, and goes on when the slider goes
back up; the control program stays. That is an operational stop. It passes through this computer and the network and is
no safety function: on a real arm the light curtain has to be wired to the controller's safeguard input as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from drivers.ur3e.arm import PROTECTIVE_STOP, RUNNING, SAFEGUARD_STOP
from drivers.ur3e.parameters import CYCLE, CYCLE_NS
from drivers.ur3e.ur_connection import PLAYING, ConnectionLostError, Sample, UrConnection
from runtime.clock import Stopwatch, pause
from runtime.errors import ArmError
from runtime.messages import NANOSECONDS

ResultT = TypeVar("ResultT")

_SILENCE = 1.0  # [s] of machine time without a sample until the connection counts as lost
_POLL = 2e-4  # [s] between looks for the next sample
_PROMPT = 1e-3  # [s] most calls to the control program that do not wait return within
_REPEAT = 100_000_000  # [ns] between commands to a speed slider that does not follow
_OBEDIENCE = 500_000_000  # [ns] the slider may take to reach 0
_RELEASE = 5_000_000_000  # [ns] the slider may take to leave 0
_SLIDER = 1e-3  # fraction of the slider that is no difference
_STILL = 1e-3  # [rad/s]
_ANSWER = 1_000_000_000  # [ns] for the controller to show what was set
_EMERGENCIES = {6: "emergency stop", 7: "emergency stop", 8: "safety violation", 9: "safety fault"}
_SAFEGUARDS = (5, 12, 13)  # safeguard stop, automatic mode safeguard stop, three position enabling switch
_ENDED = (0, 1)  # runtime states: stopping, stopped


class WiredLoop:
    """The loop over a `UrConnection`.

    `gate` is asked in every cycle of a session whether motion is permitted; `observe` is called after it. Without a
    permit, as during the controller's own safeguard stop, the safety mode reads 5.
    """

    def __init__(
        self,
        connection: UrConnection,
        *,
        gate: Callable[[int], bool],
        speed_limit: float = 1.0,  # fraction of the speed slider while motion is permitted
        watchdog: float = 10.0,  # [Hz] the arm stops by itself if it hears less often from here
        observe: Callable[[], None] | None = None,
    ) -> None:
        self._wires = connection
        self._speed_limit = speed_limit
        self._watchdog = watchdog
        self._gate = gate
        self._observe = observe
        self._sample: Sample = connection.sample()
        self._fraction_before = self._sample.speed_fraction
        self._origin: float | None = None  # [s] controller time at which the session began
        self._time = 0  # [ns]
        self._permitted = False
        self._slid = self._obeyed = self._called = 0  # [ns] slider commanded, slider seen right, program last addressed
        self._protected = 0  # [ns] when the last protective stop was seen
        self._slide(0.0)

    @property
    def time(self) -> int:
        """Session time [ns] of the latest sample; 0 before the session."""
        return self._time

    @property
    def safety_mode(self) -> int:
        """1 normal, 3 protective stop, 5 safeguard stop or no permit."""
        mode = self._sample.safety_mode
        if mode in _SAFEGUARDS or (mode != PROTECTIVE_STOP and not self._permitted):
            return SAFEGUARD_STOP
        return mode

    @property
    def standing(self) -> bool:
        """Whether the arm neither moves nor is told to."""
        return max(map(abs, self._sample.target_qd)) < _STILL and max(map(abs, self._sample.actual_qd)) < 10 * _STILL

    @property
    def answer(self) -> int:
        """What the cell's controller has in its register."""
        return self._sample.answer

    def digital_input(self, number: int) -> bool:
        """Whether an input is on: 0-7 standard, 8-15 configurable, 16-17 at the tool."""
        return bool(self._sample.digital_inputs >> number & 1)

    @property
    def program_ended(self) -> bool:
        """Whether the control program no longer runs on the arm."""
        return self._sample.runtime_state in _ENDED

    # The session

    def begin_session(self) -> None:
        """Session time begins: from here on the gate is asked, and the watchdog wants to be fed."""
        self._command(partial(self._wires.control.setWatchdog, self._watchdog), "set its watchdog")
        self._origin = self._sample.timestamp

    def cycle(self) -> None:
        """Wait for the next sample; see that nothing moves without a permit, and that the watchdog is fed.

        Raises ConnectionLostError if there is none, ArmError after an emergency stop or if the arm cannot be held.
        """
        self._receive()
        sample = self._sample
        if self._origin is None:
            return
        self._time = round((sample.timestamp - self._origin) / CYCLE) * CYCLE_NS
        if sample.safety_mode == PROTECTIVE_STOP:
            self._protected = self._protected or self._time
        else:
            self._protected = 0
        self._govern(self._gate(self._time))
        self._feed()
        if self._observe is not None:
            self._observe()
        if sample.safety_mode in _EMERGENCIES:
            raise ArmError(f"{_EMERGENCIES[sample.safety_mode]}: clear it on the pendant, then launch again")
        if sample.robot_mode != RUNNING:
            raise ArmError(f"the arm is no longer powered (robot mode {sample.robot_mode})")

    def announce(self, values: Sequence[tuple[int, int]]) -> None:
        """Write input integer registers, in this order: (number, value) each. The cell's controller reads them."""
        for register, value in values:
            self._send(partial(self._wires.io.setInputIntRegister, register, value))

    def power_off(self) -> bool:
        """Take the power from an arm that stands; its control program ends with that. False while a call is under way.

        Raises ConnectionLostError if the controller does not answer.
        """
        if not self._wires.caller.idle:
            return False
        try:
            self._wires.dashboard.powerOff()
        except Exception:  # ur-rtde raises whatever its sockets do
            raise self._lost() from None
        return True

    def close(self) -> None:
        """End the control program, give the speed slider back as it was, hang up. The arm stands afterwards."""
        self._wires.close(self._fraction_before)

    def _receive(self) -> None:
        receive, last = self._wires.receive, self._sample.timestamp
        silence = Stopwatch()
        while (now := receive.getTimestamp()) == last:
            if not self._wires.connected or silence.seconds > _SILENCE:
                raise self._lost()
            pause(_POLL)
        if now < last or not self._wires.connected:  # or another controller, or the same one started anew
            raise self._lost()
        self._sample = self._wires.sample()

    def _lost(self) -> ConnectionLostError:
        return ConnectionLostError(f"connection to {self._wires.address} lost; the arm halts by its watchdog")

    def _govern(self, permitted: bool) -> None:
        """Hold the speed slider where the permit says, whoever else moves it."""
        now, fraction = self._time, self._sample.speed_fraction
        limit = self._speed_limit if permitted else 0.0
        wrong = fraction > limit + _SLIDER or (permitted and fraction < _SLIDER)
        if permitted != self._permitted:
            self._permitted, self._obeyed = permitted, now
            self._slide(limit)
        elif not wrong:
            self._obeyed = now
        elif now - self._slid >= _REPEAT:
            self._slide(limit)
        if now - self._obeyed > (_RELEASE if permitted else _OBEDIENCE):
            raise ArmError(f"the speed slider of {self._wires.address} stays at {fraction:.0%} instead of {limit:.0%}")

    def _slide(self, fraction: float) -> None:
        self._slid = self._time
        self._send(partial(self._wires.io.setSpeedSlider, fraction))

    def _feed(self) -> None:
        """Kick the watchdog; not while a command is under way, which a kick would overwrite."""
        due = self._time - self._called >= NANOSECONDS / self._watchdog / 4
        if due and self._sample.runtime_state == PLAYING and self._wires.caller.idle:
            self._called = self._time
            self._wires.caller.submit(self._wires.control.kickWatchdog)

    def _send(self, send: Callable[[], Any]) -> None:
        """Send something that nobody answers."""
        try:
            sent = send()
        except Exception:  # ur-rtde raises whatever its sockets do
            raise self._lost() from None
        if not sent:
            raise self._lost()

    # Calls to the control program

    def _call(self, function: Callable[[], ResultT]) -> ResultT:
        """Have another thread call, and go on with the cycles until it is answered."""
        call = self._wires.caller.submit(function)
        if not call.wait(_PROMPT):
            while not call.wait():
                self.cycle()
        self._called = self._time
        if call.error is not None:
            if not self._wires.receive.isConnected():
                raise self._lost()
            raise ArmError(f"{self._wires.address}: {call.error}") from call.error
        result: ResultT = call.result
        return result

    def _command(self, command: Callable[[], bool], what: str) -> None:
        """A command that has to succeed."""
        if not self._call(command):
            raise self._refused(what)

    def _motion(self, command: Callable[[], bool], what: str) -> bool:
        """A command that a protective stop may refuse: False."""
        if self._sample.safety_mode == PROTECTIVE_STOP:
            return False
        if self._call(command):
            return True
        self.cycle()
        if self._sample.safety_mode == PROTECTIVE_STOP:
            return False
        raise self._refused(what)

    def _refused(self, what: str) -> ArmError:
        """Why a command failed. Raises ConnectionLostError if it is the connection, which shows a moment later."""
        watch = Stopwatch()
        while watch.seconds < _SILENCE:
            self._receive()
        why = "its control program has ended" if self.program_ended else "its control program did not answer"
        return ArmError(f"{self._wires.address} did not {what}: {why}")

    def _finish(self, operation: int) -> bool:
        """Wait for the end of a motion that began after asynchronous operation `operation`."""
        while True:
            self.cycle()
            if self._sample.safety_mode == PROTECTIVE_STOP:
                return False
            if self.program_ended:
                raise self._refused("complete a motion")
            status = self._wires.control.getAsyncOperationProgressEx()
            if status.operationId() != operation and not status.isAsyncOperationRunning():
                self.cycle()  # the target that belongs to this word
                return True

    def _operation(self) -> int:
        number: int = self._wires.control.getAsyncOperationProgressEx().operationId()
        return number

    def _wait(self, reached: Callable[[], bool], what: str, patience: int = _ANSWER) -> None:
        """Go on with the cycles until something shows in the samples."""
        begun, count = self._sample.timestamp, 0
        while count < 2 or not reached():
            if (self._sample.timestamp - begun) * NANOSECONDS > patience:
                raise ArmError(f"{self._wires.address} did not {what} within {patience / NANOSECONDS:g} s")
            self.cycle()
            count += 1
