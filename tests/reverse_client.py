"""A program that calls its client back over three sockets and is led by it, as UR's own drivers do it, and the client.

`orders` bring what to do now, and how long to wait for the next one; `path` brings points to run through; `settings`
bring what is done once. Positions, speeds and times are sent in millionths.
"""

from __future__ import annotations

import re
import socket
import struct
from collections.abc import Sequence

from robots import PATIENCE, Robot

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.workcell import Workcell

STAY, SERVO, SPEED_J, SPEED_L, PATH, FREE, END = range(7)
MOVE_J, MOVE_L, MOVE_P, MOVE_C, OPTIMOVE_J, OPTIMOVE_L, SPLINE = range(7)
ZERO, PAYLOAD, TCP, FORCE, NO_FORCE, FEEL, SHOW = range(7)
DONE, CANCELLED, STARVED = range(3)
HOME = list(Workcell().home)  # [rad]
MICRO = 1e6

PROGRAM = """
def led():
  global task = 0
  global goal = get_target_joint_positions()
  global fresh = False
  global rate = [0, 0, 0, 0, 0, 0]
  global to_come = 0
  global feeling = False
  global mover = 0
  def six(raw, first):
    return [raw[first], raw[first + 1], raw[first + 2], raw[first + 3], raw[first + 4], raw[first + 5]] / 1000000
  end
  def pose_of(v):
    return p[v[0], v[1], v[2], v[3], v[4], v[5]]
  end
  thread servo():
    while task == 1:
      enter_critical
      if not fresh:
        goal = goal + get_target_joint_speeds() * get_steptime()
      end
      fresh = False
      servoj(goal, t=get_steptime(), lookahead_time=0.03, gain=1000)
      exit_critical
    end
    stopj(8)
  end
  thread joint_rates():
    while task == 2:
      speedj(rate, 10, get_steptime())
    end
    stopj(8)
  end
  thread twist():
    while task == 3:
      speedl(rate, 5, get_steptime())
    end
    stopj(8)
  end
  def spline(q_end, qd_end, time, qd_begin):
    local q_begin = get_target_joint_positions()
    local c2 = (3 * (q_end - q_begin) - time * (2 * qd_begin + qd_end)) / pow(time, 2)
    local c3 = (2 * (q_begin - q_end) + time * (qd_begin + qd_end)) / pow(time, 3)
    local gone = 0.0
    while gone < time - get_steptime() / 2:
      gone = gone + get_steptime()
      speedj(qd_begin + 2 * gone * c2 + 3 * pow(gone, 2) * c3, 40, get_steptime())
    end
  end
  thread along_path():
    local outcome = 0
    local qd = [0, 0, 0, 0, 0, 0]
    enter_critical
    while to_come > 0 and outcome == 0:
      local raw = socket_read_binary_integer(16, "path", 0.3)
      to_come = to_come - 1
      if raw[0] < 16:
        outcome = 2
      else:
        local kind = raw[1]
        local q = six(raw, 2)
        local other = six(raw, 8)
        local a = raw[14] / 1000000
        local v = raw[15] / 1000000
        local last = raw[16] / 1000000
        if kind == 0:
          movej(q, a=a, v=v, r=last)
        elif kind == 1:
          movel(pose_of(q), a=a, v=v, r=last)
        elif kind == 2:
          movep(pose_of(q), a=a, v=v, r=last)
        elif kind == 3:
          movec(pose_of(other), pose_of(q), a, v, last, 0)
        elif kind == 4:
          optimovej(q, a=a, v=v, r=last)
        elif kind == 5:
          optimovel(pose_of(q), a=a, v=v, r=last)
        else:
          spline(q, other, last, qd)
          qd = other
        end
      end
    end
    exit_critical
    stopj(8)
    socket_send_int(outcome, "path")
  end
  def drop_path():
    kill mover
    stopj(8)
    while to_come > 0:
      raw = socket_read_binary_integer(16, "path", 0.02)
      to_come = to_come - 1
    end
    socket_send_int(1, "path")
  end
  thread settings():
    while True:
      raw = socket_read_binary_integer(19, "settings", 0)
      if raw[0] == 19:
        first = six(raw, 2)
        if raw[1] == 0:
          zero_ftsensor()
        elif raw[1] == 1:
          set_payload(first[0], [first[1], first[2], first[3]])
        elif raw[1] == 2:
          set_tcp(pose_of(first))
        elif raw[1] == 3:
          force_mode_set_damping(0.1)
          force_mode_set_gain_scaling(0.8)
          force_mode(p[0, 0, 0, 0, 0, 0], first, six(raw, 8), 2, six(raw, 14))
        elif raw[1] == 4:
          end_force_mode()
        elif raw[1] == 5:
          feeling = True
        else:
          popup(str_cat("value ", first), title="Settings", warning=True, blocking=False)
        end
      end
    end
  end
  def feel():
    local back = tool_contact(direction=get_actual_tcp_speed())
    if back > 0:
      kill mover
      feeling = False
      task = 0
      stopl(3)
      movel(get_actual_joint_positions_history(back))
      socket_send_int(back, "settings")
    end
  end
  while not (socket_open("HOST", PATH_PORT, "path") and socket_open("HOST", SET_PORT, "settings")):
    sleep(0.1)
  end
  socket_open("HOST", ORDER_PORT, "orders")
  patience = 0
  one_shot = run settings()
  while task != 6:
    enter_critical
    raw = socket_read_binary_integer(8, "orders", patience)
    if raw[0] != 8:
      textmsg("no orders any more in task ", task)
      kill mover
      kill one_shot
      task = 0
      stopj(8)
      halt
    end
    patience = raw[2] / 1000
    if raw[1] != task:
      if task == 4 and to_come > 0:
        drop_path()
      elif task == 5:
        end_freedrive_mode()
      end
      task = raw[1]
      join mover
      goal = get_target_joint_positions()
      if task == 1:
        mover = run servo()
      elif task == 2:
        mover = run joint_rates()
      elif task == 3:
        mover = run twist()
      elif task == 4:
        to_come = raw[3]
        mover = run along_path()
      elif task == 5:
        freedrive_mode()
      end
    end
    rate = six(raw, 3)
    if task == 1:
      goal = rate
      fresh = True
    end
    if feeling:
      feel()
    end
    exit_critical
  end
  join mover
  textmsg("led to the end")
end
"""


class Client:
    """The three servers, and what is said over their connections."""

    def __init__(self, robot: Robot, program: str) -> None:
        self.robot = robot
        servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
        for word, server in zip(("ORDER_PORT", "PATH_PORT", "SET_PORT"), servers, strict=True):
            program = program.replace(word, str(server.getsockname()[1]))
        robot.look(begin_afresh)
        with socket.create_connection((robot.host, 30002)) as upload:
            upload.sendall(program.replace("HOST", "127.0.0.1").encode())
            self.links = []
            for server in servers:
                server.settimeout(PATIENCE)
                self.links.append(server.accept()[0])
                self.links[-1].settimeout(PATIENCE)
                server.close()
        self.orders, self.path, self.settings = self.links

    def order(self, task: int, values: Sequence[float] = (0.0,) * 6, patience: int = 0) -> None:
        self.orders.sendall(struct.pack(">8i", task, patience, *(round(value * MICRO) for value in values)))

    def run_path(self, *points: tuple[int, Sequence[float], float, float, float], promised: int = 0) -> None:
        """Points as (kind, target, acceleration, speed, blend radius or time)."""
        self.orders.sendall(struct.pack(">8i", PATH, 0, promised or len(points), 0, 0, 0, 0, 0))
        for kind, target, *rest in points:
            both = [*target, *([0.0] * (12 - len(target)))]
            self.path.sendall(struct.pack(">16i", kind, *(round(value * MICRO) for value in (*both, *rest))))

    def set(self, kind: int, *values: float) -> None:
        padded = [*values, *([0.0] * (18 - len(values)))]
        self.settings.sendall(struct.pack(">19i", kind, *(round(value * MICRO) for value in padded)))

    def answer(self, link: socket.socket) -> int:
        return int(struct.unpack(">i", link.recv(4))[0])

    def close(self) -> None:
        for link in self.links:
            link.close()


def begin_afresh(box: ControlBox) -> None:
    """Nothing of the test before is left; the arm is told to be at home."""
    box.stop()
    box.close_popup()
    box.set_speed_slider(1.0)
    box.arm.scene.push([0.0] * 6)
    box.arm.setTcp([0.0] * 6)
    box.arm.moveJ(HOME, 3.0, 10.0)


def push(box: ControlBox, wrench: list[float]) -> None:
    """A hand's wrench (6,) on the gripper, in base_link."""
    box.arm.scene.push(wrench)


def angles(box: ControlBox) -> list[float]:
    return box.arm.getTargetQ()


def speeds(box: ControlBox) -> list[float]:
    return box.arm.getTargetQd()


def pose(box: ControlBox) -> list[float]:
    """Of the TCP, in UR's base."""
    return box.arm.getTargetTCPPose()


def twist(box: ControlBox) -> list[float]:
    return box.arm.getTargetTCPSpeed()


def is_at(box: ControlBox, q: list[float]) -> bool:
    return max(abs(a - b) for a, b in zip(angles(box), q, strict=True)) < 1e-3


def rises(box: ControlBox, speed: float) -> bool:
    return abs(twist(box)[2] - speed) < 1e-3


def turns(box: ControlBox, joint: int, speed: float) -> bool:
    return abs(speeds(box)[joint] - speed) < 1e-3


def stands(box: ControlBox) -> bool:
    return box.arm.controller.idle and not any(speeds(box))


def rests(box: ControlBox, playing: bool) -> bool:
    return stands(box) and (box.runtime_state.name == "PLAYING") is playing


def displaced(box: ControlBox, axis: int, start: float, least: float) -> bool:
    return abs(pose(box)[axis] - start) > least


def belief(box: ControlBox) -> tuple[object, ...]:
    """What the program has told the arm: mass, its centre, TCP."""
    return box.arm.payload[0], list(box.arm.payload[1]), list(box.arm.tcp_offset)


def believes(box: ControlBox, *wanted: object) -> bool:
    return belief(box) == wanted


def complies(box: ControlBox, wanted: bool) -> bool:
    return (box.arm.controller.compliance is not None) is wanted


def feels(box: ControlBox, least: float) -> bool:
    return box.arm.getActualTCPForce()[2] > least


def now(box: ControlBox) -> float:
    return box.time


def shown(box: ControlBox) -> tuple[str, str, str, bool] | None:
    popup = box.popup
    return None if popup is None else (popup.title, popup.text, popup.kind, popup.blocking)


def said(box: ControlBox, text: str) -> bool:
    return any(text in line for line in box.programs.spoken)


def moved(base: Sequence[float], *changes: float) -> list[float]:
    """The first values of a list changed."""
    return [a + b for a, b in zip(base, [*changes, *([0.0] * (len(base) - len(changes)))], strict=True)]


def filled_in(text: str, version: tuple[int, int, int]) -> str:
    """UR's template with its conditions decided for a PolyScope version, and its placeholders filled in."""
    lines: list[str] = []
    open_branches: list[tuple[bool, bool]] = []  # whether this branch counts, whether one of its row has
    compare = {"<": int.__lt__, "<=": int.__le__, ">": int.__gt__, ">=": int.__ge__, "==": int.__eq__}
    ours = version[0] * 10**6 + version[1] * 10**3 + version[2]
    for line in text.splitlines():
        tag = re.match(r"\s*{%\s*(\w+)(?:\s+\w+\s*([<>=]+)\s*v(\d+)\.(\d+)\.(\d+))?\s*%}", line)
        if tag is None:
            lines.append(line if all(counts for counts, _ in open_branches) else "")
            continue
        lines.append("")
        word, sign, *numbers = tag.groups()
        if word == "endif":
            open_branches.pop()
            continue
        taken = open_branches.pop()[1] if word in ("elif", "else") else False
        holds = True
        if sign:
            major, minor, bugfix = map(int, numbers)
            holds = compare[sign](ours, major * 10**6 + minor * 10**3 + bugfix)
        open_branches.append((holds and not taken, holds or taken))
    filled = "\n".join(lines)
    for name, value in (
        ("BEGIN_REPLACE", ""),
        ("JOINT_STATE_REPLACE", "1000000"),
        ("TIME_REPLACE", "1000000"),
        ("SERVO_J_REPLACE", "lookahead_time=0.03, gain=2000"),
        ("SERVER_IP_REPLACE", "HOST"),
        ("TRAJECTORY_SERVER_PORT_REPLACE", "PATH_PORT"),
        ("SCRIPT_COMMAND_SERVER_PORT_REPLACE", "SET_PORT"),
        ("SERVER_PORT_REPLACE", "ORDER_PORT"),
    ):
        filled = filled.replace("{{" + name + "}}", value)
    return f"def external():\n{filled}\nend\n"
