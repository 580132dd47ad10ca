"""The arm's own watchdog: what is no permit moves nothing, and whoever falls silent stops the arm in session time."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from cells import Palpate, cell_text, write_cell
from conftest import unused_port
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import Robot
from test_drivers import SESSION_NAME, speeds_of, staged
from test_session import commanded_speeds, run_here

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.real_time_gate import RealTimeGate
from runtime import config, roles, topics
from runtime.bus import Envelope, encode
from runtime.clock import Pacer
from runtime.context import Context
from runtime.errors import BusError, SessionError
from runtime.launcher import Order, assignments, new_session
from runtime.local_bus import LocalBus, LocalExchange
from runtime.log.file import open_log
from runtime.messages import Ending, Permit, Reset, SafetyState, Time, header, nanoseconds_of, stamp_of
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.safety.held_permit import HeldPermit
from runtime.safety.permit_check import Objection, PermitCheck
from runtime.safety.permit_gate import SLOW, PermitGate
from runtime.safety.permit_seal import is_genuine, new_key, sealed

MS = 1_000_000  # [ns]
CELL = config.load("igbt").cell
DEADLINE = round(CELL.safety.deadline * 1e9)
SESSION = "20260101-120000"
KEY, OTHER_KEY = bytes(range(32)), bytes(32)
TOLD = 1000 * MS  # session time on /clock
INTERLOCK, INTRUDER = b"i" * 16, b"x" * 16


def permit(granted: bool = True, since: int = TOLD, holds: int = DEADLINE, **fields: Any) -> Permit:
    """A permit as the interlock sends it, but for `fields`."""
    state = SafetyState.PERMITTED if granted else SafetyState.TRIPPED
    told: dict[str, Any] = {"state": state, "reason": "", "ossd": 10, "resets": 1, "session": SESSION} | fields
    return Permit(header(since), granted, valid_until=stamp_of(since + holds), **told)


def envelope(word: Permit, sequence: int = 10, publisher: bytes = INTERLOCK, payload: bytes | None = None) -> Envelope:
    return Envelope(topics.PERMIT.name, "", encode(word) if payload is None else payload, 0, sequence, publisher)


@dataclass(frozen=True)
class Wrong:
    """A word that must not be believed after `LAST`."""

    objection: Objection
    word: Permit = field(default_factory=permit)
    key: bytes = KEY
    sequence: int = 10
    publisher: bytes = INTERLOCK
    change: Callable[[Permit], Permit] = lambda word: word  # after it was sealed
    cut: int = 0  # bytes of it that are missing

    @property
    def envelope(self) -> Envelope:
        word = self.change(sealed(self.word, self.key))
        payload = encode(word)
        return envelope(word, self.sequence, self.publisher, payload[: len(payload) - self.cut])


LAST = permit(since=TOLD - 80 * MS, ossd=9)
WRONG = {
    "cut short": Wrong(Objection.SENSELESS, cut=60),
    "a stamp before time": Wrong(Objection.SENSELESS, replace(permit(), header=replace(header(0), stamp=Time(-1, 0)))),
    "a time that is none": Wrong(Objection.SENSELESS, replace(permit(), valid_until=Time(1, 2**32 - 1))),
    "another session": Wrong(Objection.SESSION, permit(session="20260101-110000")),
    "an older log, without session and seal": Wrong(Objection.SESSION, permit(session=""), key=b""),
    "not sealed": Wrong(Objection.SEAL, key=b""),
    "sealed with another key": Wrong(Objection.SEAL, key=OTHER_KEY),
    "longer than it was sealed for": Wrong(
        Objection.SEAL, change=lambda word: replace(word, valid_until=stamp_of(TOLD + DEADLINE + 1))
    ),
    "granted though sealed as refused": Wrong(
        Objection.SEAL, permit(False), change=lambda word: replace(word, granted=True, state=SafetyState.PERMITTED)
    ),
    "a seal that is no hexadecimal": Wrong(Objection.SEAL, change=lambda word: replace(word, seal="ä" * 16)),
    "granted though tripped": Wrong(Objection.SENSELESS, permit(state=SafetyState.TRIPPED)),
    "a state that is none": Wrong(Objection.SENSELESS, permit(state=200)),
    "a stop category that is none": Wrong(Objection.SENSELESS, permit(stop_category=3)),
    "a second interlock": Wrong(Objection.PUBLISHER, publisher=INTRUDER),
    "the last one again": Wrong(Objection.REPLAYED, LAST, sequence=11),
    "its sequence number again": Wrong(Objection.REPLAYED, sequence=9),
    "nothing heard since": Wrong(Objection.REPLAYED, permit(ossd=9)),
    "a reset less, a curtain's word more": Wrong(Objection.REPLAYED, permit(ossd=11, resets=0)),
    "an earlier stamp": Wrong(Objection.REPLAYED, permit(since=TOLD - 81 * MS)),
    "a stamp in the future": Wrong(Objection.FUTURE, permit(since=TOLD + 1)),
    "longer than the deadline": Wrong(Objection.TOO_LONG, permit(holds=DEADLINE + 1)),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_not_believed_and_the_right_one_still_is(wrong: Wrong) -> None:
    check = PermitCheck(SESSION, DEADLINE, KEY)
    check, first = check.judge(envelope(sealed(LAST, KEY), sequence=9), TOLD - 80 * MS)
    assert first.objection is None
    after, judgement = check.judge(wrong.envelope, TOLD)
    assert judgement.objection is wrong.objection
    assert after == check
    _, right = check.judge(envelope(sealed(permit(), KEY)), TOLD)
    assert right.objection is None


def test_without_a_key_no_seal_is_asked_for() -> None:
    _, judgement = PermitCheck(SESSION, DEADLINE).judge(envelope(permit()), TOLD)
    assert judgement.objection is None


def test_every_change_of_a_permit_breaks_its_seal() -> None:
    key = new_key()
    genuine = sealed(permit(), key)
    assert is_genuine(genuine, key)
    changed: list[dict[str, Any]] = [
        {"granted": False},
        {"state": 4},
        {"reason": "."},
        {"header": header(TOLD, "x")},
        {"valid_until": stamp_of(TOLD)},
        {"session": "another"},
        {"stop_category": 1},
        *({name: 0} for name in ("ossd", "resets")),
        *({name: 1} for name in ("emergency_stops", "mutings")),
    ]
    assert not any(is_genuine(replace(genuine, **change), key) for change in changed)
    assert not is_genuine(replace(genuine, seal=""), key)
    assert len({new_key() for _ in range(10)}) == 10


def test_interlock_and_arm_alone_are_told_the_key_of_a_session(tmp_path: Path) -> None:
    order = Order(config.load("igbt"), tmp_path)
    first, second = ({item.role: item for item in assignments(order, new_session(tmp_path))} for _ in range(2))
    keys = {role: item.seal_key for role, item in first.items() if item.seal_key}
    assert set(keys) == {roles.INTERLOCK, roles.ARM}
    assert len(set(keys.values())) == 1
    assert first[roles.ARM].seal_key != second[roles.ARM].seal_key
    assert all(keys[roles.ARM] not in repr(item) for item in first.values())
    assert keys[roles.ARM] not in str(first[roles.RECORDER])


# Any order of right and wrong words


@dataclass(frozen=True)
class Said:
    granted: bool
    later: int  # [ms] than the word before
    attacks: tuple[tuple[str, bool, int], ...]  # which, whether it refuses, and which word it takes for a pattern


KINDS = ("replay", "copy", "longer", "unsealed", "second", "session")
attacks = st.tuples(st.sampled_from(KINDS), st.booleans(), st.integers(0))
stories = st.lists(
    st.builds(Said, st.booleans(), st.integers(0, 300), st.lists(attacks, max_size=3).map(tuple)), max_size=20
)


def attack(kind: str, refuses: bool, pattern: Permit, number: int) -> Envelope:
    """What somebody without the key makes of a permit that was heard on the bus."""
    if kind == "replay":
        return envelope(pattern, number + 1000)
    if kind == "copy":
        return envelope(pattern, number, INTRUDER)
    turned = {"granted": not refuses, "state": SafetyState.TRIPPED if refuses else SafetyState.PERMITTED}
    word = replace(pattern, **turned, ossd=pattern.ossd + 1)
    if kind == "longer":
        word = replace(word, valid_until=stamp_of(nanoseconds_of(word.valid_until) + 1))
    elif kind == "unsealed":
        word = replace(word, seal="")
    elif kind == "session":
        word = replace(word, session="another")
    return envelope(word, number + 1000, INTRUDER if kind == "second" else INTERLOCK)


@given(stories)
@settings(deadline=None, max_examples=60)
def test_who_has_not_the_key_can_stop_the_arm_but_never_move_it(story: list[Said]) -> None:
    bus = LocalBus(LocalExchange(), roles.ARM)
    context = Context(roles.ARM, bus, CELL, SESSION, KEY)
    context.ready()
    attacked, calm = HeldPermit(context), HeldPermit(context)
    now, sent = 0, list[Permit]()
    for said in story:
        now += said.later * MS
        word = sealed(permit(said.granted, now, ossd=len(sent) + 1), KEY)
        sent.append(word)
        for held in (attacked, calm):
            assert held.hear(envelope(word, len(sent)), now)
        assert attacked.permits(now) == calm.permits(now) == said.granted
        for kind, refuses, which in said.attacks:
            pattern = sent[which % len(sent)]
            forged = attack(kind, refuses, pattern, len(sent))
            assert not attacked.hear(forged, now)
            word = forged.read(topics.PERMIT)
            if not word.granted and word.session == SESSION:
                assert not attacked.permits(now)
        assert attacked.until == calm.until
        assert attacked.granted <= calm.granted


# Through a real bus, against both gates

Gate = PermitGate | RealTimeGate
ENVELOPES = ("a second interlock", "its sequence number again")  # wrong by how they travel: the bus has them right
MARK = Reset(header(0), "mark")  # which several may press


def wait_for_marks(gate: Gate, count: int, now: int) -> None:
    """Let the gate take what arrives, until so many marks have, which were sent last."""
    deadline = time.monotonic() + 20.0
    while len(gate.waiting) < count:
        assert time.monotonic() < deadline
        gate(now)
    gate.waiting.clear()


@pytest.mark.parametrize("kind", [PermitGate, RealTimeGate])
def test_no_wrong_permit_on_the_bus_moves_the_arm_and_the_next_right_one_does(kind: type[Gate]) -> None:
    begun, ends, port = TOLD - 80 * MS, TOLD - 80 * MS + DEADLINE, unused_port()
    with contextlib.ExitStack() as stack:
        stack.enter_context(ZenohRouter(port))
        arm, interlock, intruder = (
            stack.enter_context(ZenohBus(role, port)) for role in (roles.ARM, roles.INTERLOCK, "intruder")
        )
        arm.subscribe(topics.PERMIT, topics.RESET)
        context = Context(roles.ARM, arm, CELL, SESSION, KEY)
        context.ready()
        clock = arm.publisher(topics.CLOCK)
        gate = PermitGate(context, clock, Pacer(1000.0)) if kind is PermitGate else RealTimeGate(context, clock)
        right, false = interlock.publisher(topics.PERMIT), intruder.publisher(topics.PERMIT)
        marks = [bus.publisher(topics.RESET) for bus in (interlock, intruder)]
        for bus in (arm, interlock, intruder):
            bus.settle()
        right.send(sealed(LAST, KEY), 0)
        while not gate(begun):
            pass
        for name, wrong in WRONG.items():
            false.send_raw(wrong.envelope.payload, 0)
            if name not in ENVELOPES:
                right.send_raw(wrong.envelope.payload, 0)
        for mark in marks:
            mark.send(MARK, 0)
        wait_for_marks(gate, 2, TOLD)
        assert gate(ends - 2 * MS)
        assert not gate(ends)
        dropped = context.admission.dropped[topics.PERMIT.name]  # before they got as far as the gate
        assert gate.held.refused.total() + dropped == 2 * len(WRONG) - len(ENVELOPES)
        right.send(sealed(permit(since=ends - 2 * MS), KEY), 0)
        marks[0].send(MARK, 0)
        wait_for_marks(gate, 1, ends)
        assert gate(ends + 2 * MS)


# Whole cells: processes that are stopped for a while, or for good

RATE = 5  # times real time


@pytest.fixture
def palpate(tmp_path: Path) -> Iterator[Palpate]:
    made = Palpate(tmp_path)
    yield made
    for pid in made.processes():
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def process_of(palpate: Palpate, role: str, launcher: subprocess.Popen[str]) -> int:
    """The process that plays a role; the router lives in the launcher's."""
    if role == roles.LAUNCHER:
        return launcher.pid
    [pid] = [pid for pid, text in palpate.processes().items() if text.rstrip().endswith(f"runtime.host {role}")]
    return pid


@contextlib.contextmanager
def listening(palpate: Palpate, launcher: subprocess.Popen[str]) -> Iterator[ZenohBus]:
    """A bus in the cell that hears its permits, and what is said."""
    bus = None
    while bus is None:
        assert launcher.poll() is None, launcher.communicate()
        with contextlib.suppress(BusError):
            bus = ZenohBus("listener", palpate.port, patience=1.0)
    with bus:
        bus.subscribe(topics.PERMIT, topics.ROSOUT)
        yield bus


def hear_permit(bus: ZenohBus, launcher: subprocess.Popen[str], after: int) -> Permit:
    """The next permit that is stamped later than a session time [ns]."""
    while True:
        item = bus.inbox.receive(1.0)
        assert launcher.poll() is None, launcher.communicate()
        if isinstance(item, Envelope) and item.topic == topics.PERMIT.name:
            permit = item.read(topics.PERMIT)
            if nanoseconds_of(permit.header.stamp) > after:
                return permit


def hear_it_go_on(bus: ZenohBus, launcher: subprocess.Popen[str]) -> None:
    """Wait until the arm says that it has a permit again."""
    while True:
        item = bus.inbox.receive(1.0)
        assert launcher.poll() is None, launcher.communicate()
        said = item.read(topics.ROSOUT).msg if isinstance(item, Envelope) and item.topic == topics.ROSOUT.name else ""
        if said.startswith("a fresh permit after "):
            return


def forge(port: int, heard: Permit) -> None:
    """Grant motion for the next two seconds, over and over, as somebody would who hears all that is on the bus."""
    since = nanoseconds_of(heard.header.stamp)
    with ZenohBus("intruder", port) as bus:
        publisher = bus.publisher(topics.PERMIT)
        bus.settle()
        for number in range(100):
            at = since + number * 20 * MS
            word = replace(heard, header=header(at), valid_until=stamp_of(at + DEADLINE), ossd=heard.ossd + number)
            publisher.send(word, at)


def said_by(path: Path, role: str) -> list[str]:
    with open_log(path) as log:
        return [line.msg for _, line in log.read(topics.ROSOUT) if line.name == role]


def check_stops(path: Path) -> int:
    """Every stop began in the cycle in which a permit ended, and lasted; how many there were."""
    with open_log(path) as log:
        permits = [word for _, word in log.read(topics.PERMIT) if word.session == path.stem]
        statuses = [(stamp, status.safety_mode) for stamp, status in log.read(topics.ARM_STATUS)]
        speeds = commanded_speeds([trace for _, trace in log.read(topics.TRACE)])
    genuine = {word.seal: word for word in reversed(permits)}  # what was forged has a seal that was heard before
    ends = {nanoseconds_of(word.valid_until) for word in genuine.values() if word.granted}
    assert {mode for _, mode in statuses} == {1, 5}
    stops = [stamp for (_, before), (stamp, mode) in pairwise(statuses) if (before, mode) == (1, 5)]
    for begun in stops:
        assert begun - 2 * MS in ends
        over = next(stamp for stamp, mode in statuses if stamp > begun and mode == 1)
        assert {speed for stamp, speed in speeds.items() if begun + 100 * MS < stamp < over} <= {0.0}
    return len(stops)


def test_a_process_that_stands_still_stops_the_arm_for_as_long_and_no_false_permit_moves_it(
    palpate: Palpate, tmp_path: Path
) -> None:
    """Not one that is forged, and not those of a log that is played back onto the cell's bus."""
    old = run_here(tmp_path / "old", cell_text(holes=1))
    cell = write_cell(tmp_path, cell_text(holes=2))
    launcher = palpate.start("launch", cell, "--rate", str(RATE), "--port", str(palpate.port))
    with listening(palpate, launcher) as bus:
        heard = hear_permit(bus, launcher, 2000 * MS)
        pid = process_of(palpate, roles.INTERLOCK, launcher)
        os.kill(pid, signal.SIGSTOP)
        forge(palpate.port, heard)
        arguments = ("--join", "--topics", "/safety/permit", "--rate", "max", "--port", str(palpate.port))
        replayed = palpate.run("replay", old, *arguments)
        os.kill(pid, signal.SIGCONT)
        for role in (roles.CURTAIN, roles.LAUNCHER):  # in the launcher's process is the router
            hear_it_go_on(bus, launcher)
            pid = process_of(palpate, role, launcher)
            os.kill(pid, signal.SIGSTOP)
            time.sleep(2 * SLOW)
            os.kill(pid, signal.SIGCONT)
    assert replayed.returncode == 0, replayed.stderr
    out, err = launcher.communicate(timeout=60.0)
    assert launcher.returncode == 0, err
    assert "2 of 2 igbts inserted" in out
    [log] = palpate.logs()
    assert check_stops(log) >= 3
    said = said_by(log, roles.ARM)
    assert said.count("no fresh permit: the arm stops") >= 3
    assert sum(line.startswith("a fresh permit after ") for line in said) >= 3
    assert "a permit is not believed: it is of another session" in said
    assert "a permit is not believed: its seal is not that of this session's interlock" in said


def test_an_interlock_that_stands_still_for_good_ends_the_session_with_one_line(palpate: Palpate) -> None:
    text = cell_text(holes=1).replace("[safety]\n", '[safety]\npatience = "1 s"\n')
    launcher = palpate.start("launch", write_cell(palpate.folder, text), "--port", str(palpate.port), "--rate", "5")
    with listening(palpate, launcher) as bus:
        hear_permit(bus, launcher, 1000 * MS)
        os.kill(process_of(palpate, roles.INTERLOCK, launcher), signal.SIGSTOP)
    _, err = launcher.communicate(timeout=60.0)
    assert launcher.returncode == 1
    assert err == "palpate: arm: no permit within 1 s: interlock or light curtain is silent; the arm is halted\n"
    assert not palpate.processes()
    with open_log(palpate.logs()[0]) as log:
        assert log.complete
        assert [status.activity for _, status in log.read(topics.ARM_STATUS)][-1] == "halted"


def test_an_emergency_stop_takes_the_power_and_the_reset_gives_it_back(tmp_path: Path) -> None:
    script = 'emergency_stops = [{ at = "2 s", release_after = "1 s", reset_after = "1 s" }]'
    path = run_here(tmp_path, cell_text(holes=1).replace("[safety]\n", f"[safety]\n{script}\n"))
    with open_log(path) as log:
        statuses = [(stamp, status) for stamp, status in log.read(topics.ARM_STATUS)]
        speeds = commanded_speeds([trace for _, trace in log.read(topics.TRACE)])
        [result] = [result for _, result in log.read(topics.SEARCH_RESULT)]
    assert result.ending == Ending.INSERTED
    modes = [(status.robot_mode, status.safety_mode) for _, status in statuses]
    changes = [mode for mode, before in zip(modes, [None, *modes], strict=False) if mode != before]
    assert changes == [(7, 1), (7, 6), (3, 6), (4, 5), (5, 5), (7, 1)]
    off = next(stamp for stamp, status in statuses if status.robot_mode == 3)
    on = next(stamp for stamp, status in statuses if stamp > off and status.robot_mode == 7)
    assert 2000 * MS < off < 2200 * MS
    assert on > 4000 * MS
    assert {speed for stamp, speed in speeds.items() if off <= stamp < on} == {0.0}
    told = said_by(path, roles.ARM)
    assert told.index("the drives are without power") < told.index("the drives have power again")


def is_off(box: ControlBox) -> bool:
    return box.robot_mode.name == "POWER_OFF"


@pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs ur-rtde")
def test_an_emergency_stop_takes_the_power_from_an_arm_on_the_network_and_ends_the_session() -> None:
    with Robot("igbt") as robot:
        for stage in staged("ur_rtde", {"address": robot.host, "simulated": True, "watchdog": "2 Hz"}):
            stage.begin()
            stage.ask_for_a_part(granted=True, until=2000 * MS)
            assert max(speeds_of(stage.traces(until=1000 * MS)).values()) > 0.0
            word = Permit(
                header(1000 * MS), False, SafetyState.EMERGENCY_STOP, "emergency stop pressed: door", Time(2, 0)
            )
            word = replace(word, ossd=10, stop_category=1, session=SESSION_NAME)
            stage.audience.publisher(topics.PERMIT).send(word, 1000 * MS)
            stage.thread.join(20.0)
        [error] = stage.failure
        assert isinstance(error, SessionError)
        assert str(error).startswith("emergency stop pressed: door: the arm is halted and its drives are without power")
        robot.until(is_off)
