"""RTDE without sockets: packages in and out of a real control box."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import pytest
from control_boxes import Boxed, Ear, boxed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.ur3e.control_box.peer import PeerError
from drivers.ur3e.control_box.rtde import RtdeConversation, RtdePort
from drivers.ur3e.control_box.rtde_inputs import INPUTS
from drivers.ur3e.control_box.rtde_outputs import OUTPUTS, output
from drivers.ur3e.control_box.rtde_wire import COUNT, HEADER, LARGEST, LAYOUT, PackageStream, package
from drivers.ur3e.control_box.version import polyscope

SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@pytest.fixture(scope="module")
def boxing() -> Iterator[Boxed]:
    with boxed() as made:
        made.cycles(5)
        yield made


class Client:
    """One RTDE client, as bytes."""

    def __init__(self, port: RtdePort, version: int = 2) -> None:
        self.ear = Ear()
        self.port = port
        self.conversation: RtdeConversation = port.conversation(self.ear)
        self.conversation.opened()
        assert self.ask("V", struct.pack(">H", version)) == b"\x01"

    def say(self, command: str, payload: bytes = b"") -> None:
        self.conversation.received(package(command, payload))

    def ask(self, command: str, payload: bytes = b"") -> bytes:
        self.say(command, payload)
        ((answered, answer),) = self.heard()
        assert answered == command
        return answer

    def heard(self) -> list[tuple[str, bytes]]:
        return list(PackageStream().feed(self.ear.take()))

    def outputs(self, names: str, rate: float = 500.0) -> tuple[int, list[str]]:
        answer = self.ask("O", struct.pack(">d", rate) + names.encode())
        return answer[0], answer[1:].decode().split(",")

    def inputs(self, names: str) -> tuple[int, list[str]]:
        answer = self.ask("I", names.encode())
        return answer[0], answer[1:].decode().split(",")

    def cycle(self) -> list[bytes]:
        """Data packages of one control cycle."""
        self.port.cycle()
        self.conversation.cycle()
        return [payload for command, payload in self.heard() if command == "U"]


@pytest.fixture
def port(boxing: Boxed) -> RtdePort:
    return RtdePort(boxing.box)


@given(st.sampled_from("VvOISPUM"), st.binary(max_size=LARGEST - 3), st.data())
def test_packages_survive_any_cutting(command: str, payload: bytes, data: st.DataObject) -> None:
    stream, whole = PackageStream(), package(command, payload) * 2
    cut = data.draw(st.lists(st.integers(0, len(whole)), max_size=6).map(sorted))
    found = []
    for start, end in zip([0, *cut], [*cut, len(whole)], strict=True):
        found += list(stream.feed(whole[start:end]))
    assert found == [(command, payload)] * 2


@pytest.mark.parametrize("size", [0, 1, 2, LARGEST + 1, 65535])
def test_an_impossible_size_is_an_error(size: int) -> None:
    with pytest.raises(PeerError, match=f"{size} bytes"):
        list(PackageStream().feed(HEADER.pack(size, ord("V"))))


def test_versions_and_controller(port: RtdePort) -> None:
    client = Client(port)
    assert client.ask("V", struct.pack(">H", 3)) == b"\x00"
    assert struct.unpack(">4I", client.ask("v"))[:3] == (5, 22, 0)


def test_every_output_has_the_type_it_claims_and_a_finite_value(port: RtdePort) -> None:
    client = Client(port)
    names = [name for name in OUTPUTS if output(name, port.box.version) is not None]
    for start in range(0, len(names), 40):
        some = names[start : start + 40]
        recipe, types = client.outputs(",".join(some))
        assert recipe == 1
        assert types == [OUTPUTS[name].type for name in some]
        assert client.ask("S") == b"\x01"
        (data,) = client.cycle()
        values = struct.unpack(">B" + "".join(LAYOUT[kind] for kind in types), data)
        assert values[0] == 1
        assert len(values) == 1 + sum(COUNT[kind] for kind in types)
        assert all(math.isfinite(value) for value in values)


def test_outputs_are_the_simulation_s(boxing: Boxed, port: RtdePort) -> None:
    client = Client(port)
    names = (
        "timestamp,actual_q,actual_TCP_pose,ft_raw_wrench,payload,robot_mode,safety_status_bits,output_int_register_7"
    )
    boxing.box.registers.output_int[7] = -12
    recipe, types = client.outputs(names)
    assert (recipe, len(types)) == (1, 8)
    client.ask("S")
    boxing.cycles(3)
    (data,) = client.cycle()
    values = struct.unpack(">B" + "".join(LAYOUT[kind] for kind in types), data)[1:]
    arm = boxing.box.arm
    assert values[0] == boxing.box.time
    assert list(values[1:7]) == arm.getActualQ()
    assert list(values[7:13]) == arm.getActualTCPPose()
    assert list(values[13:19]) == arm.getFtRawWrench()
    assert values[19:] == (arm.payload[0], 7, 1, -12)


def test_an_unknown_output_is_named_and_nothing_starts(port: RtdePort) -> None:
    client = Client(port)
    assert client.outputs("timestamp,nonsense,actual_q") == (0, ["DOUBLE", "NOT_FOUND", "VECTOR6D"])
    assert client.ask("S") == b"\x00"
    assert client.cycle() == []


@pytest.mark.parametrize(("version", "known"), [("5.10", False), ("5.11", True), ("5.22", True)])
def test_a_field_exists_from_its_version_on(version: str, known: bool) -> None:
    assert (output("payload_inertia", polyscope(version)) is not None) is known


def test_a_comma_at_the_end_is_no_name(port: RtdePort) -> None:
    assert Client(port).outputs("timestamp,") == (1, ["DOUBLE"])
    assert Client(port).inputs("input_int_register_0,") == (1, ["INT32"])


@pytest.mark.parametrize("rate", [0.0, 0.5, -1.0, 501.0, math.nan, math.inf])
def test_a_frequency_that_cannot_be_is_refused(port: RtdePort, rate: float) -> None:
    client = Client(port)
    assert client.outputs("timestamp", rate)[0] == 0
    assert client.ask("S") == b"\x00"


@pytest.mark.parametrize("rate", [1.0, 7.0, 125.0, 300.0, 333.0, 500.0])
def test_packages_come_at_the_frequency(port: RtdePort, rate: float) -> None:
    client = Client(port)
    client.outputs("timestamp", rate)
    client.ask("S")
    assert sum(len(client.cycle()) for _ in range(1000)) == pytest.approx(2 * rate, abs=1.01)


def test_pause_resume_and_another_recipe(port: RtdePort) -> None:
    client = Client(port)
    client.outputs("timestamp")
    client.ask("S")
    assert len(client.cycle()) == 1
    assert client.ask("P") == b"\x01"
    assert client.cycle() == []
    assert client.outputs("actual_q,timestamp")[0] == 1
    client.ask("S")
    (data,) = client.cycle()
    assert len(data) == 1 + 7 * 8


def test_version_1_has_no_frequency_and_no_recipe(port: RtdePort) -> None:
    client = Client(port, version=1)
    assert client.ask("O", b"timestamp") == b"DOUBLE"
    client.ask("S")
    (data,) = client.cycle()
    assert struct.unpack(">d", data) == (port.box.time,)


def test_an_input_has_one_owner_until_it_leaves(port: RtdePort) -> None:
    first, second = Client(port), Client(port)
    assert first.inputs("input_int_register_3,input_double_register_4") == (1, ["INT32", "DOUBLE"])
    assert first.inputs("input_int_register_3") == (2, ["INT32"])  # its own, in another recipe
    assert second.inputs("input_double_register_4,input_int_register_5") == (0, ["IN_USE", "INT32"])
    assert second.inputs("input_int_register_5") == (1, ["INT32"])
    first.conversation.closed()
    assert second.inputs("input_double_register_4") == (2, ["DOUBLE"])


VALUES = {
    "BOOL": st.booleans(),
    "UINT8": st.integers(0, 255),
    "UINT32": st.integers(0, 2**32 - 1),
    "INT32": st.integers(-(2**31), 2**31 - 1),
    "DOUBLE": st.floats(allow_nan=False),
}
REGISTERS = [name for name in INPUTS if "register" in name and not name.startswith("input_bit_registers")]


@SHARED
@given(st.lists(st.sampled_from(REGISTERS), min_size=1, max_size=8, unique=True), st.data())
def test_registers_take_what_is_written(boxing: Boxed, names: list[str], data: st.DataObject) -> None:
    client = Client(RtdePort(boxing.box))
    recipe, types = client.inputs(",".join(names))
    values = [data.draw(VALUES[kind]) for kind in types]
    client.say("U", struct.pack(">B" + "".join(LAYOUT[kind] for kind in types), recipe, *values))
    for name, value in zip(names, values, strict=True):
        kind, _, index = name.rpartition("_register_")
        assert getattr(boxing.box.registers, kind)[int(index)] == value
        assert client.port.fed[name] == 1


def test_bits_outputs_and_slider(boxing: Boxed, port: RtdePort) -> None:
    client, box = Client(port), boxing.box
    names = (
        "speed_slider_mask,speed_slider_fraction,standard_digital_output_mask,standard_digital_output,"
        "tool_digital_output_mask,tool_digital_output,standard_analog_output_mask,standard_analog_output_type,"
        "standard_analog_output_0,standard_analog_output_1,input_bit_registers0_to_31"
    )
    recipe, types = client.inputs(names)
    layout = ">B" + "".join(LAYOUT[kind] for kind in types)
    box.wiring.digital_out = 0b1000_0000
    client.say("U", struct.pack(layout, recipe, 1, 0.4, 0b101, 0b111, 2, 3, 3, 2, 0.5, 0.25, 0x80000001))
    assert box.speed_slider == 0.4
    assert box.wiring.digital_out == 0b1000_0101 | 2 << 16
    assert box.wiring.analog_out == pytest.approx([0.012, 2.5])
    assert [bit for bit in range(64) if box.registers.input_bit[bit]] == [0, 31]
    client.say("U", struct.pack(layout, recipe, 0, 0.9, 0, 0, 0, 0, 0, 0, 0.0, 0.0, 0))
    assert box.speed_slider == 0.4
    assert box.wiring.digital_out == 0b1000_0101 | 2 << 16
    box.set_speed_slider(1.0)


def test_a_short_package_does_nothing_and_a_long_one_counts_as_far_as_it_goes(boxing: Boxed, port: RtdePort) -> None:
    client = Client(port)
    recipe, _ = client.inputs("input_double_register_10,input_double_register_11")
    registers = boxing.box.registers.input_double
    registers[10:12] = [1.0, 2.0]
    client.say("U", struct.pack(">Bd", recipe, 7.0))
    assert registers[10:12] == [1.0, 2.0]
    assert "ignored: 8 bytes, 16 needed" in boxing.lines[-1]
    client.say("U", struct.pack(">B3d", recipe, 7.0, 8.0, 9.0))
    assert registers[10:12] == [7.0, 8.0]


@pytest.mark.parametrize(
    ("command", "payload", "words"),
    [
        ("X", b"", "no command 'X'"),
        ("V", b"\x00", "not what it says"),
        ("U", b"", "recipe 0 was not set up"),
        ("U", b"\x09abc", "recipe 9 was not set up"),
        ("S", b"now", "no use for"),
        ("O", b"\x00", "not what it says"),
        ("I", b"\xff\xfe", "not ASCII"),
    ],
)
def test_nonsense_drops_the_client_with_a_reason(port: RtdePort, command: str, payload: bytes, words: str) -> None:
    client = Client(port)
    with pytest.raises(PeerError, match=words):
        client.say(command, payload)


@SHARED
@given(st.lists(st.binary(max_size=300), max_size=8))
def test_random_bytes_are_never_more_than_a_client_s_error(boxing: Boxed, pieces: list[bytes]) -> None:
    conversation = RtdePort(boxing.box).conversation(Ear())
    try:
        for piece in pieces:
            conversation.received(piece)
            conversation.cycle()
    except PeerError:
        pass
    conversation.closed()


@SHARED
@given(st.lists(st.tuples(st.sampled_from("VvOISPUM"), st.binary(max_size=64)), max_size=12))
def test_random_packages_are_never_more_than_a_client_s_error(boxing: Boxed, packages: list[tuple[str, bytes]]) -> None:
    conversation = RtdePort(boxing.box).conversation(Ear())
    try:
        for command, payload in packages:
            conversation.received(package(command, payload))
            conversation.cycle()
    except PeerError:
        pass
    conversation.closed()


def test_a_client_that_does_not_read_is_sent_no_more(port: RtdePort) -> None:
    client = Client(port)
    client.outputs("timestamp")
    client.ask("S")
    client.ear.backlog = 10_000_000
    assert client.cycle() == []
    client.ear.backlog = 0
    assert len(client.cycle()) == 1
