"""The UR3e as URDF (for Pinocchio and viewers) and as MJCF (for MuJoCo), from the same numbers and the same shapes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.ur3e.parameters import GRIPPER, JOINTS, Triple

COLOURS: dict[str, tuple[float, float, float, float]] = {
    "shell": (0.80, 0.81, 0.82, 1.0),
    "tube": (0.71, 0.72, 0.74, 1.0),
    "collar": (0.24, 0.25, 0.27, 1.0),
    "cap": (0.40, 0.65, 0.82, 1.0),
    "steel": (0.60, 0.61, 0.63, 1.0),
}


@dataclass(frozen=True)
class Rod:
    """A cylinder between two points, link frame [m]."""

    start: Triple
    end: Triple
    radius: float  # [m]
    colour: str


@dataclass(frozen=True)
class Block:
    """An upright box, link frame [m]."""

    centre: Triple
    size: Triple
    colour: str


def _along(axis: int, start: float, end: float, radius: float, colour: str, *, at: Triple = (0.0, 0.0, 0.0)) -> Rod:
    """A rod parallel to axis 0, 1 or 2 through `at`."""
    first, last = list(at), list(at)
    first[axis], last[axis] = start, end
    return Rod((first[0], first[1], first[2]), (last[0], last[1], last[2]), radius, colour)


_X, _Y, _Z = 0, 1, 2
_ELBOW = (-0.24355, 0.0, 0.0)  # [m] end of the upper arm
_WRIST = (-0.2132, 0.0, 0.0)  # [m] end of the forearm

# Caps reach past the cylinders that cross them, or they would not show.
SHAPES: dict[str, tuple[Rod | Block, ...]] = {
    "base_link_inertia": (_along(_Z, 0.0, 0.012, 0.064, "collar"), _along(_Z, 0.012, 0.098, 0.058, "shell")),
    "shoulder_link": (
        _along(_Z, -0.052, 0.0555, 0.058, "shell"),
        _along(_Z, 0.0555, 0.0625, 0.054, "cap"),
        _along(_Y, 0.0, -0.068, 0.0575, "shell"),
    ),
    "upper_arm_link": (
        _along(_Z, 0.070, 0.168, 0.0575, "shell"),
        _along(_Z, 0.168, 0.175, 0.0535, "cap"),
        _along(_X, -0.045, -0.200, 0.0395, "tube", at=(0.0, 0.0, 0.120)),
        _along(_X, -0.045, -0.060, 0.0425, "collar", at=(0.0, 0.0, 0.120)),
        _along(_X, -0.188, -0.203, 0.0425, "collar", at=(0.0, 0.0, 0.120)),
        _along(_Z, 0.066, 0.155, 0.0485, "shell", at=_ELBOW),
        _along(_Z, 0.155, 0.161, 0.0455, "cap", at=_ELBOW),
    ),
    "forearm_link": (
        _along(_Z, -0.018, 0.064, 0.0485, "shell"),
        _along(_Z, -0.018, -0.024, 0.0455, "cap"),
        _along(_X, -0.040, -0.180, 0.0325, "tube", at=(0.0, 0.0, 0.027)),
        _along(_X, -0.040, -0.052, 0.0355, "collar", at=(0.0, 0.0, 0.027)),
        _along(_X, -0.168, -0.180, 0.0355, "collar", at=(0.0, 0.0, 0.027)),
        _along(_Z, -0.010, 0.088, 0.0375, "shell", at=_WRIST),
        _along(_Z, -0.010, -0.016, 0.0350, "cap", at=_WRIST),
    ),
    "wrist_1_link": (
        _along(_Z, -0.043, 0.030, 0.0375, "shell"),
        _along(_Y, 0.036, -0.044, 0.0375, "shell"),
        _along(_Y, 0.036, 0.042, 0.0350, "cap"),
    ),
    "wrist_2_link": (
        _along(_Z, -0.042, 0.036, 0.0375, "shell"),
        _along(_Y, -0.030, 0.050, 0.0375, "shell"),
        _along(_Z, 0.036, 0.042, 0.0350, "cap"),
    ),
    "wrist_3_link": (_along(_Z, -0.042, -0.006, 0.0375, "collar"), _along(_Z, -0.006, 0.0, 0.0315, "steel")),
    "gripper": (
        _along(_Z, 0.0, 0.014, 0.0375, "collar"),
        Block((0.0, 0.0, 0.048), (0.060, 0.074, 0.068), "collar"),
        Block((0.0302, 0.0, 0.048), (0.0008, 0.040, 0.024), "cap"),
        Block((0.0, 0.0, 0.085), (0.026, 0.076, 0.008), "steel"),
    ),
}


def numbers(values: Sequence[float]) -> str:
    """Values as XML attributes hold them, exact to the last bit."""
    return " ".join(repr(float(value)) for value in values)


def quaternion_of_rpy(rpy: Triple) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of URDF's fixed-axis roll, pitch, yaw [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in rpy)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _urdf_visual(shape: Rod | Block) -> str:
    red, green, blue, alpha = COLOURS[shape.colour]
    if isinstance(shape, Block):
        centre, rpy = shape.centre, (0.0, 0.0, 0.0)
        geometry = f'<box size="{numbers(shape.size)}"/>'
    else:
        span = [end - start for start, end in zip(shape.start, shape.end, strict=True)]
        x, y, z = ((start + end) / 2 for start, end in zip(shape.start, shape.end, strict=True))
        centre = (x, y, z)
        rpy = (math.pi / 2 if span[1] else 0.0, math.pi / 2 if span[0] else 0.0, 0.0)
        geometry = f'<cylinder radius="{shape.radius!r}" length="{math.hypot(*span)!r}"/>'
    return (
        f'<visual><origin xyz="{numbers(centre)}" rpy="{numbers(rpy)}"/><geometry>{geometry}</geometry>'
        f'<material name="{shape.colour}"><color rgba="{red} {green} {blue} {alpha}"/></material></visual>'
    )


def _urdf_link(name: str, inertial: str = "") -> str:
    return f'<link name="{name}">{inertial}{"".join(_urdf_visual(shape) for shape in SHAPES.get(name, ()))}</link>'


def _urdf_inertial(mass: float, centre: Triple, rpy: Triple, inertia: Triple) -> str:
    return (
        f'<inertial><mass value="{mass!r}"/><origin xyz="{numbers(centre)}" rpy="{numbers(rpy)}"/>'
        f'<inertia ixx="{inertia[0]!r}" ixy="0" ixz="0" iyy="{inertia[1]!r}" iyz="0" izz="{inertia[2]!r}"/></inertial>'
    )


def _urdf_fixed(parent: str, child: str, rpy: Triple = (0.0, 0.0, 0.0)) -> str:
    return (
        f'<joint name="{parent}-{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0" rpy="{numbers(rpy)}"/></joint>'
    )


def urdf() -> str:
    """The robot with its gripper as URDF text; link and joint names are those of UR's ROS 2 driver."""
    half = math.pi / 2
    parts = [
        _urdf_link("base_link"),
        _urdf_link("base_link_inertia"),
        _urdf_fixed("base_link", "base_link_inertia", (0.0, 0.0, math.pi)),
    ]
    parent = "base_link_inertia"
    for joint in JOINTS:
        inertial = _urdf_inertial(joint.mass, joint.centre_of_mass, joint.inertia_rpy, joint.inertia)
        parts.append(_urdf_link(joint.link, inertial))
        parts.append(
            f'<joint name="{joint.name}" type="revolute"><parent link="{parent}"/><child link="{joint.link}"/>'
            f'<origin xyz="{numbers(joint.origin)}" rpy="{numbers(joint.rpy)}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{-joint.reach!r}" upper="{joint.reach!r}" effort="{joint.effort!r}"'
            f' velocity="{joint.speed!r}"/></joint>'
        )
        parent = joint.link
    gripper = _urdf_inertial(GRIPPER.mass, GRIPPER.centre_of_mass, (0.0, 0.0, 0.0), GRIPPER.inertia)
    parts += [
        _urdf_link("flange"),
        _urdf_fixed("wrist_3_link", "flange", (0.0, -half, -half)),
        _urdf_link("tool0"),
        _urdf_fixed("flange", "tool0", (half, 0.0, half)),
        _urdf_link("gripper", gripper),
        _urdf_fixed("tool0", "gripper"),
    ]
    return '<robot name="ur3e">' + "".join(parts) + "</robot>"


def _mjcf_geom(shape: Rod | Block) -> str:
    if isinstance(shape, Block):
        half = [size / 2 for size in shape.size]
        place = f'type="box" pos="{numbers(shape.centre)}" size="{numbers(half)}"'
    else:
        place = f'type="cylinder" fromto="{numbers((*shape.start, *shape.end))}" size="{shape.radius!r}"'
    return f'<geom {place} material="{shape.colour}" contype="0" conaffinity="0" mass="0" group="1"/>'


def _mjcf_geoms(link: str, visual: bool) -> str:
    return "".join(_mjcf_geom(shape) for shape in SHAPES[link]) if visual else ""


def mjcf_materials() -> str:
    """The shapes' colours as MJCF assets."""
    return "".join(
        f'<material name="{name}" rgba="{numbers(rgba)}" specular="0.5" shininess="0.5"/>'
        for name, rgba in COLOURS.items()
    )


def mjcf_arm(tool: str = "", *, visual: bool = True) -> str:
    """The arm as nested MJCF bodies, standing at the world's origin; `tool` is put into the gripper's body.

    The force-torque sensor's site `ft` is at the flange. Gravity is balanced (`gravcomp`), as a controller does that
    knows the arm and its payload. Links do not collide: contact is between pins and board.
    """
    inner = (
        f'<body name="gripper" gravcomp="1"><inertial mass="{GRIPPER.mass!r}" pos="{numbers(GRIPPER.centre_of_mass)}"'
        f' diaginertia="{numbers(GRIPPER.inertia)}"/><site name="ft" size="0.001" rgba="0 0 0 0"/>'
        + _mjcf_geoms("gripper", visual)
        + f"{tool}</body>"
    )
    for joint in reversed(JOINTS):
        inner = (
            f'<body name="{joint.link}" pos="{numbers(joint.origin)}"'
            f' quat="{numbers(quaternion_of_rpy(joint.rpy))}" gravcomp="1">'
            f'<inertial mass="{joint.mass!r}" pos="{numbers(joint.centre_of_mass)}"'
            f' quat="{numbers(quaternion_of_rpy(joint.inertia_rpy))}" diaginertia="{numbers(joint.inertia)}"/>'
            f'<joint name="{joint.name}" axis="0 0 1" range="{-joint.reach!r} {joint.reach!r}"'
            f' armature="{joint.armature!r}" damping="{joint.damping!r}"'
            f' actuatorfrcrange="{-joint.effort!r} {joint.effort!r}"/>'
            + _mjcf_geoms(joint.link, visual)
            + f"{inner}</body>"
        )
    base = _mjcf_geoms("base_link_inertia", visual)
    turn = numbers(quaternion_of_rpy((0.0, 0.0, math.pi)))
    return f'<body name="base_link_inertia" quat="{turn}">{base}{inner}</body>'


def mjcf_actuators() -> str:
    """One servo per joint, each with two controls: position [rad], speed [rad/s]."""
    return "".join(
        f'<pid name="{joint.name}" joint="{joint.name}" kp="{joint.stiffness!r}" kv="{joint.servo_damping!r}"/>'
        for joint in JOINTS
    )
