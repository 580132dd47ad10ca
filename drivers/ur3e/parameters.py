"""Numbers of the UR3e and its tool: the one place they are written down.

Kinematics, masses and limits are those Universal Robots publishes in its `ur_description` package (config/ur3e:
default_kinematics, physical_parameters, joint_limits). What the maker does not publish is marked *assumed*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Joint:
    """One joint with the link it moves. Lengths [m], angles [rad], masses [kg], inertia [kg m^2]."""

    name: str
    link: str
    origin: Triple  # of the joint in the link before
    rpy: Triple  # fixed-axis roll, pitch, yaw of that origin
    mass: float
    centre_of_mass: Triple
    inertia_rpy: Triple
    inertia: Triple  # principal moments in the frame turned by inertia_rpy
    effort: float  # [Nm]
    speed: float  # [rad/s]
    reach: float  # [rad] the joint turns this far either way
    armature: float  # [kg m^2] assumed: rotor inertia seen through the gear
    stiffness: float  # [Nm/rad] assumed: servo and gear together
    damping: float  # [Nm s/rad] assumed
    servo_damping: float  # [Nm s/rad] assumed: makes the servo critically damped with the inertia at mid-reach


_TURN = 2 * math.pi

JOINTS: tuple[Joint, ...] = (
    Joint(
        "shoulder_pan_joint", "shoulder_link", (0, 0, 0.15185), (0, 0, 0),
        1.98, (0, 0, -0.02), (0, 0, 0), (0.008093166666666665, 0.008093166666666665, 0.005625),
        54.0, math.pi, _TURN, 0.40, 2.0e4, 5.0, 277.8,
    ),
    Joint(
        "shoulder_lift_joint", "upper_arm_link", (0, 0, 0), (math.pi / 2, 0, 0),
        3.4445, (-0.11355, 0, 0.1157), (0, math.pi / 2, 0), (0.021728491912499998, 0.021728491912499998, 0.00961875),
        54.0, math.pi, _TURN, 0.40, 2.0e4, 5.0, 277.8,
    ),
    Joint(
        "elbow_joint", "forearm_link", (-0.24355, 0, 0), (0, 0, 0),
        1.437, (-0.1632, 0, 0.0238), (0, math.pi / 2, 0), (0.006544570199999999, 0.006544570199999999, 0.00354375),
        28.0, math.pi, math.pi, 0.20, 1.2e4, 3.0, 135.6,
    ),
    Joint(
        "wrist_1_joint", "wrist_1_link", (-0.2132, 0, 0.13105), (0, 0, 0),
        0.871, (0, -0.01, 0), (0, 0, 0), (0.0020849999999999996, 0.0020849999999999996, 0.00225),
        9.0, _TURN, _TURN, 0.10, 5.0e3, 1.0, 50.0,
    ),
    Joint(
        "wrist_2_joint", "wrist_2_link", (0, -0.08535, 0), (math.pi / 2, 0, 0),
        0.805, (0, 0.01, 0), (0, 0, 0), (0.0020849999999999996, 0.0020849999999999996, 0.00225),
        9.0, _TURN, _TURN, 0.10, 5.0e3, 1.0, 48.0,
    ),
    Joint(
        "wrist_3_joint", "wrist_3_link", (0, 0.0921, 0), (math.pi / 2, math.pi, math.pi),
        0.261, (0, 0, -0.02), (0, 0, 0), (0.00013626666666666665, 0.00013626666666666665, 0.0001792),
        9.0, _TURN, _TURN, 0.10, 5.0e3, 1.0, 46.0,
    ),
)  # fmt: skip
JOINT_NAMES = tuple(joint.name for joint in JOINTS)

GRAVITY = 9.81  # [m/s^2]
CYCLE = 0.002  # [s] an e-Series controller works at 500 Hz
CYCLE_NS = 2_000_000  # [ns]

# Defaults of URScript, from its manual.
MOVEJ_SPEED, MOVEJ_ACCELERATION = 1.05, 1.4  # [rad/s], [rad/s^2]
MOVEL_SPEED, MOVEL_ACCELERATION = 0.25, 1.2  # [m/s], [m/s^2]

# Assumed: a UR3 (CB3) halts from full speed in about 160 ms (user manual, stopping times for category 0), which is
# 20 rad/s^2; a category 2 stop under drive power is taken to be a little gentler.
HALT_DECELERATION = 20.0  # [rad/s^2] per joint, category 0
STOP_DECELERATION = 15.0  # [rad/s^2] per joint, categories 1 and 2
RESUME_TIME = 0.25  # [s] assumed: from standstill to full speed scaling once a stop is over


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper on the flange. All assumed: about the size and weight of common electric ones."""

    mass: float = 0.65  # [kg]
    centre_of_mass: Triple = (0.0, 0.0, 0.052)  # [m] in tool0
    inertia: Triple = (0.0011, 0.0011, 0.0005)  # [kg m^2]
    reach: float = 0.1295  # [m] from tool0 to the tips of the fingers
    stroke: float = 3e-3  # [m] that each finger opens
    capture: float = 2e-3  # [m] a part this close to where it should be is gripped


GRIPPER = Gripper()

# Assumed: the e-Series' safety limits can be set; this is what the cell stops at rather than bend pins and boards.
FORCE_LIMIT = 100.0  # [N] at the wrist, a protective stop beyond it
UNLOCK_DELAY = 5.0  # [s] after a protective stop before it can be released (e-Series dashboard server)
CONTACT_THRESHOLD = 3.0  # [N] assumed: at which tool_contact speaks of contact; three times the sensor's noise
