"""The dashboard server as its clients read it, line by line."""

import pytest
from control_box_peers import KeepingPeer, NotingBox
from hypothesis import given
from hypothesis import strategies as st

from drivers.ur3e.control_box.dashboard import DashboardConversation
from drivers.ur3e.control_box.modes import RobotMode, RuntimeState, SafetyMode
from drivers.ur3e.control_box.peer import PeerError
from drivers.ur3e.simulated_arm import SimulatedArm

ARM = NotingBox().arm


class Client:
    def __init__(self, **box: object) -> None:
        self.box = NotingBox(arm=ARM, **box)  # type: ignore[arg-type]
        self.peer = KeepingPeer()
        self.server = DashboardConversation(self.box, self.peer)
        self.server.opened()
        self.banner = self.peer.take().decode()

    def ask(self, line: str) -> str:
        self.server.received(line.encode() + b"\n")
        answer = self.peer.take().decode()
        assert answer.endswith("\n")
        assert answer.count("\n") == 1
        return answer[:-1]


def test_a_client_is_greeted() -> None:
    assert Client().banner == "Connected: Universal Robots Dashboard Server\n"
    assert isinstance(ARM, SimulatedArm)


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("robotmode", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("running", "Program running: false"),
        ("programState", "STOPPED <unnamed>"),
        ("get loaded program", "No program loaded"),
        ("isProgramSaved", "false <unnamed>"),
        ("get serial number", "20245300001"),
        ("get robot model", "UR3"),
        ("version", "5.22.0.1101319"),
        ("PolyscopeVersion", "URSoftware 5.22.0.1101319 (Jan 15 2025)"),
        ("is in remote control", "true"),
        ("get operational mode", "NONE"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("stop", "Failed to execute: stop"),
        ("load nowhere.urp", "File not found: nowhere.urp"),
        ("load broken.script", "Error while loading program: broken.script"),
        ("load", "File not found: "),
        ("load installation default.installation", "File not found: default.installation"),
        ("addToLog", "No log message to add"),
        ("generate flight report system", "Failed to execute: generate flight report system"),
        ("generate support file a/b", "Failed to execute: generate support file a/b"),
        ("saveLog", "Failed to execute: saveLog"),
        ("set operational mode sideways", "Failed setting operational mode: 'sideways'"),
        ("setUserRole operator", "could not understand: 'setUserRole operator'"),
        ("getUserRole", "could not understand: 'getUserRole'"),
        ("play it", "could not understand: 'play it'"),
        ("", "could not understand: ''"),
        ("dance", "could not understand: 'dance'"),
    ],
)
def test_answers_of_an_idle_box(line: str, answer: str) -> None:
    client = Client()
    assert client.ask(line) == answer
    assert client.ask(line.upper() if "'" not in answer and ":" not in answer else line) == answer


def test_a_refusal_says_why_in_the_log() -> None:
    client = Client()
    client.ask("generate support file here")
    assert "has no support files" in client.box.lines[0]


def test_programs() -> None:
    client = Client()
    assert client.ask("load cell/insert.script") == "Loading program: cell/insert.script"
    assert client.ask("get loaded program") == "Loaded program: cell/insert.script"
    assert client.ask("isProgramSaved") == "true insert.script"
    assert client.ask("programState") == "STOPPED insert.script"
    assert client.ask("play") == "Starting program"
    assert client.ask("running") == "Program running: true"
    assert client.ask("programState") == "PLAYING insert.script"
    assert client.ask("pause") == "Pausing program"
    assert client.ask("programState") == "PAUSED insert.script"
    assert client.ask("running") == "Program running: false"
    assert client.ask("stop") == "Stopped"
    assert client.box.runtime_state is RuntimeState.STOPPED


def test_a_program_that_was_sent_has_its_own_name() -> None:
    assert Client(program_name="rtde_control").ask("programState") == "STOPPED rtde_control"


def test_power() -> None:
    client = Client(robot_mode=RobotMode.POWER_OFF)
    assert client.ask("power on") == "Powering on"
    assert client.ask("robotmode") == "Robotmode: IDLE"
    assert client.ask("brake release") == "Brake releasing"
    assert client.ask("robotmode") == "Robotmode: RUNNING"
    assert client.ask("restart safety") == "Restarting safety"
    assert client.ask("robotmode") == "Robotmode: POWER_OFF"
    client.ask("power on")
    assert client.ask("power off") == "Powering off"
    assert client.box.robot_mode is RobotMode.POWER_OFF


def test_unlocking_a_protective_stop() -> None:
    client = Client(safety_mode=SafetyMode.PROTECTIVE_STOP, unlocks=False)
    assert client.ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert client.ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s after occurrence.")
    client.box.unlocks = True
    assert client.ask("unlock protective stop") == "Protective stop releasing"
    assert client.ask("safetymode") == "Safetymode: NORMAL"


def test_what_the_operator_sees() -> None:
    client = Client()
    assert client.ask('popup Part 3  is missing, "sorry"') == "showing popup"
    assert client.ask("close popup") == "closing popup"
    assert client.ask("close safety popup") == "closing safety popup"
    assert client.ask("addToLog Shift begins") == "Added log message"
    assert client.box.calls == [
        'popup Part 3  is missing, "sorry"',
        "close popup",
        "close safety popup",
        "log Shift begins",
    ]


def test_operational_mode() -> None:
    client = Client()
    assert client.ask("set operational mode automatic") == "Operational mode 'automatic' is set"
    assert client.ask("get operational mode") == "AUTOMATIC"
    assert (
        client.ask("clear operational mode")
        == "No longer controlling the operational mode. Current operational mode: 'NONE'."
    )
    assert client.box.operational_mode == "NONE"


def test_in_local_control_only_questions_are_answered() -> None:
    client = Client(remote_control=False, robot_mode=RobotMode.POWER_OFF)
    refusal = client.ask("power on")
    assert refusal.startswith("Command is not allowed due to safety reasons")
    for line in ("play", "stop", "pause", "load x", "shutdown", "brake release", "unlock protective stop"):
        assert client.ask(line) == refusal
    assert client.box.robot_mode is RobotMode.POWER_OFF
    assert client.box.calls == []
    assert client.ask("is in remote control") == "false"
    assert client.ask("robotmode") == "Robotmode: POWER_OFF"


def test_quit_hangs_up_and_nothing_after_it_counts() -> None:
    client = Client()
    client.server.received(b"quit\npower off\n")
    assert client.peer.take() == b"Disconnected\n"
    assert client.peer.closed
    client.server.cycle()
    client.server.closed()
    assert client.box.robot_mode is RobotMode.RUNNING


def test_shutdown() -> None:
    client = Client()
    assert client.ask("shutdown") == "Shutting down"
    assert client.box.calls == ["shutdown"]


@given(st.lists(st.sampled_from(["robotmode", "running", "version", "nonsense"]), max_size=30), st.data())
def test_lines_are_answered_however_they_are_cut(lines: list[str], data: st.DataObject) -> None:
    client = Client()
    text = "".join(line + data.draw(st.sampled_from(["\n", "\r\n"])) for line in lines).encode()
    while text:
        size = data.draw(st.integers(1, len(text)))
        client.server.received(text[:size])
        text = text[size:]
    for _ in lines:
        client.server.cycle()
    expected = {
        "robotmode": "Robotmode: RUNNING",
        "running": "Program running: false",
        "version": "5.22.0.1101319",
        "nonsense": "could not understand: 'nonsense'",
    }
    assert client.peer.take().decode() == "".join(expected[line] + "\n" for line in lines)


def test_what_came_in_whole_before_the_client_went_is_done() -> None:
    client = Client()
    client.server.received(b"nothing\n" * 8 + b"power off\n")
    assert client.box.robot_mode is RobotMode.RUNNING
    client.server.closed()
    assert client.box.robot_mode is RobotMode.POWER_OFF


@given(st.binary(max_size=300))
def test_any_bytes_are_answered_line_by_line(junk: bytes) -> None:
    client = Client()
    client.server.received(junk)
    for _ in range(junk.count(b"\n")):
        client.server.cycle()
    answers = client.peer.take()
    assert client.peer.closed or answers.count(b"\n") == junk.count(b"\n")


def test_an_endless_line_and_a_flood_of_lines_are_too_much() -> None:
    with pytest.raises(PeerError, match="over 4096 bytes"):
        Client().server.received(b"x" * 5000)
    client = Client()

    def flood() -> None:
        for _ in range(100):
            client.server.received(b"robotmode\n" * 800)

    with pytest.raises(PeerError, match="without waiting"):
        flood()
