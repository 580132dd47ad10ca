"""What the builtins that need no robot calculate."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from urscript_bench import Bench, failure, value

from drivers.ur3e import frames
from drivers.ur3e.urscript.pure_builtins import pure_builtins
from drivers.ur3e.urscript.values import Pose, Value


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("atan2(1, 2)", math.atan2(1, 2)),
        ("ceil(1.43)", 2),
        ("floor(-1.5)", -2),
        ("d2r(180)", math.pi),
        ("r2d(acos(0))", 90.0),
        ("log(10, 4)", 0.60206),
        ("pow(5., 3)", 125.0),
        ("norm(-5.3)", 5.3),
        ("norm(-8)", 8),
        ("norm([3, 4])", 5.0),
        ("norm(p[-.2, .2, -.2, -1.57, 0, 3.14])", 3.52768),
        ("normalize([0, 1, 1])", [0, math.sqrt(0.5), math.sqrt(0.5)]),
        ("binary_list_to_integer([True, False, False, True])", 9),
        ("binary_list_to_integer(integer_to_binary_list(-57))", -57),
        ("get_list_length([1, 3, 3, 6, 2])", 5),
        ('length("here I am")', 9),
        ("size([[1, 2], [3, 4], [5, 6]])", [3, 2]),
        ("transpose([[1, 2], [3, 4], [5, 6]])", [[1, 3, 5], [2, 4, 6]]),
        ("transpose([1, 2])", [[1], [2]]),
        ("transpose([[1], [2]])", [1, 2]),
        ("inv([[0, 1, 0], [0, 0, 1], [1, 0, 0]])", [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        ("inv([[4, 7], [2, 6]])", [[0.6, -0.7], [-0.2, 0.4]]),
        ("inv(p[.2, .5, .1, 1.57, 0, 3.14])", [0.19324, 0.41794, -0.29662, 1.23993, 0.0, 2.47985]),
        ("interpolate_pose(p[.2, .2, .4, 0, 0, 0], p[.2, .2, .6, 0, 0, 0], .5)", [0.2, 0.2, 0.5, 0, 0, 0]),
        ("pose_add(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])", [0.4, 1.0, 0.7, 3.14, 0, 0]),
        ("pose_sub(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])", [0, 0, -0.5, 0, 0, 0]),
        ("pose_trans(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])", [0.4, -0.0996, 0.60048, 3.14, 0, 0]),
        ("rotvec2rpy([3.14, 1.57, 0])", [-2.80856, -0.16202, 0.9]),
        ("rpy2rotvec([3.14, 1.57, 0])", [2.22153, 0.00177, -2.21976]),
        ("point_dist(p[.2, .5, .1, 1.57, 0, 3.14], p[.2, .5, .6, 0, 1.57, 3.14])", 0.5),
        ("pose_dist(p[0, 0, 0, 0, 0, 0], p[3, 0, 0, 0, 0, 0])", 3.0),
        ("wrench_trans(p[0, 1, 0, 0, 0, 0], [0, 0, 2, 0, 0, 0])", [0, 0, 2, 2, 0, 0]),
        ("make_list(3, 7)", [7, 7, 7]),
    ],
)
def test_builtins_on_numbers_lists_and_poses(call: str, expected: Value) -> None:
    got = value(call)
    if isinstance(expected, list) and expected and isinstance(expected[0], list):
        assert got == [pytest.approx(row, abs=2e-5) for row in expected]
    else:
        assert got == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("to_str(10)", "10"),
        ("to_str(2.123456123456)", "2.123456"),
        ("to_str(0.5)", "0.5"),
        ("to_str(-0.0000001)", "0"),
        ("to_str(100000000.0)", "100000000"),
        ("to_str(p[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])", "p[1, 2, 3, 4, 5, 6]"),
        ("to_str([True, False, True])", "[True, False, True]"),
        ('str_cat("Integer ", 1)', "Integer 1"),
        ("str_cat([True], [1, 0])", "[True][1, 0]"),
        ('str_cat(str_cat("", str_cat("One", "Two")), str_cat(3, 4))', "OneTwo34"),
        ('str_at("Hello", 1)', "e"),
        ('str_empty("")', True),
        ('str_find("Hello World!", "o", 5)', 7),
        ('str_find("abc", "z")', -1),
        ('str_len("Hello")', 5),
        ('str_len("é")', 2),
        ('str_cat(str_at("é", 0), str_at("é", 1))', "é"),
        ('str_sub("0123456789abcdefghij", 5, 3)', "567"),
        ('str_sub("0123456789abcdefghij", 10)', "abcdefghij"),
        ('str_sub("abc", 2, 0)', ""),
        ('str_sub("abcde", 2, len=50)', "cde"),
        ('to_num("10")', 10),
        ('to_num(" -3.0e5")', -3.0e5),
        ('to_num("+5.")', 5.0),
        ('to_num("0X3A")', 58),
    ],
)
def test_builtins_on_strings(call: str, expected: Value) -> None:
    got = value(call)
    assert (got, type(got)) == (expected, type(expected))


@pytest.mark.parametrize(
    "call",
    [
        'str_at("Hello", 10)',
        'str_sub("abcde", -5, 50)',
        'to_num("123abc")',
        'to_num("inf")',
        "acos(2)",
        "log(1, 2)",
        "pow(-8, 0.5)",
        "pow(0, -1)",
        "pow(1e300, 2)",
        "inv([[1, 2], [2, 4]])",
        "normalize([0, 0])",
        "pose_inv([1, 2, 3])",
        "get_list_length(3)",
        'sin("a")',
        "make_list(5001, 0)",
        "binary_list_to_integer([1])",
    ],
)
def test_builtins_refuse_what_has_no_result(call: str) -> None:
    assert failure(call).text.startswith(call.split("(", maxsplit=1)[0] + ": ")


def test_random_repeats_with_its_seed() -> None:
    text = "say(random())\nsay(random())"
    assert Bench(text, seed=3).run() == Bench(text, seed=3).run() != Bench(text, seed=4).run()


_NUMBERS = st.floats(-3, 3)
_POSES = st.lists(_NUMBERS, min_size=6, max_size=6).map(Pose)
_PURE = pure_builtins(1)


def call(name: str, *arguments: Value) -> Value:
    return _PURE[name].call(*arguments)


def close(a: Pose, b: Pose) -> bool:
    """Whether two poses are the same, in whichever way their rotation is written."""
    same = frames.product(frames.rotation_of_vector(a[3:]), frames.transpose(frames.rotation_of_vector(b[3:])))
    return math.dist(a[:3], b[:3]) < 1e-6 and math.hypot(*frames.vector_of_rotation(same)) < 1e-6


@given(_POSES, _POSES)
def test_a_pose_and_its_inverse_cancel(a: Pose, b: Pose) -> None:
    assert close(call("pose_trans", a, call("pose_inv", a)), Pose([0.0] * 6))
    assert close(call("pose_trans", call("pose_inv", a), call("pose_trans", a, b)), b)


@given(_POSES, _POSES)
def test_adding_what_was_subtracted_gives_the_pose_again(a: Pose, b: Pose) -> None:
    assert close(call("pose_add", call("pose_sub", a, b), b), a)
    assert close(call("interpolate_pose", a, b, 0), a)
    assert close(call("interpolate_pose", a, b, 1), b)


@given(st.lists(_NUMBERS, min_size=3, max_size=3))
def test_roll_pitch_yaw_and_rotation_vector_are_the_same_rotation(vector: list[float]) -> None:
    back = call("rpy2rotvec", call("rotvec2rpy", vector))
    assert close(Pose([0.0, 0.0, 0.0, *back]), Pose([0.0, 0.0, 0.0, *vector]))


@given(_POSES, st.lists(_NUMBERS, min_size=6, max_size=6), _POSES)
def test_wrenches_follow_poses(a: Pose, wrench: list[float], b: Pose) -> None:
    stepwise = call("wrench_trans", a, call("wrench_trans", b, wrench))
    assert stepwise == pytest.approx(call("wrench_trans", call("pose_trans", a, b), wrench), abs=1e-6)
