"""The arm as URDF and as MJCF: two engines agree on the same robot; frames and the inverse kinematics."""

import math
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ur3e import frames
from drivers.ur3e.kinematics import Kinematics
from drivers.ur3e.parameters import JOINTS
from drivers.ur3e.robot_model import mjcf_actuators, mjcf_arm, mjcf_materials, urdf
from runtime.errors import ArmError

ARM = (
    '<mujoco><compiler angle="radian" autolimits="true"/>'
    f"<asset>{mjcf_materials()}</asset><worldbody>{mjcf_arm()}</worldbody><actuator>{mjcf_actuators()}</actuator></mujoco>"
)
HOME = np.array([-0.3, -1.6, 2.0, -1.97, -1.5708, -1.87])
vectors = st.tuples(*[st.floats(-2, 2)] * 3).filter(lambda v: 1e-3 < math.hypot(*v) < 3.14)


def test_mujoco_and_pinocchio_agree_on_the_arm() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    kinematics = Kinematics()
    rng = np.random.default_rng(1)
    body = model.body("gripper").id
    rotors = np.diag([joint.armature for joint in JOINTS])
    worst = dict.fromkeys(("position", "rotation", "jacobian", "mass", "bias"), 0.0)
    for _ in range(500):
        q, qd = rng.uniform(-math.pi, math.pi, 6), rng.uniform(-2, 2, 6)
        data.qpos[:], data.qvel[:] = q, qd
        mujoco.mj_forward(model, data)
        position, rotation = kinematics.forward(q)
        linear, angular, mass = np.zeros((3, 6)), np.zeros((3, 6)), np.zeros((6, 6))
        mujoco.mj_jacBody(model, data, linear, angular, body)
        mujoco.mj_fullM(model, data, mass)
        found = {
            "position": data.xpos[body] - position,
            "rotation": data.xmat[body] - rotation,
            "jacobian": np.vstack([linear, angular]) - kinematics.jacobian(),
            "mass": mass - rotors - kinematics.mass_matrix(q),
            "bias": data.qfrc_bias - kinematics.bias(q, qd),
        }
        for name, difference in found.items():
            worst[name] = max(worst[name], float(np.abs(difference).max()))
    assert max(worst.values()) < 1e-12, worst


def test_the_links_are_named_as_by_urs_ros_driver() -> None:
    root = ET.fromstring(urdf())
    links = [link.get("name") for link in root.iter("link")]
    assert links == [
        "base_link", "base_link_inertia", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link",
        "wrist_2_link", "wrist_3_link", "flange", "tool0", "gripper",
    ]  # fmt: skip
    assert sum(float(mass.attrib["value"]) for mass in root.iter("mass")) == pytest.approx(8.7985 + 0.65)


def test_the_published_reach_of_the_outstretched_arm() -> None:
    position, _ = Kinematics().tool(np.zeros(6))
    assert position == pytest.approx((0.24355 + 0.2132, 0.13105 + 0.0921, 0.15185 - 0.08535), abs=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-0.4, 0.4), min_size=6, max_size=6), vectors)
def test_the_inverse_comes_back_to_the_pose(offsets: list[float], turn: tuple[float, float, float]) -> None:
    kinematics = Kinematics()
    kinematics.set_tcp([0.01, -0.02, 0.15, *turn])
    position, rotation = kinematics.forward(HOME + np.array(offsets))
    found = kinematics.inverse(position, rotation, HOME)
    again, orientation = kinematics.forward(found)
    assert np.abs(np.subtract(again, position)).max() < 1e-9
    assert np.abs(np.subtract(orientation, rotation)).max() < 1e-9


def test_a_pose_out_of_reach_is_named() -> None:
    with pytest.raises(ArmError, match=r"out of reach: TCP at \(900\.00, 0\.00, 100\.00\) mm"):
        Kinematics().inverse((0.9, 0.0, 0.1), frames.tool_down(0.0), HOME)


@given(vectors)
def test_rotation_vector_quaternion_and_matrix_are_the_same_rotation(vector: tuple[float, float, float]) -> None:
    rotation = frames.rotation_of_vector(vector)
    assert frames.vector_of_rotation(rotation) == pytest.approx(vector, abs=1e-9)
    again = frames.rotation_of_vector(frames.vector_of_quaternion(frames.quaternion_of_rotation(rotation)))
    assert again == pytest.approx(rotation, abs=1e-12)
    assert frames.product(rotation, frames.transpose(rotation)) == pytest.approx(frames.IDENTITY, abs=1e-12)


@given(vectors, vectors)
def test_poses_survive_the_way_to_ur_and_back(
    position: tuple[float, float, float], vector: tuple[float, float, float]
) -> None:
    rotation = frames.rotation_of_vector(vector)
    again, orientation = frames.ros_pose(frames.ur_pose(position, rotation))
    assert again == pytest.approx(position)
    assert orientation == pytest.approx(rotation, abs=1e-9)


def test_half_a_turn_lies_between_the_base_frames() -> None:
    assert frames.ur_pose((0.3, 0.1, 0.2), frames.tool_down(0.0))[:3] == [-0.3, -0.1, 0.2]
    down = frames.tool_down(0.4)
    assert frames.rotate(down, (0, 0, 1)) == pytest.approx((0, 0, -1))
    assert frames.rotate(down, (1, 0, 0)) == pytest.approx((math.cos(0.4), math.sin(0.4), 0))
