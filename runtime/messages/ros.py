"""The ROS 2 types that a cell uses, under their short names, and session time as ROS writes it."""

from __future__ import annotations

from rosbags.typesys.stores import ros2_jazzy as ros

Time = ros.builtin_interfaces__msg__Time
Header = ros.std_msgs__msg__Header
String = ros.std_msgs__msg__String
MultiArrayDimension = ros.std_msgs__msg__MultiArrayDimension
MultiArrayLayout = ros.std_msgs__msg__MultiArrayLayout
Float64MultiArray = ros.std_msgs__msg__Float64MultiArray
Clock = ros.rosgraph_msgs__msg__Clock
Log = ros.rcl_interfaces__msg__Log
JointState = ros.sensor_msgs__msg__JointState
Vector3 = ros.geometry_msgs__msg__Vector3
Point = ros.geometry_msgs__msg__Point
Quaternion = ros.geometry_msgs__msg__Quaternion
Pose = ros.geometry_msgs__msg__Pose
PoseStamped = ros.geometry_msgs__msg__PoseStamped
Wrench = ros.geometry_msgs__msg__Wrench
WrenchStamped = ros.geometry_msgs__msg__WrenchStamped
Transform = ros.geometry_msgs__msg__Transform
TransformStamped = ros.geometry_msgs__msg__TransformStamped
TFMessage = ros.tf2_msgs__msg__TFMessage

NANOSECONDS = 1_000_000_000
BASE_FRAME = "base_link"


def stamp_of(nanoseconds: int) -> Time:
    """Session time [ns] as a ROS time."""
    return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def nanoseconds_of(stamp: Time) -> int:
    """ROS time as session time [ns]."""
    return stamp.sec * NANOSECONDS + stamp.nanosec


def header(nanoseconds: int, frame: str = "") -> Header:
    """Header with a session time [ns] and a frame."""
    return Header(stamp=stamp_of(nanoseconds), frame_id=frame)
