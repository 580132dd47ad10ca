"""RTDE clients that flood, lie and leave: what one of them can cost the controller, its log and the others."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import pytest
from control_boxes import Boxed, Ear, boxed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.peer import PeerError
from drivers.ur3e.control_box.rtde import RtdeConversation, RtdePort
from drivers.ur3e.control_box.rtde_inputs import INPUTS
from drivers.ur3e.control_box.rtde_wire import LARGEST, PackageStream, package

SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
RATE = struct.pack(">d", 500.0)
SESSION = (
    package("V", struct.pack(">H", 2)),
    package("v"),
    package("O", RATE + b"timestamp,actual_q,robot_mode"),
    package("I", b"input_int_register_40,input_double_register_40"),
    package("S"),
    package("U", struct.pack(">Bid", 1, -7, 0.5)),
    package("P"),
)


@pytest.fixture(scope="module")
def boxing() -> Iterator[Boxed]:
    with boxed() as made:
        made.cycles(2)
        yield made


@pytest.fixture
def port(boxing: Boxed) -> RtdePort:
    return RtdePort(boxing.box)


def client(port: RtdePort, *packages: bytes, version: int = 2) -> tuple[RtdeConversation, Ear]:
    """A client that has agreed on a version and sent some packages, its answers taken."""
    ear = Ear()
    conversation = port.conversation(ear)
    conversation.opened()
    conversation.received(package("V", struct.pack(">H", version)) + b"".join(packages))
    ear.take()
    return conversation, ear


def commands(ear: Ear) -> list[str]:
    return [command for command, _ in PackageStream().feed(ear.take())]


# Bytes


@SHARED
@given(st.lists(st.integers(0, len(b"".join(SESSION))), max_size=10).map(sorted))
def test_a_session_is_the_same_however_it_is_cut(boxing: Boxed, cuts: list[int]) -> None:
    whole = b"".join(SESSION)
    heard = []
    for places in ([], cuts):
        ear = Ear()
        conversation = RtdePort(boxing.box).conversation(ear)
        for start, end in zip([0, *places], [*places, len(whole)], strict=True):
            conversation.received(whole[start:end])
        heard.append(ear.take())
        conversation.closed()
    assert heard[0] == heard[1]
    assert [command for command, _ in PackageStream().feed(heard[0])] == list("VvOISP")
    assert boxing.box.registers.input_int[40] == -7


@SHARED
@given(
    st.lists(st.tuples(st.integers(0, len(b"".join(SESSION)) - 1), st.integers(0, 255)), min_size=1, max_size=6),
    st.integers(1, 40),
)
def test_a_damaged_session_is_never_more_than_a_client_s_error(
    boxing: Boxed, damage: list[tuple[int, int]], piece: int
) -> None:
    data = bytearray(b"".join(SESSION))
    for place, value in damage:
        data[place] = value
    port = RtdePort(boxing.box)
    conversation = port.conversation(Ear())
    try:
        for start in range(0, len(data), piece):
            conversation.received(bytes(data[start : start + piece]))
            port.cycle()
            conversation.cycle()
    except PeerError:
        pass
    conversation.closed()
    assert port.claims == {}
    boxing.box.set_speed_slider(1.0)


def test_what_was_answered_before_an_error_is_still_sent(port: RtdePort) -> None:
    ear = Ear()
    with pytest.raises(PeerError, match="no command"):
        port.conversation(ear).received(package("V", b"\x00\x02") + package("v") + package("?"))
    assert commands(ear) == ["V", "v"]


# Floods


def test_small_packages_in_masses_are_spread_over_cycles_and_none_is_lost(port: RtdePort) -> None:
    conversation, ear = client(port)
    total = 300
    conversation.received(package("v") * total)
    answered = [len(commands(ear))]
    assert answered[0] < 64
    while answered[-1]:
        conversation.cycle()
        answered.append(len(commands(ear)))
    assert max(answered) < 64
    assert sum(answered) == total


def test_data_that_waits_is_applied_in_its_order(boxing: Boxed, port: RtdePort) -> None:
    conversation, _ = client(port, package("I", b"input_int_register_41"))
    seen = []
    conversation.received(b"".join(package("U", struct.pack(">Bi", 1, number)) for number in range(1, 201)))
    for _ in range(50):
        seen.append(boxing.box.registers.input_int[41])
        conversation.cycle()
    assert seen == sorted(seen)
    assert seen[0] < 200
    assert seen[-1] == 200
    assert port.fed["input_int_register_41"] == 200


def test_a_cycle_s_room_is_shared_by_what_waits_and_what_comes(port: RtdePort) -> None:
    conversation, ear = client(port)
    conversation.received(package("v") * 40)
    conversation.received(package("v") * 40)
    conversation.received(package("v") * 40)
    assert len(commands(ear)) < 64


@pytest.mark.parametrize("flood", [package("v"), package("M"), package("P"), package("O", RATE + b"timestamp")])
def test_who_sends_more_than_is_taken_is_dropped(port: RtdePort, flood: bytes) -> None:
    conversation, _ = client(port)
    chunk = flood * (4096 // len(flood))
    with pytest.raises(PeerError, match="control cycle takes"):  # noqa: PT012 - a flood takes several rounds
        for _ in range(300):
            conversation.received(chunk)
            conversation.cycle()


def test_an_honest_client_s_large_packages_are_no_flood(boxing: Boxed, port: RtdePort) -> None:
    names = [name for name, kind in INPUTS.items() if kind == "DOUBLE" and "register" in name]
    conversation, _ = client(port, package("I", ",".join(names).encode()))
    data = package("U", struct.pack(f">B{len(names)}d", 1, *range(len(names))))
    for _ in range(500):
        conversation.received(data * (4096 // len(data)))
        conversation.cycle()
    assert boxing.box.registers.input_double[5] == 5.0


def test_a_large_package_may_take_its_time(port: RtdePort) -> None:
    conversation, ear = client(port)
    names = b"x" * (LARGEST - 3 - 8)
    whole = package("O", RATE + names)
    assert len(whole) == LARGEST
    for byte in range(0, LARGEST, 512):
        assert commands(ear) == []
        conversation.received(whole[byte : byte + 512])
        conversation.cycle()
    assert commands(ear) == ["O"]


# The log


def told(port: RtdePort, boxing: Boxed, text: bytes, version: int) -> list[str]:
    """The lines that a text message makes."""
    conversation, _ = client(port, version=version)
    before = len(boxing.lines)
    if version == 1:
        conversation.received(package("M", b"\x03" + text))
    else:
        conversation.received(package("M", bytes([len(text)]) + text + b"\x01c\x03"))
    return boxing.lines[before:]


@pytest.mark.parametrize("version", [1, 2])
def test_a_text_message_is_logged(boxing: Boxed, port: RtdePort, version: int) -> None:
    assert told(port, boxing, b"part inserted", version) == ["rtde 127.0.0.1:1: part inserted"]


@SHARED
@given(st.text(max_size=60).map(str.encode) | st.binary(max_size=200), st.sampled_from([1, 2]))
def test_a_text_message_is_one_printable_line_whatever_it_contains(boxing: Boxed, text: bytes, version: int) -> None:
    (line,) = told(RtdePort(boxing.box), boxing, text, version)
    assert line.isprintable()
    assert line.startswith("rtde 127.0.0.1:1: ")


def test_a_message_cannot_forge_a_line_or_command_a_terminal(boxing: Boxed, port: RtdePort) -> None:
    (line,) = told(port, boxing, b"a\x1b[2J\nsafety mode normal\r", 2)
    assert line == "rtde 127.0.0.1:1: a [2J safety mode normal "


def test_messages_in_masses_are_counted_instead(boxing: Boxed, port: RtdePort) -> None:
    conversation, _ = client(port)
    say = package("M", b"\x02hi\x01c\x03")
    before = len(boxing.lines)
    for _ in range(10):
        conversation.received(say * 10)
        conversation.cycle()
    assert len(boxing.lines) - before == 10
    boxing.cycles(501)
    conversation.received(say)
    assert boxing.lines[-2:] == ["rtde 127.0.0.1:1: 90 more messages were left out", "rtde 127.0.0.1:1: hi"]


# What a client sets


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_no_number_is_not_taken(boxing: Boxed, port: RtdePort, bad: float) -> None:
    conversation, _ = client(port, package("I", b"external_force_torque"))
    conversation.received(package("U", struct.pack(">B6d", 1, 1, 2, 3, 4, 5, 6)))
    assert boxing.box.external_force_torque == [1, 2, 3, 4, 5, 6]
    conversation.received(package("U", struct.pack(">B6d", 1, 0, 0, bad, 0, 0, 0)))
    assert boxing.box.external_force_torque == [1, 2, 3, 4, 5, 6]
    boxing.box.external_force_torque = None


def test_a_short_package_warns_the_client_only_once_it_has_started(boxing: Boxed, port: RtdePort) -> None:
    conversation, ear = client(port, package("I", b"input_double_register_42"), package("O", RATE + b"timestamp"))
    before = len(boxing.lines)
    conversation.received(package("U", b"\x01"))
    assert commands(ear) == []
    conversation.received(package("S"))
    assert commands(ear) == ["S"]
    conversation.received(package("U", b"\x01"))
    assert commands(ear) == ["M"]
    assert len(boxing.lines) - before == 1


# Claims


def test_input_recipes_come_to_an_end(port: RtdePort) -> None:
    conversation, _ = client(port)
    with pytest.raises(PeerError, match="255 RTDE input recipes"):  # noqa: PT012 - a flood takes several rounds
        for _ in range(256):
            conversation.received(package("I", b"input_int_register_43"))
            conversation.cycle()
    conversation.closed()
    assert port.claims == {}


FIELDS = ("input_int_register_1", "input_double_register_1", "input_bit_register_64", "speed_slider_mask", "nonsense")


class Claims(RuleBasedStateMachine):
    """Clients come, claim input fields and go; a model says who owns what and which number each recipe has."""

    box: ControlBox  # given to a subclass below

    def __init__(self) -> None:
        super().__init__()
        self.port = RtdePort(self.box)
        self.clients: list[tuple[RtdeConversation, Ear]] = []
        self.owners: dict[str, int] = {}  # field -> identity of the conversation
        self.recipes: dict[int, int] = {}  # identity of a conversation -> recipes it has

    @rule()
    def come(self) -> None:
        if len(self.clients) < 4:
            self.clients.append(client(self.port))
            self.recipes[id(self.clients[-1][0])] = 0

    @rule(which=st.integers(0, 3), names=st.lists(st.sampled_from(FIELDS), min_size=1, max_size=3, unique=True))
    def claim(self, which: int, names: list[str]) -> None:
        if which >= len(self.clients):
            return
        conversation, ear = self.clients[which]
        me = id(conversation)
        expected = [
            "NOT_FOUND" if name not in INPUTS else "IN_USE" if self.owners.get(name, me) != me else INPUTS[name]
            for name in names
        ]
        fine = not {"NOT_FOUND", "IN_USE"} & set(expected)
        if fine:
            self.recipes[me] += 1
            self.owners.update(dict.fromkeys(names, me))
        conversation.received(package("I", ",".join(names).encode()))
        conversation.cycle()
        ((_, answer),) = PackageStream().feed(ear.take())
        assert answer == bytes([self.recipes[me] if fine else 0]) + ",".join(expected).encode()

    @rule(which=st.integers(0, 3), by_error=st.booleans())
    def go(self, which: int, by_error: bool) -> None:
        if which >= len(self.clients):
            return
        conversation, _ = self.clients.pop(which)
        if by_error:
            with pytest.raises(PeerError):
                conversation.received(package("U", b"\xff"))
        conversation.closed()
        self.owners = {name: owner for name, owner in self.owners.items() if owner != id(conversation)}
        del self.recipes[id(conversation)]

    @invariant()
    def owners_are_known(self) -> None:
        assert {name: id(owner) for name, owner in self.port.claims.items()} == self.owners


def test_a_field_has_one_owner_whoever_comes_and_goes(boxing: Boxed) -> None:
    machine = type("Machine", (Claims,), {"box": boxing.box})
    run_state_machine_as_test(machine, settings=settings(max_examples=60, stateful_step_count=25, deadline=None))
