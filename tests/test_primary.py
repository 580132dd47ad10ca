"""The script ports: what a client reads, taken apart by layouts written down anew, and the programs it sends."""

import math
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from control_box_peers import KeepingPeer, NotingBox
from hypothesis import given
from hypothesis import strategies as st

from drivers.ur3e import frames
from drivers.ur3e.control_box.events import (
    CompileError,
    ErrorCode,
    Event,
    Popup,
    ProgramStarted,
    ProgramStopped,
    RuntimeException,
    SafetyModeChanged,
    TextMessage,
)
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.peer import PeerError
from drivers.ur3e.control_box.primary import event_message, robot_state, version_message
from drivers.ur3e.control_box.realtime import RealtimePackage, elbow_position, elbow_velocity, realtime_package
from drivers.ur3e.control_box.script_port import PrimaryConversation, RealtimeConversation, SecondaryConversation
from drivers.ur3e.control_box.script_text import LIMIT, ScriptText
from drivers.ur3e.control_box.version import PolyScope

BOX = NotingBox()
for _ in range(20):
    BOX.arm.cycle()


def packages(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Types and bodies of packages, or of sub-packages."""
    while data:
        size, kind = struct.unpack_from(">iB", data)
        assert 5 <= size <= len(data)
        yield kind, data[5:size]
        data = data[size:]


def state(box: NotingBox) -> dict[int, bytes]:
    ((kind, body),) = packages(robot_state(box))
    assert kind == 16
    found = list(packages(body))
    assert len(dict(found)) == len(found)
    return dict(found)


def message(event: Event) -> tuple[int, bytes]:
    ((kind, body),) = packages(event_message(event, 61.5))
    assert kind == 20
    stamp, source, number = struct.unpack_from(">QbB", body)
    assert stamp == 61_500_000_000
    assert source in (-2, -3)
    return number, body[10:]


# States


def test_sub_packages_have_the_sizes_of_a_controller() -> None:
    sizes = {kind: len(body) + 5 for kind, body in state(BOX).items()}
    assert sizes == {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 5: 225, 6: 445, 7: 61, 8: 9, 9: 53, 11: 26, 12: 8}


def test_robot_mode_data() -> None:
    box = NotingBox(
        arm=BOX.arm,
        robot_mode=RobotMode.IDLE,
        safety_mode=SafetyMode.PROTECTIVE_STOP,
        runtime_state=RuntimeState.PAUSED,
    )
    time, *rest = struct.unpack(">Q7?bB3dB", state(box)[0])
    assert time == round(box.time * 1e9)
    assert rest == [True, True, True, False, True, False, True, 5, 0, 0.97, 0.5, 1.0, 0]
    box = NotingBox(
        arm=BOX.arm,
        robot_mode=RobotMode.POWER_OFF,
        safety_mode=SafetyMode.ROBOT_EMERGENCY_STOP,
        runtime_state=RuntimeState.PLAYING,
        teaching=True,
    )
    rest = list(struct.unpack(">Q7?bB3dB", state(box)[0]))[1:]
    assert rest[:9] == [True, True, False, True, False, True, False, 3, 1]


def test_joint_data() -> None:
    rows = list(struct.iter_unpack(">3d4fB", state(BOX)[1]))
    assert [row[0] for row in rows] == BOX.arm.getActualQ()
    assert [row[1] for row in rows] == BOX.arm.getTargetQ()
    assert [row[2] for row in rows] == BOX.arm.getActualQd()
    assert [row[3] for row in rows] == pytest.approx(BOX.electrics.joint_current)
    assert [row[4] for row in rows] == pytest.approx(BOX.electrics.joint_voltage)
    assert [row[5] for row in rows] == pytest.approx(BOX.electrics.joint_temperature)
    assert {row[7] for row in rows} == {253}


def test_tool_and_masterboard_data() -> None:
    box = NotingBox(arm=BOX.arm)
    box.wiring.set_output(16, True)
    box.wiring.set_input(3, True)
    box.wiring.analog_out[1] = 0.0125
    box.wiring.analog_in_voltage[0] = True
    box.wiring.tool_voltage = 24
    tool = struct.unpack(">2B2dfB2fB", state(box)[2])
    assert tool == (1, 1, 0.0, 0.0, 48.0, 24, 0.03125, 29.5, 253)
    board = struct.unpack(">2I2B2d2B2d4f3BI3B", state(box)[3])
    assert board[:10] == (8, 1 << 16, 1, 0, 0.004, 0.004, 0, 0, 0.004, 0.0125)
    assert board[11:17] == (48.0, 0.75, 0.0625, 1, 0, 0)


def test_cartesian_info() -> None:
    BOX.arm.setTcp([0.0, 0.01, 0.1, 0.0, 0.0, 0.2])
    values = struct.unpack(">12d", state(BOX)[4])
    assert list(values[:6]) == BOX.arm.getActualTCPPose()
    assert values[6:] == (0.0, 0.01, 0.1, 0.0, 0.0, 0.2)
    BOX.arm.setTcp([0.0] * 6)


def test_the_kinematics_are_those_of_the_arm() -> None:
    """Denavit and Hartenberg's chain, multiplied out, ends where the arm says its flange is."""
    values = struct.unpack(">6I24dI", state(BOX)[5])
    theta, a, d, alpha = (values[6 + 6 * i : 12 + 6 * i] for i in range(4))
    q = [0.3, -1.1, 1.4, -0.7, 0.9, -0.4]
    chain = np.eye(4)
    for i in range(6):
        c, s = math.cos(q[i] + theta[i]), math.sin(q[i] + theta[i])
        ca, sa = math.cos(alpha[i]), math.sin(alpha[i])
        chain = chain @ np.array(
            [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s], [0, sa, ca, d[i]], [0, 0, 0, 1]]
        )
        if i == 1:
            assert chain[:3, 3] == pytest.approx(elbow_position(q))
    pose = BOX.arm.getForwardKinematics(q, [0.0] * 6)
    assert chain[:3, 3] == pytest.approx(pose[:3], abs=1e-9)
    assert chain[:3, :3].ravel() == pytest.approx(frames.rotation_of_vector(pose[3:]), abs=1e-9)


def test_configuration_data() -> None:
    values = struct.unpack(">12d12d5d24d4i", state(BOX)[6])
    assert values[4:6] == (-math.pi, math.pi)
    assert values[12] == math.pi
    assert values[24:28] == (1.05, 1.4, 0.25, 1.2)
    assert values[29:53] == struct.unpack(">24d", state(BOX)[5][72:216] + state(BOX)[5][24:72])
    assert values[-2] == 3


def test_force_mode_data() -> None:
    values = struct.unpack(">7d", state(BOX)[7])
    assert list(values[:6]) == BOX.arm.getActualTCPForce()
    assert 0.001 < values[6] < 0.1


def test_the_realtime_package() -> None:
    package = realtime_package(BOX)
    assert len(package) == 1220
    size, *values = struct.unpack(">i152d", package)
    assert size == 1220
    arm, electrics = BOX.arm, BOX.electrics
    assert values[0] == BOX.time
    six = [values[1 + 6 * i : 7 + 6 * i] for i in range(14)]
    assert six[0] == arm.getTargetQ()
    assert six[3] == list(electrics.target_current)
    assert six[4] == list(electrics.target_moment)
    assert six[5] == arm.getActualQ()
    assert six[6] == arm.getActualQd()
    assert six[7] == list(electrics.joint_current)
    assert six[9:13] == [
        arm.getActualTCPPose(),
        arm.getActualTCPSpeed(),
        arm.getActualTCPForce(),
        arm.getTargetTCPPose(),
    ]
    assert values[86:92] == list(electrics.joint_temperature)
    assert values[92] == 0.0004
    assert values[94] == 7
    assert values[95:101] == [253] * 6
    assert values[101] == 1
    assert values[108:111] == list(electrics.tool_acceleration)
    assert values[117:119] == [0.5, 0.125]
    assert values[121:124] == [47.5, 48.0, 0.75]
    assert values[124:130] == list(electrics.joint_voltage)
    assert values[131] == 1
    assert values[132:135] == list(elbow_position(arm.getActualQ()))
    assert values[138] == 1
    assert (values[142], *values[143:146]) == (arm.payload[0], *arm.payload[1])
    assert values[146:] == list(BOX.payload_inertia)


@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6), st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_the_elbow_moves_as_its_position_changes(q: list[float], qd: list[float]) -> None:
    step = 1e-6
    before, after = (elbow_position([a + sign * step * b for a, b in zip(q, qd, strict=True)]) for sign in (-1, 1))
    speed = [(b - a) / (2 * step) for a, b in zip(before, after, strict=True)]
    assert speed == pytest.approx(elbow_velocity(q, qd), abs=1e-6)


# Messages


def test_version_message() -> None:
    ((kind, body),) = packages(version_message(PolyScope(5, 22, 1), 0.0))
    assert kind == 20
    assert (
        body == bytes(8) + b"\xfe\x03\x09URControl" + struct.pack(">2B2i", 5, 22, 1, 1101319) + b"15-01-2025, 09:00:00"
    )


def test_messages() -> None:
    assert message(ProgramStarted("insert")) == (7, bytes(8) + b"\x13PROGRAM_XXX_STARTEDinsert")
    assert message(ProgramStopped("insert")) == (7, bytes(8) + b"\x13PROGRAM_XXX_STOPPEDinsert")
    assert message(RuntimeException(3, 1, "no such thing")) == (10, bytes([0, 0, 0, 3, 0, 0, 0, 1]) + b"no such thing")
    assert message(CompileError(4, 2, "syntax")) == (10, bytes([0, 0, 0, 4, 0, 0, 0, 2]) + b"syntax")
    assert message(SafetyModeChanged(SafetyMode.PROTECTIVE_STOP, "")) == (5, bytes(8) + b"\x03" + bytes(8))
    assert message(TextMessage("12 µm")) == (0, "12 µm".encode())
    assert message(ErrorCode(204, 2, "sudden")) == (6, struct.pack(">iiiII", 204, 2, 3, 0, 0) + b"sudden")
    assert message(Popup("Title", "text", "error", True)) == (2, bytes([0, 0, 0, 0, 0, 0, 1, 1, 5]) + b"Titletext")


# Conversations


def test_a_primary_client_is_told_the_version_then_all_that_happens() -> None:
    box, peer = NotingBox(arm=BOX.arm), KeepingPeer()
    server = PrimaryConversation(box, peer)
    server.opened()
    assert [kind for kind, _ in packages(peer.take())] == [20]
    box.events.extend([ProgramStarted("a"), ProgramStopped("a")])
    server.cycle()
    assert [body[8:10] for _, body in packages(peer.take())] == [b"\xfe\x07", b"\xfe\x07"]
    box.events.clear()
    kinds = []
    for _ in range(499):
        server.cycle()
        kinds += [kind for kind, _ in packages(peer.take())]
    assert kinds == [16] * 10


def test_a_secondary_client_is_told_no_events() -> None:
    box, peer = NotingBox(arm=BOX.arm), KeepingPeer()
    server = SecondaryConversation(box, peer)
    server.opened()
    box.events.append(TextMessage("hello"))
    for _ in range(100):
        server.cycle()
    assert [kind for kind, _ in packages(peer.take())] == [20, 16, 16]


def test_a_client_that_does_not_read_is_spared_states() -> None:
    box, peer = NotingBox(arm=BOX.arm), KeepingPeer(backlog=1)
    servers = [SecondaryConversation(box, peer), RealtimeConversation(box, peer, RealtimePackage(box))]
    for server in servers:
        server.opened()
    peer.take()
    for _ in range(200):
        for server in servers:
            server.cycle()
    assert peer.take() == b""
    peer.backlog = 0
    for server in servers:
        server.cycle()
    state_size = len(robot_state(box))
    assert len(peer.take()) == state_size + 1220


def test_the_realtime_package_is_new_in_every_cycle() -> None:
    box = NotingBox()
    peer = KeepingPeer()
    server = RealtimeConversation(box, peer, RealtimePackage(box))
    server.opened()
    times = []
    for _ in range(3):
        box.arm.cycle()
        server.cycle()
        times.append(struct.unpack_from(">id", peer.take()))
    assert times == [(1220, pytest.approx(60.002)), (1220, pytest.approx(60.004)), (1220, pytest.approx(60.006))]


def sent(*data: bytes, **box: object) -> tuple[NotingBox, KeepingPeer]:
    noting, peer = NotingBox(arm=BOX.arm, **box), KeepingPeer()  # type: ignore[arg-type]
    server = PrimaryConversation(noting, peer)
    server.opened()
    peer.take()
    for part in data:
        server.received(part)
    return noting, peer


def test_commands() -> None:
    assert sent(b"power on\n\n")[0].robot_mode is RobotMode.IDLE
    assert sent(b"power off\n")[0].robot_mode is RobotMode.POWER_OFF
    assert sent(b"set robotmode run\n", robot_mode=RobotMode.IDLE)[0].robot_mode is RobotMode.RUNNING
    assert sent(b"stop program\n", runtime_state=RuntimeState.PLAYING)[0].runtime_state is RuntimeState.STOPPED
    assert sent(b"pause program\n", runtime_state=RuntimeState.PLAYING)[0].runtime_state is RuntimeState.PAUSED
    box, _ = sent(b"set unlock protective stop\n", safety_mode=SafetyMode.PROTECTIVE_STOP)
    assert box.safety_mode is SafetyMode.NORMAL
    assert sent(b"set speed 0.25\n")[0].speed_slider == 0.25


def test_a_command_that_cannot_be_done_is_logged() -> None:
    assert "'stop program' cannot be done" in sent(b"stop program\n")[0].lines[0]
    assert "'set speed fast' names no speed" in sent(b"set speed fast\n")[0].lines[0]


def test_in_local_control_programs_are_refused() -> None:
    box, peer = sent(b"movej([0,0,0,0,0,0])\n", remote_control=False)
    assert box.programs == []
    ((_, body),) = packages(peer.take())
    assert struct.unpack_from(">Bii", body, 9)[:2] == (6, 210)


def test_programs_say_where_they_come_from() -> None:
    box, _ = sent(b"def a():\n  sync()\nend\n")
    assert box.programs == [("def a():\n  sync()\nend\n", "primary 127.0.0.1:51234")]


def test_a_few_programs_start_in_a_cycle_and_the_rest_later() -> None:
    box, peer = NotingBox(arm=BOX.arm), KeepingPeer()
    server = SecondaryConversation(box, peer)
    server.opened()
    server.received(b"sync()\n" * 11)
    assert len(box.programs) == 4
    server.cycle()
    assert len(box.programs) == 8
    server.closed()
    assert len(box.programs) == 11


def test_a_read_only_port_takes_no_programs() -> None:
    box = NotingBox(arm=BOX.arm)
    server = PrimaryConversation(box, KeepingPeer(), read_only=True)
    server.opened()
    server.received(b"power off\n")
    server.closed()
    assert box.robot_mode is RobotMode.RUNNING


# Cutting text into programs

FLAT = """# a program without indentation
def program():
global x = 0 # end
thread worker():
while (True):
textmsg("if this ends, end", x)
sync()
end
end
if x == 0:
x = 1
elif x == 1:
x = 2
else:
append_def = sending + the_end
end
kill run worker()
end
"""
PROGRAMS = [
    FLAT,
    "movej([0, -1.57, 0, 0, 0, 0])\n",
    "sec side():\n  set_digital_out(0, True)\nend\n",
    'textmsg("def")\n',
    "def one(): sync() end\n",
    'popup("it is not over)\n',
    "if digital_in(0):\n  halt\nend\n",
    "end\n",
]


def programs_of(parts: list[bytes]) -> list[str]:
    text = ScriptText()
    found = []
    for part in parts:
        text.add(part)
        while (program := text.take()) is not None:
            found.append(program)
    return found


@given(st.lists(st.sampled_from(PROGRAMS), max_size=6), st.data())
def test_programs_come_out_whole_however_they_are_cut(programs: list[str], data: st.DataObject) -> None:
    gaps = [data.draw(st.sampled_from(["", "\n", "  \r\n\n"])) for _ in programs]
    whole = "".join(gap + program for gap, program in zip(gaps, programs, strict=True)).encode()
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=8)))
    parts = [whole[a:b] for a, b in zip([0, *cuts], [*cuts, len(whole)], strict=True)]
    assert programs_of(parts) == programs


def test_programs_come_out_whole_byte_by_byte() -> None:
    whole = "".join(PROGRAMS).encode()
    assert programs_of([whole[i : i + 1] for i in range(len(whole))]) == PROGRAMS


def test_without_its_newline_a_program_is_not_complete() -> None:
    assert programs_of([b"movej(q)"]) == []
    assert programs_of([b"def a():\nsync()\nend"]) == []
    assert programs_of([b"def a():\nsync()\nend", b"\n"]) == ["def a():\nsync()\nend\n"]


@given(st.binary(max_size=400), st.integers(1, 50))
def test_any_bytes_make_programs_that_do_not_depend_on_how_they_were_cut(junk: bytes, size: int) -> None:
    parts = [junk[i : i + size] for i in range(0, len(junk), size)]
    assert programs_of(parts) == programs_of([junk])


@pytest.mark.parametrize("part", [b"def a():\n" * 100, b"x" * 1000, b'"' + b"x" * 1000, b"#" + b"x" * 1000])
def test_what_never_ends_is_too_much(part: bytes) -> None:
    with pytest.raises(PeerError, match="without an end"):
        programs_of([part] * (LIMIT // len(part) + 1))


def test_empty_lines_are_nothing() -> None:
    text = ScriptText()
    for _ in range(3 * LIMIT // 9000):
        text.add(b" \n\n" * 3000)
        assert text.take() is None
