"""The control box without sockets: power, stops, programs and what they do to the arm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from control_boxes import Boxed, boxed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.ur3e.control_box import panel
from drivers.ur3e.control_box.events import CompileError, Popup, RuntimeException, SafetyModeChanged, TextMessage
from drivers.ur3e.control_box.modes import (
    RobotMode,
    RuntimeState,
    SafetyMode,
    robot_status_bits,
    safety_status_bits,
)
from drivers.ur3e.control_box.programs import LoadResult
from drivers.ur3e.parameters import CYCLE
from runtime.errors import InputError


@pytest.fixture
def boxing() -> Iterator[Boxed]:
    with boxed() as made:
        yield made


def events(boxing: Boxed, kind: type) -> list[object]:
    return [event for event in boxing.box.events if isinstance(event, kind)]


def said(boxing: Boxed) -> list[str]:
    return [event.text for event in boxing.box.events if isinstance(event, TextMessage)]


LOOP = "def endless():\n  while True:\n    sync()\n  end\nend\n"
SWING = "def swing():\n  q = get_actual_joint_positions()\n  q[0] = q[0] + 1.0\n  movej(q, a=2, v=1)\nend\n"


@pytest.mark.parametrize("mode", list(SafetyMode))
def test_safety_bits_tell_the_mode_and_whether_it_stops(mode: SafetyMode) -> None:
    bits = safety_status_bits(mode)
    moving = mode in (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.RECOVERY)
    assert bool(bits >> 10 & 1) is not moving
    assert bool(bits >> 7 & 1) is (mode in (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP))
    assert len({safety_status_bits(other) for other in SafetyMode}) == len(SafetyMode)


def test_robot_bits() -> None:
    assert robot_status_bits(RobotMode.POWER_OFF, False, False, False) == 0
    assert robot_status_bits(RobotMode.RUNNING, True, False, False) == 0b11
    assert robot_status_bits(RobotMode.IDLE, False, True, True) == 0b1101


def test_power_goes_off_and_comes_back_in_its_steps(boxing: Boxed) -> None:
    box = boxing.box
    assert box.robot_mode == RobotMode.RUNNING
    box.power_off()
    boxing.cycles(2)
    assert box.robot_mode == RobotMode.POWER_OFF
    boxing.start(SWING)
    assert box.runtime_state == RuntimeState.STOPPED
    assert "refused: robot mode power_off" in boxing.lines[-1]
    box.power_on()
    seen = []
    for _ in range(1000):
        box.cycle()
        if not seen or seen[-1] != box.robot_mode:
            seen.append(box.robot_mode)
    assert seen == [RobotMode.POWER_ON, RobotMode.IDLE]
    box.brake_release()
    boxing.until(lambda: box.robot_mode == RobotMode.RUNNING, 1000)
    start = box.arm.getActualQ()[0]
    boxing.run(SWING)
    assert box.arm.getActualQ()[0] - start == pytest.approx(1.0, abs=1e-3)


def test_an_emergency_stop_brakes_ends_the_program_and_takes_the_power(boxing: Boxed) -> None:
    box = boxing.box
    boxing.start(SWING)
    boxing.cycles(200)
    assert max(map(abs, box.arm.getTargetQd())) > 0.5
    box.press_emergency_stop(True)
    speeds = []
    for _ in range(500):
        box.cycle()
        speeds.append(max(map(abs, box.arm.getTargetQd())))
        if box.robot_mode == RobotMode.POWER_OFF:
            break
    assert speeds[0] < 1.0
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == 0.0
    assert box.safety_mode == SafetyMode.ROBOT_EMERGENCY_STOP
    assert box.runtime_state == RuntimeState.STOPPED
    box.brake_release()
    boxing.cycles(1000)
    assert box.robot_mode == RobotMode.POWER_OFF  # the button is still pressed
    box.press_emergency_stop(False)
    box.brake_release()
    boxing.until(lambda: box.robot_mode == RobotMode.RUNNING, 2000)
    assert box.safety_mode == SafetyMode.NORMAL
    modes = [event.mode for event in box.events if isinstance(event, SafetyModeChanged)]
    assert modes == [SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.NORMAL]


def test_a_safeguard_stop_holds_the_path_and_the_motion_goes_on(boxing: Boxed) -> None:
    box = boxing.box
    start = np.array(box.arm.getActualQ())
    boxing.start(SWING)
    boxing.cycles(200)
    box.open_safeguard(True)
    boxing.cycles(200)
    assert box.safety_mode == SafetyMode.SAFEGUARD_STOP
    assert box.runtime_state == RuntimeState.PLAYING
    assert box.arm.getTargetQd() == [0.0] * 6
    held = box.arm.getTargetQ()
    boxing.cycles(500)
    assert box.arm.getTargetQ() == held
    box.open_safeguard(False)
    boxing.until(lambda: box.runtime_state == RuntimeState.STOPPED)
    assert np.array(box.arm.getActualQ()) - start == pytest.approx([1.0, 0, 0, 0, 0, 0], abs=2e-3)


def test_a_protective_stop_pauses_and_is_not_unlocked_for_five_seconds(boxing: Boxed) -> None:
    box = boxing.box
    start = box.arm.getActualQ()[0]
    boxing.start(SWING)
    boxing.cycles(200)
    box.arm.protective_stop("tested")
    boxing.cycles(1)
    assert box.safety_mode == SafetyMode.PROTECTIVE_STOP
    assert box.runtime_state == RuntimeState.PAUSED
    assert not box.play()
    assert not box.unlock_protective_stop()
    boxing.cycles(round(5.0 / CYCLE))
    assert box.unlock_protective_stop()
    assert box.safety_mode == SafetyMode.NORMAL
    assert box.runtime_state == RuntimeState.PAUSED
    boxing.cycles(10)
    assert box.arm.getTargetQd() == [0.0] * 6
    assert box.play()
    boxing.until(lambda: box.runtime_state == RuntimeState.STOPPED)
    assert box.arm.getActualQ()[0] - start == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "def far():\n  set_tcp(p[0,0,0,0,0,0])\n  while True:\n    speedl([0.4,0,0,0,0,0], 2)\n  end\nend\n",
            "TCP at",
        ),
        ("def stop():\n  protective_stop()\n  sync()\nend\n", "a program called protective_stop"),
    ],
)
def test_what_the_arm_cannot_do_is_a_protective_stop(boxing: Boxed, text: str, reason: str) -> None:
    boxing.start(text)
    boxing.until(lambda: boxing.box.safety_mode == SafetyMode.PROTECTIVE_STOP)
    boxing.cycles(1)
    assert reason in boxing.box.arm.stop_reason
    assert any(reason in line for line in boxing.lines)


def test_excess_force_is_a_protective_stop(boxing: Boxed) -> None:
    box = boxing.box
    box.arm.scene.push((0.0, 0.0, 150.0, 0.0, 0.0, 0.0))
    boxing.until(lambda: box.safety_mode == SafetyMode.PROTECTIVE_STOP, 200)
    assert "force at the wrist" in box.arm.stop_reason


def test_the_slider_makes_a_program_slower(boxing: Boxed) -> None:
    durations = []
    for slider in (1.0, 0.5):
        boxing.box.set_speed_slider(slider)
        boxing.cycles(300)
        begun = boxing.box.time
        boxing.run(SWING)
        durations.append(boxing.box.time - begun)
    assert durations[1] / durations[0] == pytest.approx(2.0, rel=0.05)


def test_a_program_that_errs_stops_and_says_where(boxing: Boxed) -> None:
    boxing.run("def wrong():\n  x = [1, 2, 3]\n  sync()\n  y = x[7]\nend\n")
    (error,) = events(boxing, RuntimeException)
    assert isinstance(error, RuntimeException)
    assert error.line == 4
    assert "stopped in line 4" in " ".join(boxing.lines)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("def a():\n  fly_home()\nend\n", 2, "fly_home"),
        ("def a():\n  x = (1 +\nend\n", 2, ""),
        ("def a():\n  while True:\n    sync()\n", 1, ""),
        ("def a():\n  optimovej([0,0,0,0,0,0])\nend\n", 2, "optimovej"),
    ],
)
def test_what_is_no_program_is_refused_with_its_line(text: str, line: int, words: str) -> None:
    with boxed(version="5.12") as boxing:
        boxing.start(text)
        (error,) = events(boxing, CompileError)
        assert isinstance(error, CompileError)
        assert error.line >= line
        assert words in error.text
        assert boxing.box.runtime_state == RuntimeState.STOPPED


def test_a_new_program_replaces_the_old_and_a_secondary_one_does_not(boxing: Boxed) -> None:
    boxing.start(LOOP)
    boxing.cycles(5)
    boxing.start('sec beside():\n  textmsg("beside")\n  set_digital_out(2, True)\nend\n')
    boxing.cycles(2)
    assert boxing.box.program_name == "endless"
    assert boxing.box.runtime_state == RuntimeState.PLAYING
    assert "beside" in said(boxing)
    assert boxing.box.wiring.digital_out == 0b100
    boxing.start("def other():\n  sleep(10)\nend\n")
    boxing.cycles(2)
    assert boxing.box.program_name == "other"


def test_pausing_holds_a_program_and_its_motion(boxing: Boxed) -> None:
    box = boxing.box
    boxing.start(SWING)
    boxing.cycles(150)
    assert box.pause()
    boxing.cycles(200)
    assert box.runtime_state == RuntimeState.PAUSED
    assert box.safety_mode == SafetyMode.NORMAL
    held = box.arm.getTargetQ()
    boxing.cycles(100)
    assert box.arm.getTargetQ() == held
    assert box.play()
    boxing.until(lambda: box.runtime_state == RuntimeState.STOPPED)


def test_a_killed_motion_brakes_and_leaves_the_arm_to_others(boxing: Boxed) -> None:
    boxing.run(
        """def kills():
  thread far():
    q = get_actual_joint_positions()
    q[0] = q[0] + 2
    movej(q, a=2, v=1)
  end
  t = run far()
  sleep(0.5)
  kill t
  sleep(0.02)
  textmsg("still ", is_steady())
  sleep(1)
  textmsg("then ", is_steady())
  q = get_actual_joint_positions()
  movej(q)
end
"""
    )
    assert said(boxing) == ["still False", "then True"]
    assert not events(boxing, RuntimeException)


def test_two_threads_cannot_move_the_arm_at_once(boxing: Boxed) -> None:
    boxing.run(
        """def fight():
  thread one():
    movej([0, -1, 1, 0, 1, 0])
  end
  t = run one()
  sync()
  movel(p[-0.3, 0, 0.3, 0, 3.14, 0])
end
"""
    )
    (error,) = events(boxing, RuntimeException)
    assert isinstance(error, RuntimeException)
    assert "another thread is already controlling the robot" in error.text
    assert error.line == 7


def test_a_blocking_window_holds_its_program_until_it_is_closed(boxing: Boxed) -> None:
    box = boxing.box
    boxing.start('def asks():\n  popup("fed?", title="Feeder", blocking=True)\n  textmsg("on")\nend\n')
    boxing.cycles(100)
    assert box.popup == Popup("Feeder", "fed?", "message", True)
    assert box.runtime_state == RuntimeState.PLAYING
    box.close_popup()
    boxing.cycles(2)
    assert said(boxing) == ["on"]


def test_the_watchdog_ends_a_program_that_is_not_fed(boxing: Boxed) -> None:
    boxing.box.fed = {"input_int_register_0": 3}
    boxing.start('def watched():\n  rtde_set_watchdog("input_int_register_0", 10, "stop")\n' + LOOP[14:])
    boxing.cycles(40)
    assert boxing.box.runtime_state == RuntimeState.PLAYING
    boxing.box.fed = {"input_int_register_0": 4}
    boxing.cycles(40)
    assert boxing.box.runtime_state == RuntimeState.PLAYING
    boxing.until(lambda: boxing.box.runtime_state == RuntimeState.STOPPED, 60)
    assert any(line.startswith("watchdog:") for line in boxing.lines)


def test_force_mode_ends_with_its_program(boxing: Boxed) -> None:
    limits = "[.1,.1,.1,.1,.1,.1]"
    force = f"force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,0,0,0,0], 2, {limits})"
    boxing.start(f"def presses():\n  {force}\n  sleep(1)\nend\n")
    boxing.cycles(50)
    assert boxing.box.arm.controller.compliance is not None
    boxing.until(lambda: boxing.box.runtime_state == RuntimeState.STOPPED)
    assert boxing.box.arm.controller.compliance is None


def test_programs_are_loaded_from_their_folder_and_nowhere_else(tmp_path: Path, boxing: Boxed) -> None:
    folder = tmp_path / "programs"
    folder.mkdir()
    (folder / "say.script").write_text('def say():\n  textmsg("loaded")\nend\n')
    (folder / "old.urp").write_bytes(b"\x1f\x8b")
    (tmp_path / "outside.script").write_text(LOOP)
    box = boxing.box
    box.programs._folder = folder
    assert box.load_program("absent.script") is LoadResult.NOT_FOUND
    assert box.load_program("../outside.script") is LoadResult.NOT_FOUND
    assert box.load_program("old.urp") is LoadResult.BROKEN
    assert not box.play()
    assert box.load_program("say.script") is LoadResult.LOADED
    assert box.play()
    boxing.until(lambda: said(boxing) == ["loaded"], 2_000_000)


def test_kinematics_as_scripts_see_it_is_the_arm_s(boxing: Boxed) -> None:
    boxing.run(
        """def kin():
  p1 = get_actual_tcp_pose()
  q = get_inverse_kin(p1)
  p2 = get_forward_kin(q)
  write_output_float_register(0, point_dist(p1, p2))
  write_output_float_register(1, norm(q - get_actual_joint_positions()))
  write_output_boolean_register(64, get_inverse_kin_has_solution(p[2,0,0,0,0,0]))
  write_output_boolean_register(65, get_inverse_kin_has_solution(p1))
end
"""
    )
    registers = boxing.box.registers
    assert registers.output_double[0] < 1e-9
    assert registers.output_double[1] < 1e-6
    assert registers.output_bit[64:66] == [False, True]


def test_unreachable_kinematics_stop_the_program(boxing: Boxed) -> None:
    boxing.run("def far():\n  q = get_inverse_kin(p[2,0,0,0,0,0])\nend\n")
    (error,) = events(boxing, RuntimeException)
    assert isinstance(error, RuntimeException)
    assert "no solution" in error.text


def test_a_path_with_blends_passes_its_corners_without_a_stop(boxing: Boxed) -> None:
    box = boxing.box
    boxing.start(
        """def path():
  p0 = get_actual_tcp_pose()
  movel(pose_add(p0, p[0.05, 0, 0, 0, 0, 0]), a=1, v=0.2, r=0.01)
  movel(pose_add(p0, p[0.05, 0.05, 0, 0, 0, 0]), a=1, v=0.2, r=0.01)
  movel(pose_add(p0, p[0, 0.05, 0, 0, 0, 0]), a=1, v=0.2)
end
"""
    )
    start = box.arm.getActualTCPPose()
    speeds = []
    while box.runtime_state == RuntimeState.PLAYING:
        box.cycle()
        speeds.append(math.hypot(*box.arm.getTargetTCPSpeed()[:3]))
    end = box.arm.getActualTCPPose()
    assert [b - a for a, b in zip(start, end, strict=True)][:3] == pytest.approx([0, 0.05, 0], abs=1e-4)
    inside = speeds[60:-60]
    assert min(inside) > 0.02


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.sampled_from(
            ["estop press", "estop release", "safeguard open", "safeguard close", "power off", "power on",
             "power run", "unlock", "play", "pause", "stop", "start", "cycles", "protect"]
        ),
        max_size=15,
    )
)  # fmt: skip
def test_whatever_happens_the_arm_moves_only_where_it_may(steps: list[str]) -> None:
    with boxed() as boxing:
        box = boxing.box
        for step in [*steps, "cycles"]:
            if step == "start":
                boxing.start(SWING)
            elif step == "protect":
                box.arm.protective_stop("tested")
            elif step != "cycles":
                panel.operate(box, step)
            stopped_for = 0
            for _ in range(150 if step == "cycles" else 3):
                box.cycle()
                may = box.safety_mode == SafetyMode.NORMAL and box.robot_mode == RobotMode.RUNNING
                stopped_for = 0 if may and box.runtime_state != RuntimeState.PAUSED else stopped_for + 1
                if stopped_for > 120:  # longer than braking from full speed takes
                    assert box.arm.getTargetQd() == [0.0] * 6
                if box.robot_mode == RobotMode.POWER_OFF:
                    assert box.arm.getTargetQd() == [0.0] * 6


@pytest.mark.parametrize(
    "line",
    ["fly", "estop", "estop perhaps", "input 18 on", "input x on", "analog 7 1", "push 1 2", "push nan 0 0",
     "push 1e9 0 0", "speed", "speed fast", "quit now", "power up"],
)  # fmt: skip
def test_the_panel_refuses_what_it_does_not_know(boxing: Boxed, line: str) -> None:
    with pytest.raises(InputError):
        panel.operate(boxing.box, line)


def test_the_panel_works_inputs_and_pushes(boxing: Boxed) -> None:
    box = boxing.box
    for line in ("input 3 on", "input 17 on", "input 3 off", "analog 0 12", "analog 2 5", "speed 30", "push 0 0 -20"):
        assert panel.operate(box, line)
    assert box.wiring.digital_in == 1 << 17
    assert box.wiring.analog_in[0] == pytest.approx(0.012)
    assert box.wiring.tool_analog_in[0] == 5.0
    assert box.speed_slider == pytest.approx(0.3)
    boxing.cycles(100)
    assert box.arm.getActualTCPForce()[2] == pytest.approx(-20.0, abs=4.0)
    assert panel.operate(box, "") == ""
    assert "estop" in panel.operate(box, "help")
