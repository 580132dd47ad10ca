"""The simulated cell in MuJoCo: arm, gripper, board, feeder, bin, and the one part that is being handled.

Contact is between pins and holes and nothing else. Each round hole is a ring of 16 boxes, whose polygon has the area of
the circle. Only the holes of the current search exist for contact: one movable body carries them, and is put where the
true holes are. All other holes, and the parts already inserted, are there to be seen.

The contact set was chosen by measuring where pegs stop going in: the boundary's bias is the descent speed times
solref's time constant, hence the short one. The board rides on a stiff spring with half a kilogram, which is what a
carrier weighs; a lighter one loses contact within one step and lets blocked pins through. One contact for each pair of
pin and box is enough: several (multiccd) move the boundary by under 3 um and double the time of a blocked contact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from drivers.ur3e.frames import Quaternion, Vector
from drivers.ur3e.parameters import CYCLE, GRIPPER, JOINTS
from drivers.ur3e.robot_model import mjcf_actuators, mjcf_arm, mjcf_materials, numbers
from drivers.ur3e.workcell import Workcell
from runtime.cell import Board
from runtime.component import Component, Pin

Fidelity = Literal["reference", "fast"]


@dataclass(frozen=True)
class _Solver:
    integrator: str
    step: float  # [s]


# The fast set moves the go/no-go boundary by up to about 10 um.
_SOLVERS: dict[str, _Solver] = {
    "reference": _Solver("implicitfast", 0.001),
    "fast": _Solver("discrete", 0.002),
}

_SIDES = 16  # of a hole's ring and of a round lead
_RIM = 0.5e-3  # [m] least thickness of the ring's boxes
_PATCH = (0.020, 0.015)  # [m] half extent of the board's part that can be touched
_PLUG = 0.2e-3  # [m] half the thickness of what can close the holes
_AWAY = (0.0, 0.0, -1.0)  # [m] where nothing is touched
_MARGIN = 0.020  # [m] of board around the outermost holes
_BOARD_MASS = 0.5  # [kg] of the carrier
_BOARD_STIFFNESS = 1e5  # [N/m]
_BOARD_DAMPING_RATIO = 0.3
_PIN_ARMATURE = 0.05  # [kg] keeps the contact stiff, which MuJoCo scales with the mass
_PIN_MASS = 1e-4  # [kg] of the pins' body; the part has the rest
_FRICTION = 0.2
# Lateral stiffness [N/m] of the pins along the component's x and y: bending of the leads and give of the fingers.
_PIN_STIFFNESS = {"igbt": (27e3, 7e3), "capacitor": (14e3, 14e3)}
_PIN_STIFFNESS_OTHERWISE = (14e3, 14e3)

_DEFAULTS = f"""
<default>
  <default class="seen"><geom contype="0" conaffinity="0" mass="0" group="1"/></default>
  <default class="hole"><geom type="box" contype="0" conaffinity="1" group="3" condim="3"
    friction="{_FRICTION} 0.005 0.0001" solref="0.002 1" solimp="0.95 0.99 0.00001"/></default>
  <default class="pin"><geom contype="1" conaffinity="0" group="3" condim="3" mass="0"
    friction="{_FRICTION} 0.005 0.0001" solref="0.002 1" solimp="0.95 0.99 0.00001"/></default>
</default>"""


def _geom(kind: str, pos: tuple[float, ...], size: tuple[float, ...], rgba: str, name: str = "") -> str:
    label = f'name="{name}" ' if name else ""
    return (
        f'<geom {label}class="seen" type="{kind}" pos="{numbers(pos)}" size="{numbers(size)}" '
        + (f'rgba="{rgba}"' if rgba[0].isdigit() else f'material="{rgba}"')
        + "/>"
    )


def _hole_box(x: float, y: float, half: tuple[float, float], thickness: float, angle: float = 0.0) -> str:
    quat = (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))
    return (
        f'<geom class="hole" pos="{numbers((x, y, -thickness / 2))}" size="{numbers((*half, thickness / 2))}" '
        f'quat="{numbers(quat)}"/>'
    )


def hole_geoms(component: Component, thickness: float) -> str:
    """The touchable patch of board: a ring of boxes for each hole of the pattern, and plates between the rings."""
    apothem = component.hole_radius * math.sqrt(math.pi / _SIDES / math.tan(math.pi / _SIDES))
    outer = max(apothem + _RIM, 1.5 * component.hole_radius)
    centres = [(x, -y) for x, y in component.holes]  # a component's y is the board's -y, since its z points down
    half_ring = ((outer - apothem) / 2, outer * math.tan(math.pi / _SIDES))
    boxes = []
    for x, y in centres:
        for index in range(_SIDES):
            angle = 2 * math.pi * index / _SIDES
            middle = (outer + apothem) / 2
            at = (x + middle * math.cos(angle), y + middle * math.sin(angle))
            boxes.append(_hole_box(*at, half_ring, thickness, angle))
    for x0, x1, y0, y1 in _plates(centres, outer / math.sqrt(2)):
        boxes.append(_hole_box((x0 + x1) / 2, (y0 + y1) / 2, ((x1 - x0) / 2, (y1 - y0) / 2), thickness))
    return "".join(boxes)


def _plates(centres: list[tuple[float, float]], half: float) -> list[tuple[float, float, float, float]]:
    """Rectangles (x0, x1, y0, y1) that cover the patch except for a square around each centre."""
    width, height = _PATCH
    plates = []
    y = -height
    for row in sorted({centre[1] for centre in centres}):
        plates.append((-width, width, y, row - half))
        x = -width
        for centre_x in sorted(centre[0] for centre in centres if centre[1] == row):
            plates.append((x, centre_x - half, row - half, row + half))
            x = centre_x + half
        plates.append((x, width, row - half, row + half))
        y = row + half
    plates.append((-width, width, y, height))
    return [plate for plate in plates if plate[1] - plate[0] > 1e-9 and plate[3] - plate[2] > 1e-9]


def _pin_outline(pin: Pin, inset: float) -> list[tuple[float, float]]:
    if not pin.round:
        half_x, half_y = pin.half_x - inset, pin.half_y - inset
        return [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
    step = 2 * math.pi / _SIDES
    radius = pin.half_x / math.sqrt(math.sin(step) / step) - inset  # the polygon has the lead's area
    return [(radius * math.cos(index * step), radius * math.sin(index * step)) for index in range(_SIDES)]


def _pin_mesh(pin: Pin, name: str) -> str:
    levels = ((-pin.length, 0.0), (-pin.chamfer_length, 0.0), (0.0, pin.chamfer))
    vertices = [(x, y, z) for z, inset in levels for x, y in _pin_outline(pin, inset)]
    return f'<mesh name="{name}" vertex="{numbers([value for vertex in vertices for value in vertex])}"/>'


def _part_look(component: Component, prefix: str = "") -> str:
    """Body and pins as they look, component frame."""
    body, (x, y, z) = component.body, component.body.size
    middle = (0.0, 0.0, -body.standoff - z / 2)
    if body.shape == "box":
        geoms = [
            _geom("box", middle, (x / 2, y / 2, z / 2), "0.10 0.10 0.11 1"),
            _geom("box", (0.0, -y / 2, middle[2] - 0.001), (x * 0.44, 0.0004, z * 0.42), "0.74 0.75 0.77 1"),
        ]
    else:
        geoms = [
            _geom("cylinder", middle, (x / 2, z / 2), "0.10 0.13 0.32 1"),
            _geom("cylinder", (0.0, 0.0, -body.standoff - z - 0.0001), (x * 0.46, 0.0002), "0.80 0.80 0.82 1"),
            _geom("box", (0.0, x * 0.46, middle[2]), (x * 0.12, x * 0.05, z * 0.49), "0.72 0.74 0.80 1"),
        ]
    for index, pin in enumerate(component.pins):
        place = numbers((pin.x, pin.y, 0.0))
        geoms.append(f'<geom class="seen" type="mesh" mesh="pin{index}" pos="{place}" rgba="0.82 0.82 0.84 1"/>')
    return "".join(geom.replace("<geom ", f'<geom name="{prefix}{index}" ', 1) for index, geom in enumerate(geoms))


def _board_look(board: Board, component: Component) -> str:
    xs, ys = [hole.x for hole in board.holes], [hole.y for hole in board.holes]
    centre = (board.x + (max(xs) + min(xs)) / 2, board.y + (max(ys) + min(ys)) / 2)
    half = ((max(xs) - min(xs)) / 2 + _MARGIN, (max(ys) - min(ys)) / 2 + _MARGIN)
    top = board.z - 2e-5  # the pads lie on it
    under = (board.z - board.thickness) / 2
    pieces = [
        _geom("box", (*centre, top - board.thickness / 2), (*half, board.thickness / 2), "pcb"),
        _geom("box", (*centre, under), (half[0] + 0.012, half[1] + 0.012, under - 0.0002), "0.30 0.31 0.34 1"),
    ]
    for i in (-1, 1):
        for j in (-1, 1):
            corner = (centre[0] + i * (half[0] - 0.004), centre[1] + j * (half[1] - 0.004), board.z)
            pieces.append(_geom("cylinder", corner, (0.0032, 2e-5), "0.75 0.76 0.78 1"))
            pieces.append(_geom("cylinder", corner, (0.0018, 4e-5), "0.04 0.04 0.04 1"))
    outline = (component.body.size[0] / 2 + 0.8e-3, component.body.size[1] / 2 + 0.8e-3)
    for hole in board.holes:
        yaw = hole.orientation or 0.0
        c, s = math.cos(yaw), math.sin(yaw)
        middle = (board.x + hole.x, board.y + hole.y)
        turn = f'quat="{numbers((math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))}"'
        ink = _geom("box", (*middle, board.z - 1.5e-5), (*outline, 1e-5), "0.88 0.90 0.86 1")
        inside = (outline[0] - 0.25e-3, outline[1] - 0.25e-3, 1e-5)
        ground = _geom("box", (*middle, board.z - 0.5e-5), inside, "pcb")
        pieces += [ink.replace("<geom ", f"<geom {turn} "), ground.replace("<geom ", f"<geom {turn} ")]
        for x, y in component.holes:
            at = (middle[0] + c * x + s * y, middle[1] + s * x - c * y)
            pieces.append(
                _geom("cylinder", (*at, board.z + 1e-5), (component.hole_radius + 0.45e-3, 2e-5), "0.86 0.70 0.32 1")
            )
            pieces.append(_geom("cylinder", (*at, board.z + 3e-5), (component.hole_radius, 2e-5), "0.03 0.03 0.03 1"))
    return "".join(pieces)


def _stations_look(workcell: Workcell, component: Component) -> str:
    x, y, z = workcell.feeder_x, workcell.feeder_y, workcell.feeder_z
    nest = z + component.pins[0].length * 0.4  # the pins stand in the nest
    wide = component.body.size[0] / 2 + 0.004
    pieces = [
        _geom("box", (x, y, nest / 2), (0.030, 0.045, nest / 2), "0.36 0.38 0.42 1"),
        _geom("box", (x, y, nest + 0.001), (wide, 0.006, 0.001), "0.95 0.70 0.15 1"),
        _geom("box", (x, y - 0.105, z / 2), (0.020, 0.06, z / 2), "0.62 0.64 0.67 1"),
    ]
    x, y = workcell.reject_x, workcell.reject_y
    height = 0.045
    pieces.append(_geom("box", (x, y, 0.001), (0.05, 0.04, 0.001), "0.45 0.10 0.08 1"))
    for i in (-1, 1):
        pieces.append(_geom("box", (x + i * 0.05, y, height / 2), (0.0015, 0.0415, height / 2), "0.75 0.16 0.12 1"))
        pieces.append(_geom("box", (x, y + i * 0.04, height / 2), (0.0515, 0.0015, height / 2), "0.75 0.16 0.12 1"))
    return "".join(pieces)


def _tool(component: Component, tip: float, *, visual: bool) -> str:
    """Fingers, the held part and its pins, gripper frame."""
    length, width = 0.040, 0.007
    fingers = "".join(
        f'<geom name="finger{index}" class="seen" type="box" pos="0 0 {GRIPPER.reach - length / 2!r}" '
        f'size="0.007 {width / 2!r} {length / 2!r}" material="steel"/>'
        for index in range(2 if visual else 0)
    )
    look = _part_look(component, "held") if visual else ""
    pins = "".join(
        f'<geom name="touch{index}" class="pin" type="mesh" mesh="pin{index}" pos="{numbers((pin.x, pin.y, 0.0))}"/>'
        for index, pin in enumerate(component.pins)
    )
    slides = "".join(
        f'<joint name="give_{axis}" type="slide" axis="{direction}" stiffness="{stiffness!r}" '
        f'damping="{2 * math.sqrt(stiffness * _PIN_ARMATURE)!r}" armature="{_PIN_ARMATURE!r}"/>'
        for axis, direction, stiffness in zip(
            "xy", ("1 0 0", "0 1 0"), _PIN_STIFFNESS.get(component.name, _PIN_STIFFNESS_OTHERWISE), strict=True
        )
    )
    return (
        f'{fingers}<body name="part" pos="0 0 {tip!r}" gravcomp="1"><inertial mass="{component.mass - _PIN_MASS!r}" '
        f'pos="{numbers(component.centre_of_mass)}" diaginertia="5e-7 5e-7 3e-7"/>{look}'
        f'<body name="pins" gravcomp="1"><inertial mass="{_PIN_MASS!r}" pos="{numbers(component.centre_of_mass)}" '
        f'diaginertia="1e-8 1e-8 1e-8"/>{slides}{pins}<site name="tips" size="0.0005" rgba="0 0 0 0"/></body></body>'
    )


def _look(board: Board, component: Component, workcell: Workcell) -> str:
    """All that stands about to be seen: table, board, stations, a part in the feeder, parts inserted before."""
    waiting = numbers((workcell.feeder_x, workcell.feeder_y, workcell.feeder_z))
    standing = "".join(
        f'<body name="standing{index}" pos="0 0 -1">{_part_look(component, f"standing{index}_")}</body>'
        for index in range(len(board.holes))
    )
    return f"""
<light pos="0.7 -0.6 1.5" dir="-0.4 0.4 -1" diffuse="0.45 0.45 0.45" castshadow="true"/>
<light pos="-0.4 0.8 1.2" dir="0.3 -0.6 -1" diffuse="0.18 0.18 0.18" castshadow="false"/>
<body name="lookat" pos="0.14 0 0.17"/>
<camera name="iso" pos="1.0 -0.78 0.62" mode="targetbody" target="lookat" fovy="36"/>
<camera name="board" pos="{board.x + 0.17} {board.y - 0.17} {board.z + 0.13}"
  xyaxes="0.707 0.707 0 -0.33 0.33 0.88" fovy="36"/>
{_geom("box", (0.12, 0.0, -0.012), (0.42, 0.42, 0.012), "table")}{_board_look(board, component)}
{_stations_look(workcell, component)}{standing}
<body name="waiting" pos="{waiting}" quat="0 1 0 0">{_part_look(component, "waiting")}</body>"""


def scene_xml(board: Board, component: Component, workcell: Workcell, fidelity: Fidelity, *, visual: bool) -> str:
    """The cell as MJCF text, base_link at the world's origin.

    What is only to be seen costs a quarter of a step's time, so it is left out unless `visual`.
    """
    solver = _SOLVERS[fidelity]
    tip = workcell.gripper_reach + component.grip
    damping = 2 * _BOARD_DAMPING_RATIO * math.sqrt(_BOARD_STIFFNESS * _BOARD_MASS)
    meshes = "".join(_pin_mesh(pin, f"pin{index}") for index, pin in enumerate(component.pins))
    return f"""<mujoco model="palpate">
<compiler angle="radian" autolimits="true"/>
<option timestep="{solver.step}" integrator="{solver.integrator}" cone="elliptic" impratio="10" solver="Newton"
  iterations="50" tolerance="1e-8" jacobian="dense"><flag multiccd="disable"/></option>
<visual><global offwidth="1920" offheight="1440"/><quality shadowsize="4096" offsamples="8"/>
<headlight ambient="0.38 0.38 0.38" diffuse="0.28 0.28 0.28" specular="0.1 0.1 0.1"/><map znear="0.005"/></visual>
<statistic center="0.15 0 0.15" extent="0.7"/>{_DEFAULTS}
<asset>{mjcf_materials()}
<texture name="sky" type="skybox" builtin="gradient" rgb1="0.93 0.95 0.97" rgb2="0.62 0.68 0.76" width="256"
  height="256"/>
<material name="table" rgba="0.86 0.84 0.80 1" specular="0.1"/>
<material name="pcb" rgba="0.05 0.38 0.17 1" specular="0.4" shininess="0.6"/>{meshes}</asset>
<worldbody>{_look(board, component, workcell) if visual else ""}
<body name="holes" pos="{numbers((board.x, board.y, board.z))}" gravcomp="1">
<inertial mass="{_BOARD_MASS}" pos="0 0 -0.001" diaginertia="1e-4 1e-4 1e-4"/>
<joint name="board" type="slide" axis="0 0 1" stiffness="{_BOARD_STIFFNESS}" damping="{damping!r}"/>
{hole_geoms(component, board.thickness)}</body>
{mjcf_arm(_tool(component, tip, visual=visual), visual=visual)}
<body name="plug" pos="{numbers(_AWAY)}"><geom class="hole" size="{numbers((*_PATCH, _PLUG))}"/></body>
</worldbody>
<actuator>{mjcf_actuators()}</actuator>
<sensor><force name="force" site="ft"/><torque name="torque" site="ft"/></sensor>
</mujoco>"""


class Scene:
    """The cell's physics and what can be changed in it: where the holes are, what is held, what stands where."""

    def __init__(
        self,
        board: Board,
        component: Component,
        workcell: Workcell | None = None,
        fidelity: Fidelity = "reference",
        integrate: Callable[[Any, Any, int], None] | None = None,  # model, data, number of steps; MuJoCo's if none
    ) -> None:
        self.board = board
        self.component = component
        self.workcell = workcell or Workcell()
        self.fidelity = fidelity
        xml = scene_xml(board, component, self.workcell, fidelity, visual=False)
        self.model: Any = mujoco.MjModel.from_xml_string(xml)
        self.data: Any = mujoco.MjData(self.model)
        self._substeps = round(CYCLE / _SOLVERS[fidelity].step)
        self._integrate = integrate or mujoco.mj_step
        self.holding = False
        self.part_waiting = False
        self.standing: list[tuple[list[float], list[float]]] = []  # position [m], quaternion (w, x, y, z) of each part
        self._offset = (0.0, 0.0, 0.0)
        self._tip = self.workcell.gripper_reach + component.grip
        self._scratch: Any = mujoco.MjData(self.model)
        self._holes = self.model.body("holes").id
        self._plug = self.model.body("plug").id
        first_box = int(self.model.body_geomadr[self._holes])
        self._ring = slice(first_box, first_box + _SIDES * len(component.holes))
        self._ring_at = self.model.geom_pos[self._ring].copy()  # (boxes, 3) [m]
        turn = 2 * math.pi / _SIDES * np.arange(_SIDES)
        outwards = np.stack([np.cos(turn), np.sin(turn), np.zeros(_SIDES)], axis=1)
        self._outwards = np.tile(outwards, (len(component.holes), 1))  # (boxes, 3)
        self._part, self._pins = self.model.body("part").id, self.model.body("pins").id
        self._mass = {body: float(self.model.body_mass[body]) for body in (self._part, self._pins)}
        self._inertia = {body: self.model.body_inertia[body].copy() for body in (self._part, self._pins)}
        self._touch = [self.model.geom(f"touch{index}").id for index in range(len(component.pins))]
        self._give = [self.model.joint(name).id for name in ("give_x", "give_y")]
        first = int(self.model.joint(JOINTS[0].name).dofadr[0])
        self._dofs = slice(first, first + len(JOINTS))
        self._servos = (self.model.actuator_gainprm.copy(), self.model.actuator_biasprm.copy())
        self._gripper = self.model.body("gripper").id
        self._hold(False)

    def step(self) -> None:
        """Let one control cycle pass."""
        self._integrate(self.model, self.data, self._substeps)

    def drive(self, torque: Sequence[float] | None) -> None:
        """Give the joints torques (6,) [Nm] in place of their servos; None gives them back to the servos.

        Gravity is balanced either way, and so is the joints' own friction.
        """
        model, data = self.model, self.data
        if torque is None:
            model.actuator_gainprm[:], model.actuator_biasprm[:] = self._servos
            data.qfrc_applied[self._dofs] = 0.0
            return
        model.actuator_gainprm[:] = 0.0
        model.actuator_biasprm[:] = 0.0
        data.qfrc_applied[self._dofs] = torque

    def push(self, wrench: Sequence[float]) -> None:
        """Let the surroundings push at the gripper: force (3,) [N] and torque (3,) [Nm] in base_link, until changed."""
        self.data.xfrc_applied[self._gripper] = wrench

    def place_holes(self, x: float, y: float, yaw: float, wider: float = 0.0) -> None:
        """Put the hole pattern that can be touched at (x, y) [m] in base_link, turned by `yaw` [rad].

        `wider` [m] is how much the holes' radius exceeds the drawing's, at most `WIDEST_HOLE`.
        """
        self.model.geom_pos[self._ring] = self._ring_at + wider * self._outwards
        self.model.body_pos[self._holes] = (x, y, self.board.z)
        self.model.body_quat[self._holes] = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))

    def close_holes(self, depth: float | None) -> None:
        """Close the holes that can be touched at `depth` [m] below the board's top; None opens them."""
        x, y, z = self.model.body_pos[self._holes].tolist()
        self.model.body_pos[self._plug] = _AWAY if depth is None else (x, y, z - depth - _PLUG)

    def present_part(self, present: bool, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> None:
        """Put a part into the feeder, or take it away.

        Once gripped it will be off by (x, y) [m] and `yaw` [rad] in the TCP's frame: clamping and bent pins.
        """
        self.part_waiting = present
        self._offset = (x, y, yaw)

    def grasp(self) -> None:
        """Take the feeder's part into the gripper: it exists from now on.

        The grasp is kinematic, without finger contact: the part is fixed to the gripper where `present_part` said.
        """
        x, y, yaw = self._offset
        self.part_waiting = False
        self.model.body_pos[self._part] = (x, y, self._tip)
        self.model.body_quat[self._part] = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
        self._hold(True)

    def release(self) -> None:
        """Let go of the part: it ceases to exist."""
        self._hold(False)

    def leave_standing(self) -> None:
        """Let go of the part and leave it to be seen where it is."""
        self.standing.append((self.data.xpos[self._part].tolist(), self.data.xquat[self._part].tolist()))
        self._hold(False)

    def clear_board(self) -> None:
        """A fresh board: nothing stands in it."""
        self.standing.clear()

    def part_pose(self) -> tuple[Vector, Quaternion]:
        """Where the held part's pin tips are: position [m] and quaternion (x, y, z, w) in base_link."""
        w, x, y, z = self.data.xquat[self._pins].tolist()
        return tuple(self.data.xpos[self._pins].tolist()), (x, y, z, w)

    def _hold(self, holding: bool) -> None:
        self.holding = holding
        model, data = self.model, self.data
        for body in (self._part, self._pins):
            model.body_mass[body] = self._mass[body] if holding else 0.0
            model.body_inertia[body] = self._inertia[body] if holding else 0.0
        for geom in self._touch:
            model.geom_contype[geom] = 1 if holding else 0
        for joint in self._give:
            data.qpos[model.jnt_qposadr[joint]] = 0.0
            data.qvel[model.jnt_dofadr[joint]] = 0.0
        mujoco.mj_setConst(model, self._scratch)
