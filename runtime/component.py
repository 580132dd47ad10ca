"""Through-hole parts: their pins, the holes they belong in, and how far off a part may be and still drop in.

A component's frame has its origin midway between the pin tips, z out of the tips (down, towards the board, when the
part is held above it) and x along the row of pins. It coincides with the TCP of an ideally gripped part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

from runtime.errors import InputError, alternatives

_DIRECTIONS = 720  # the area's trapezoid sum has converged to 1e-5 of its value with half as many


@dataclass(frozen=True)
class Pin:
    """One pin: a prism whose tip tapers over the chamfer."""

    x: float  # [m] of the pin's axis, component frame
    y: float  # [m]
    half_x: float  # [m] half the width of a rectangular pin; the radius of a round one
    half_y: float  # [m] equal to half_x for a round pin
    round: bool
    length: float  # [m] from body to tip
    chamfer: float  # [m] by which each side is set back at the tip
    chamfer_length: float  # [m] over which it is


@dataclass(frozen=True)
class Body:
    """The part's housing, for drawing it."""

    shape: Literal["box", "cylinder"]
    size: tuple[float, float, float]  # [m] along x, y, z; a cylinder's diameter twice, then its height
    standoff: float  # [m] from the pin tips to the nearest face of the body


@dataclass(frozen=True)
class Component:
    """One kind of part with the hole pattern it is made for."""

    name: str
    description: str
    pins: tuple[Pin, ...]
    holes: tuple[tuple[float, float], ...]  # [m] centre of each pin's hole, component frame
    hole_radius: float  # [m]
    depth: float  # [m] of the pin tips below the board's top once the part is seated
    mass: float  # [kg]
    centre_of_mass: tuple[float, float, float]  # [m] component frame
    polar: bool  # goes in one way round only, so the hole must say which
    body: Body
    grip: float  # [m] from the pin tips to the tips of the gripper's fingers


def _discs(component: Component, yaw: float, wider: float) -> list[tuple[float, float, float]]:
    """Discs (x, y, radius) [m] that all must hold the part's offset for every tip to lie within its hole.

    A rectangle lies in a circle if its corners do, a circle of radius a in one of radius b if their centres are no
    further apart than b - a. Either way the offset is confined to a disc.
    """
    cosine, sine = math.cos(yaw), math.sin(yaw)
    discs = []
    for pin, (hole_x, hole_y) in zip(component.pins, component.holes, strict=True):
        half_x, half_y = pin.half_x - pin.chamfer, pin.half_y - pin.chamfer
        if pin.round:
            points, radius = [(pin.x, pin.y)], component.hole_radius + wider - half_x
        else:
            points = [(pin.x + i * half_x, pin.y + j * half_y) for i in (-1, 1) for j in (-1, 1)]
            radius = component.hole_radius + wider
        discs += [(hole_x - cosine * x + sine * y, hole_y - sine * x - cosine * y, radius) for x, y in points]
    return discs


def clearance(component: Component, direction: float, yaw: float = 0.0, wider: float = 0.0) -> float:
    """How far [m] the part can be offset in `direction` before the outline of some pin's tip leaves its hole.

    `direction` [rad] is an angle in the component's frame; `yaw` [rad] is how far the part is turned against the hole
    pattern, `wider` [m] how much the holes' radius exceeds the drawing's. 0 if the part does not go in even when it is
    centred. Exact for rectangular and round pins in round holes; it asks about the tips only, whatever the chamfer then
    has to slide.
    """
    cosine, sine = math.cos(direction), math.sin(direction)
    reach = math.inf
    for x, y, radius in _discs(component, yaw, wider):
        along, across = x * cosine + y * sine, x * sine - y * cosine
        if radius < 0 or x * x + y * y > radius * radius:
            return 0.0
        reach = min(reach, along + math.sqrt(radius * radius - across * across))
    return max(reach, 0.0)


def feasible(component: Component, x: float, y: float, yaw: float = 0.0, wider: float = 0.0) -> bool:
    """Whether the tips lie within their holes when the part is off by (x, y) [m] in the component's frame."""
    return all(
        radius >= 0 and math.hypot(x - disc_x, y - disc_y) <= radius
        for disc_x, disc_y, radius in _discs(component, yaw, wider)
    )


@cache
def feasible_area(component: Component, yaw: float = 0.0, wider: float = 0.0) -> float:
    """Area [m^2] of the offsets at which the part goes in: half the integral of the squared clearance over angle."""
    step = 2 * math.pi / _DIRECTIONS
    return 0.5 * step * sum(clearance(component, index * step, yaw, wider) ** 2 for index in range(_DIRECTIONS))


def feasible_radius(component: Component, yaw: float = 0.0) -> float:
    """Radius [m] of the disc with the area in which the part goes in."""
    return math.sqrt(feasible_area(component, yaw) / math.pi)


def clearance_of_pins(component: Component) -> float:
    """By how much [m] the radius of the holes exceeds that of the circle about the thickest pin, chamfer aside."""
    return min(
        component.hole_radius - (pin.half_x if pin.round else math.hypot(pin.half_x, pin.half_y))
        for pin in component.pins
    )


def _flat(x: float) -> Pin:
    return Pin(x, 0.0, 0.6e-3, 0.3e-3, round=False, length=16e-3, chamfer=0.1e-3, chamfer_length=0.3e-3)


def _lead(x: float) -> Pin:
    return Pin(x, 0.0, 0.4e-3, 0.4e-3, round=True, length=8e-3, chamfer=0.1e-3, chamfer_length=0.2e-3)


COMPONENTS: dict[str, Component] = {
    component.name: component
    for component in (
        Component(
            name="igbt",
            description="power transistor in a TO-247 case, three flat pins",
            pins=tuple(_flat(x) for x in (-5.44e-3, 0.0, 5.44e-3)),
            holes=((-5.44e-3, 0.0), (0.0, 0.0), (5.44e-3, 0.0)),
            hole_radius=0.75e-3,
            depth=3.2e-3,
            mass=6e-3,
            centre_of_mass=(0.0, -1.0e-3, -24.0e-3),
            polar=True,
            body=Body("box", (15.8e-3, 5.0e-3, 20.8e-3), standoff=16e-3),
            grip=27e-3,
        ),
        Component(
            name="capacitor",
            description="electrolytic capacitor, two round leads",
            pins=tuple(_lead(x) for x in (-2.5e-3, 2.5e-3)),
            holes=((-2.5e-3, 0.0), (2.5e-3, 0.0)),
            hole_radius=0.55e-3,
            depth=3.2e-3,
            mass=3e-3,
            centre_of_mass=(0.0, 0.0, -17.0e-3),
            polar=False,
            body=Body("cylinder", (10e-3, 10e-3, 20e-3), standoff=8e-3),
            grip=19e-3,
        ),
    )
}


def component(name: str) -> Component:
    """The component of that name. Raises InputError that names the ones there are."""
    try:
        return COMPONENTS[name]
    except KeyError:
        raise InputError(f"no component {name!r}; {alternatives(name, COMPONENTS)}") from None
