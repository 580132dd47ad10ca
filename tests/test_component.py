"""The geometry of pins and holes."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.component import COMPONENTS, Component, clearance, component, feasible, feasible_area, feasible_radius
from runtime.errors import InputError

parts = st.sampled_from(list(COMPONENTS.values()))
directions = st.floats(-math.pi, math.pi)
yaws = st.floats(-0.01, 0.01)


def outline_fits(part: Component, x: float, y: float, yaw: float) -> bool:
    """Whether every point of every tip's outline, traced at 720 points, lies in its hole."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for pin, hole in zip(part.pins, part.holes, strict=True):
        for index in range(720):
            angle = index * math.pi / 360
            u, v = math.cos(angle), math.sin(angle)
            stretch = 1.0 if pin.round else 1.0 / max(abs(u), abs(v))
            px = pin.x + (pin.half_x - pin.chamfer) * u * stretch
            py = pin.y + (pin.half_y - pin.chamfer) * v * stretch
            if (
                math.hypot(cosine * px - sine * py + x - hole[0], sine * px + cosine * py + y - hole[1])
                > part.hole_radius
            ):
                return False
    return True


@given(parts, directions, yaws)
def test_clearance_is_where_the_traced_outline_leaves_the_hole(part: Component, direction: float, yaw: float) -> None:
    reach = clearance(part, direction, yaw)
    u, v = math.cos(direction), math.sin(direction)
    assert outline_fits(part, (reach - 1e-7) * u, (reach - 1e-7) * v, yaw)
    assert not outline_fits(part, (reach + 1e-6) * u, (reach + 1e-6) * v, yaw)


@given(parts, directions, yaws, st.floats(0, 0.5e-3))
def test_a_point_is_feasible_exactly_if_it_is_within_the_clearance(
    part: Component, direction: float, yaw: float, distance: float
) -> None:
    reach = clearance(part, direction, yaw)
    if abs(distance - reach) > 1e-9:
        assert feasible(part, distance * math.cos(direction), distance * math.sin(direction), yaw) == (distance < reach)


@given(parts, directions, st.floats(0, 0.05))
def test_turning_the_part_never_helps_on_the_whole(part: Component, direction: float, yaw: float) -> None:
    assert feasible_area(part, yaw) <= feasible_area(part) * (1 + 1e-9)
    assert clearance(part, direction, yaw) == pytest.approx(clearance(part, direction + math.pi, yaw), abs=1e-12)


@given(parts, directions, st.floats(0.0, 0.1e-3))
def test_a_smaller_hole_leaves_less(part: Component, direction: float, less: float) -> None:
    tighter = replace(part, hole_radius=part.hole_radius - less)
    assert clearance(tighter, direction) <= clearance(part, direction) + 1e-15


def test_round_leads_leave_a_disc() -> None:
    assert feasible_radius(component("capacitor")) == pytest.approx(0.55e-3 - 0.3e-3, rel=1e-9)


def test_flat_pins_leave_more_room_across_than_along_their_row() -> None:
    igbt = component("igbt")
    assert clearance(igbt, 0.0) == pytest.approx(math.sqrt(0.75**2 - 0.2**2) * 1e-3 - 0.5e-3)
    assert clearance(igbt, math.pi / 2) == pytest.approx(math.sqrt(0.75**2 - 0.5**2) * 1e-3 - 0.2e-3)
    assert 0.23e-3 < feasible_radius(igbt) < 0.26e-3


def test_a_part_turned_too_far_goes_in_nowhere() -> None:
    assert clearance(component("igbt"), 0.3, yaw=math.radians(6)) == 0.0
    assert feasible_area(component("igbt"), yaw=math.radians(6)) == 0.0


def test_an_unknown_component_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        InputError, match=r"no component 'capacitator'; did you mean 'capacitor'\? known: capacitor, igbt"
    ):
        component("capacitator")
