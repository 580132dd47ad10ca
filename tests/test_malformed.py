"""Whatever arrives on whatever key, a plugin goes on: what makes no sense is counted, told and dropped."""

from __future__ import annotations

import contextlib
import json
import random
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh
from cells import Palpate, cell_text, write_cell
from hypothesis import given
from hypothesis import strategies as st

from runtime import config
from runtime import messages as m
from runtime import topics as t
from runtime.bus import Envelope, Inbox, Request, decode, encode
from runtime.clock import SessionClock
from runtime.errors import BusError
from runtime.in_process import run_in_process
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.network import rmw_zenoh
from runtime.network.access import service_key
from runtime.network.admission import Admission
from runtime.network.meeting_point import LOOPBACK
from runtime.validity import OFFSET, fault

MAD = st.one_of(
    st.sampled_from([float("nan"), float("inf"), float("-inf")]),
    st.floats(min_value=OFFSET, exclude_min=True),
    st.floats(max_value=-OFFSET, exclude_max=True),
)
NOW = m.header(5 * m.NANOSECONDS)
GOAL = m.SearchGoal(
    header=NOW,
    search=1,
    board=1,
    hole="1",
    component="igbt",
    nominal=m.Pose(position=m.Point(x=0.3, y=0.0, z=0.05), orientation=m.Quaternion(x=1.0, y=0.0, z=0.0, w=0.0)),
    feasible_radius=2e-4,
    search_radius=2e-3,
    max_attempts=150,
    seed=1,
    prior=m.Gaussian(),
    seats=[m.Seat("s", 1, "1", 0.0, 0.0, 0.0, 0.0)],
    misses=[m.Miss(1, "1", [m.Waypoint(0.0, 0.0)])],
    layout=[m.Place("1", 0.3, 0.0)],
)
CANDIDATE = m.Candidate(NOW, 1, 1, False, "", m.Proposal(1e-3, 0.0, path=[m.Waypoint(0.0, 1e-3)]))
GIVEN_UP = replace(CANDIDATE, exhausted=True, proposal=m.Proposal(float("nan"), float("nan")))
PERMIT = m.Permit(NOW, True, m.SafetyState.PERMITTED, "", m.stamp_of(6 * m.NANOSECONDS))
OSSD = m.Ossd(NOW, True, True, m.stamp_of(6 * m.NANOSECONDS))
RESET = m.Reset(NOW, "button")
CLOCK = m.Clock(clock=NOW.stamp)
STATE = m.SessionState(NOW, "today", m.Phase.RUNNING, "")
LATER = m.stamp_of(5000 * m.NANOSECONDS)
MAD_TIME = m.Time(sec=-1, nanosec=0)


@pytest.mark.parametrize("message", [GOAL, CANDIDATE, GIVEN_UP, PERMIT, OSSD, RESET, CLOCK, STATE])
def test_sound_messages_are_let_in(message: object) -> None:
    assert fault(message, "today") == ""


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (replace(PERMIT, valid_until=LATER), "more than 3600 s ahead"),
        (replace(PERMIT, granted=False), "granted is False in state PERMITTED"),
        (replace(PERMIT, state=m.SafetyState.TRIPPED), "granted is True in state TRIPPED"),
        (replace(PERMIT, state=77), "state 77 is none of 0, 1"),
        (replace(PERMIT, stop_category=3), "stop category 3"),
        (replace(PERMIT, header=m.Header(stamp=MAD_TIME, frame_id="")), "stamp -1 s 0 ns is no time"),
        (replace(PERMIT, valid_until=m.Time(sec=6, nanosec=2**31)), "valid_until 6 s"),
        (replace(OSSD, valid_until=LATER), "more than 3600 s ahead"),
        (replace(OSSD, channel_2_tested=LATER), "channel_2_tested 5000 s is yet to come"),
        (replace(RESET, edge=9), "edge 9 is none of 0, 1, 2"),
        (replace(RESET, source="x" * 201), "source has 201 characters"),
        (m.EmergencyStop(NOW, "x" * 201, True), "device has"),
        (m.Muting(m.Header(stamp=MAD_TIME, frame_id=""), True, True), "no time of a session"),
        (m.Clock(clock=m.Time(sec=2**31 - 1, nanosec=0)), "clock 2147483647 s"),
        (replace(GOAL, search_radius=float("nan")), "search_radius nan m is not from"),
        (replace(GOAL, feasible_radius=1e-300), "feasible_radius 1e-300 m is not from"),
        (replace(GOAL, max_attempts=2**31), "max_attempts"),
        (replace(GOAL, component="x"), "component 'x' is not known"),
        (replace(GOAL, board=0), "board 0 is below 1"),
        (replace(GOAL, prior=m.Gaussian(xx=float("inf"))), "infinite covariance"),
        (replace(GOAL, seats=[replace(GOAL.seats[0], seated_y=float("nan"))]), "seat nan m"),
        (replace(GOAL, misses=[m.Miss(1, "1", [m.Waypoint(1.0, 0.0)])]), "miss 1 m"),
        (replace(GOAL, nominal=replace(GOAL.nominal, position=m.Point(x=0.0, y=0.0, z=9.0))), "position 9 m"),
        (replace(GOAL, nominal=replace(GOAL.nominal, orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))), "unit"),
        (replace(CANDIDATE, number=0), "number 0 is below 1"),
        (replace(CANDIDATE, proposal=m.Proposal(0.0, 0.0, path=[m.Waypoint(0.0, float("nan"))])), "path nan m"),
        (replace(CANDIDATE, proposal=m.Proposal(0.0, 0.0, path=[m.Waypoint(0.0, 0.0)] * 10_001)), "10001 points"),
        (replace(STATE, phase=9), "phase 9"),
        (replace(STATE, session="yesterday"), "about session 'yesterday'"),
        (m.PublisherCounts(NOW, "arm", [m.PublisherCount("/tf", 2**60)]), "more than a session has"),
        (m.InterventionAnswer(1, 1, "m" * 300, ""), "who has 300 characters"),
        (m.BeliefRequest("x" * 201, 0, 0), "hole has 201 characters"),
    ],
)
def test_what_makes_no_sense_is_told(message: object, said: str) -> None:
    assert said in fault(message, "today")


@given(MAD, MAD)
def test_the_arm_is_sent_nowhere_mad(x: float, y: float) -> None:
    for proposal in (m.Proposal(x, 0.0), m.Proposal(0.0, y), m.Proposal(0.0, 0.0, path=[m.Waypoint(x, y)])):
        assert "is not within" in fault(replace(CANDIDATE, proposal=proposal))


class Plugin:
    """An inbox with a doorkeeper, and what it says."""

    def __init__(self, *, everything: bool = False) -> None:
        self.inbox, self.said = Inbox(), list[str]()
        self.admission = Admission(self.said.append, SessionClock(), "today", everything=everything)
        self.inbox.admit_by(self.admission, self.admission.refuse)
        self._sent: Counter[str] = Counter()

    def put(self, topic: t.Topic[Any], message: object, **changes: Any) -> None:
        payload = message if isinstance(message, bytes) else encode(message)
        self._sent[topic.name] += 1
        self.inbox.put(replace(Envelope(topic.name, "", payload, 5, self._sent[topic.name], bytes(16)), **changes))

    def taken(self) -> list[Any]:
        found = []
        while (item := self.inbox.poll()) is not None:
            found.append(item.read(t.topics()[item.topic]) if isinstance(item, Envelope) else item)
        return found


def test_nothing_is_told_before_a_session_begins_and_then_all_of_it_once() -> None:
    plugin = Plugin()
    for _ in range(5):
        plugin.put(t.PERMIT, b"junk")
    plugin.inbox.refuse(t.RESET.name, "an attachment has 33 bytes, not 4")
    assert plugin.taken() == []
    assert plugin.said == []
    plugin.put(t.PERMIT, PERMIT)
    assert plugin.taken() == [PERMIT]
    [line] = plugin.said
    assert line.startswith(
        "dropped what makes no sense: /safety/permit 5, /safety/reset 1; the last, /safety/permit: 4"
    )
    for _ in range(1000):
        plugin.put(t.PERMIT, b"junk")
    assert plugin.taken() == []
    assert plugin.said == [line]  # the next one in ten seconds
    plugin.admission.close()
    assert len(plugin.said) == 2
    assert "/safety/permit 1000" in plugin.said[1]
    assert plugin.admission.dropped == {t.PERMIT.name: 1005, t.RESET.name: 1}


def test_what_comes_twice_or_out_of_order_is_dropped() -> None:
    plugin = Plugin()
    words = [replace(PERMIT, header=m.header(second * m.NANOSECONDS)) for second in (5, 5, 6, 4, 7)]
    for word in words:
        plugin.put(t.PERMIT, word)
    assert plugin.taken() == [words[0], words[1], words[2], words[4]]  # the one of 4 s says that time went back
    plugin.put(t.PERMIT, words[4], sequence=5)
    plugin.put(t.PERMIT, words[4], sequence=2)
    assert plugin.taken() == []
    assert plugin.admission.dropped == {t.PERMIT.name: 3}


def test_a_topic_of_one_role_has_one_publisher() -> None:
    plugin = Plugin()
    later = replace(PERMIT, header=m.header(6 * m.NANOSECONDS))
    plugin.put(t.PERMIT, PERMIT)
    plugin.put(t.PERMIT, later, publisher=bytes([1] * 16))
    assert plugin.taken() == [PERMIT]
    assert "second publisher" in plugin.said[0]
    plugin.put(t.RESET, RESET)
    plugin.put(t.RESET, RESET, publisher=bytes([1] * 16))  # there may be several buttons, each with a count of its own
    assert plugin.taken() == [RESET, RESET]


def test_a_stamp_far_ahead_does_not_carry_session_time_along() -> None:
    plugin = Plugin()
    plugin.put(t.RESET, RESET, stamp=2**61)
    assert plugin.taken() == []


def test_a_malformed_question_is_dropped_and_the_next_one_answered() -> None:
    plugin, answers = Plugin(), list[bytes]()
    plugin.inbox.put(Request(t.ASK_BELIEF.name, b"\x00\x01\x00\x00\xff\xff\xff\xff", answers.append))
    plugin.inbox.put(Request(t.ASK_BELIEF.name, encode(m.BeliefRequest("1", 0, 0)), answers.append))
    [question] = plugin.taken()
    assert question.read(t.ASK_BELIEF).hole == "1"
    assert plugin.admission.dropped == {t.ASK_BELIEF.name: 1}


def test_a_recorder_gets_all_of_it() -> None:
    plugin = Plugin(everything=True)
    plugin.put(t.PERMIT, b"junk")
    plugin.put(t.PERMIT, PERMIT, sequence=1)
    assert [plugin.inbox.poll() is not None for _ in range(3)] == [True, True, False]


def test_a_message_is_decoded_once() -> None:
    plugin = Plugin()
    plugin.put(t.PERMIT, PERMIT)
    item = plugin.inbox.poll()
    assert isinstance(item, Envelope)
    assert item.read(t.PERMIT) is item.read(t.PERMIT)
    assert replace(item, payload=encode(replace(PERMIT, reason="other"))).read(t.PERMIT).reason == "other"


def test_no_stream_of_strangers_fills_the_memory() -> None:
    inbox = Inbox()
    for number in range(10_100):
        inbox.put(Envelope(t.RESET.name, "", b"", 5, 1, number.to_bytes(16, "big")))
    assert len(inbox) == 10_000
    assert inbox.malformed == 100


@given(st.binary(max_size=60))
def test_an_attachment_is_whole_or_refused(data: bytes) -> None:
    with contextlib.suppress(BusError):
        sequence, stamp, publisher = rmw_zenoh.unpacked(data)
        assert sequence > 0
        assert stamp >= 0
        assert len(publisher) == 16


def mutations(payload: bytes, cls: type[Any], dice: random.Random) -> Iterator[bytes]:
    """Bytes at random, a part of a real message, and one with some bits flipped, unless that is a forged one."""
    yield dice.randbytes(dice.randrange(200))
    yield payload[: dice.randrange(len(payload))]
    flipped = bytearray(payload)
    for _ in range(dice.randrange(1, 8)):
        flipped[dice.randrange(len(flipped))] ^= 1 << dice.randrange(8)
    try:
        harmless = cls in UNCHECKED or fault(decode(bytes(flipped), cls))
    except BusError:
        harmless = True
    if harmless:
        yield bytes(flipped)


UNCHECKED = (m.JointState, m.WrenchStamped, m.PoseStamped, m.TFMessage, m.ArmStatus, m.ControlTrace, m.Log)
UNCHECKED += (m.Float64MultiArray, m.Truth, m.Belief)


class Fuzzer:
    """A client that says nonsense on every topic, and asks nonsense of every service."""

    def __init__(self, samples: dict[str, bytes], port: int) -> None:
        config = zenoh.Config()
        for name, value in {
            "mode": "client",
            "connect/endpoints": [f"tcp/{LOOPBACK}:{port}"],
            "connect/timeout_ms": 60_000,
            "scouting/multicast/enabled": False,
        }.items():
            config.insert_json5(name, json.dumps(value))
        self.session = zenoh.open(config)
        self._samples = samples
        self._dice = random.Random(1)
        self._sent: Counter[str] = Counter()
        self.over = False  # the job is done: a recorder that waits for silence would wait long
        self.session.declare_subscriber(rmw_zenoh.key(t.SESSION), self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        with contextlib.suppress(BusError):
            state = decode(bytes(sample.payload), m.SessionState)
            self.over |= not fault(state) and state.phase == m.Phase.DONE

    def attachment(self, name: str) -> bytes | None:
        """Mostly a sound one, of an identity of its own."""
        kind = self._dice.randrange(6)
        if kind == 0:
            return None
        if kind == 1:
            return self._dice.randbytes(self._dice.choice([0, 5, 32, 34, 80]))
        self._sent[name] += 1
        return rmw_zenoh.Attachment(self._sent[name], 0, b"a stranger's own").pack()

    def burst(self) -> None:
        for topic in t.topics().values():
            payload = self._samples.get(topic.name, bytes(40))
            for bad in mutations(payload, topic.type, self._dice):
                self.session.put(rmw_zenoh.key(topic), bad, attachment=self.attachment(topic.name))
        self.session.put("0/a/key/of/none", b"junk")
        for service in t.services().values():
            for bad in (self._dice.randbytes(30), b"", b"\x00\x01\x00\x00" + b"\xff" * 20):
                self.session.get(service_key(service), lambda _reply: None, payload=bad)


def fuzzed(process: subprocess.Popen[str], start: Callable[[], Fuzzer]) -> int:
    """Say nonsense for as long as a session runs; tells how often."""
    fuzzer, bursts = start(), 0
    with fuzzer.session:
        while process.poll() is None and not fuzzer.over:
            fuzzer.burst()
            bursts += 1
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.1)
    return bursts


def decisions_of(path: Path) -> list[tuple[object, ...]]:
    """What was decided and felt, of what makes sense."""
    with open_log(path) as log:
        found = []
        for topic in (t.CANDIDATE, t.ATTEMPT, t.SEARCH_RESULT):
            for item in log.messages([topic.name]):
                with contextlib.suppress(BusError):
                    message = item.read(topic)
                    if not fault(message):
                        found.append((item.stamp, message))
    return found


def test_a_session_goes_on_whatever_arrives(tmp_path: Path) -> None:
    palpate = Palpate(tmp_path)
    cell = write_cell(tmp_path, cell_text(holes=1))
    calm = run_in_process(Order(config.load(str(cell)), tmp_path / "calm")).log
    with open_log(calm) as log:
        samples = {item.topic: item.payload for item in log.messages()}
    process = palpate.start("launch", cell, "--port", str(palpate.port), "--rerun", "save")
    bursts = fuzzed(process, lambda: Fuzzer(samples, palpate.port))
    out, err = process.communicate()
    assert process.returncode == 0, (out, err)
    assert bursts > 3
    (path,) = palpate.logs()
    assert decisions_of(path) == decisions_of(calm)
    said: dict[str, str] = {}
    with open_log(path) as log:
        assert log.complete
        for item in log.messages([t.ROSOUT.name]):
            with contextlib.suppress(BusError):
                line = item.read(t.ROSOUT)
                if "what makes no sense" in line.msg or "nothing of" in line.msg:
                    said[line.name] = said.get(line.name, "") + line.msg
    plugins = {"arm", "light_curtain", "interlock", "strategy", "posterior", "assembly", "recorder", "viewer"}
    assert plugins <= set(said), said
    for name, topics in {
        "arm": (t.PERMIT, t.SEARCH_GOAL, t.CANDIDATE, t.SESSION),
        "light_curtain": (t.CLOCK,),
        "interlock": (t.OSSD, t.RESET, t.EMERGENCY_STOP, t.MUTING),
        "strategy": (t.SEARCH_GOAL, t.ATTEMPT),
        "posterior": (t.SEARCH_RESULT, t.ATTEMPT, t.ASK_BELIEF),
        "assembly": (t.SESSION, t.ATTEMPT, t.CANDIDATE),
    }.items():
        assert [topic.name for topic in topics if topic.name not in said[name]] == [], said[name]
