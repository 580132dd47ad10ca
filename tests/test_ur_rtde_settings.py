"""What the driver for an arm on the network accepts, and what it says of what it does not."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import pytest

from drivers.ur3e.ur_connection import UrConnection
from drivers.ur3e.ur_rtde_driver import UrRtde
from drivers.ur3e.workcell import Workcell
from runtime import config
from runtime.errors import ArmError, CellError, PluginError
from runtime.settings import read

CELL = config.load("igbt").cell


@pytest.mark.parametrize("address", ["192.168.0.10", "fe80::1", "ur3e.cell-2.example", "robot"])
def test_an_address_is_an_ip_address_or_a_host_name(address: str) -> None:
    UrRtde(address=address).check(CELL, "cell.toml")


@pytest.mark.parametrize("address", ["192.168.0.300", "192.168.0", "http://robot", "robot:30004", "-robot", "a b"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(CellError, match=r"cell\.toml: drivers\.ur_rtde\.address: .* is neither an IP address nor"):
        UrRtde(address=address).check(CELL, "cell.toml")


def test_a_missing_address_is_asked_for() -> None:
    with pytest.raises(CellError, match=r'drivers\.ur_rtde\.address: missing; .*address = "192\.168\.0\.10"'):
        UrRtde().check(CELL, "cell.toml")


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.3", "::1", "localhost"])
def test_this_machine_is_no_real_arm_and_its_evidence_is_kept_apart(address: str) -> None:
    with pytest.raises(CellError, match="this machine, so no real arm: write simulated = true"):
        UrRtde(address=address).check(CELL, "cell.toml")
    simulated = UrRtde(address=address, simulated=True)
    simulated.check(CELL, "cell.toml")
    assert simulated.simulated
    assert not UrRtde(address="192.168.0.10").simulated


def test_a_place_out_of_reach_is_named() -> None:
    far = UrRtde(address="192.168.0.10", workcell=replace(Workcell(), feeder_x=0.9))
    with pytest.raises(CellError, match=r"cell\.toml: the feeder is outside the UR3e's reach"):
        far.check(CELL, "cell.toml")


def test_permits_have_to_outlast_the_way_to_the_next_one() -> None:
    hasty = replace(CELL, safety=replace(CELL.safety, deadline=0.05))
    with pytest.raises(CellError, match="a permit that holds 50 ms ends before the next one is there"):
        UrRtde(address="192.168.0.10").check(hasty, "cell.toml")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"speed_limit": 0.0}, "speed_limit"),
        ({"speed_limit": 1.5}, "speed_limit"),
        ({"watchdog": "1000 Hz"}, "watchdog"),
        ({"feed_time": 5}, "has no unit"),
        ({"adress": "192.168.0.10"}, "did you mean 'address'"),
    ],
)
def test_wrong_settings_are_named(table: dict[str, Any], said: str) -> None:
    with pytest.raises(CellError, match=said):
        read(UrRtde, table, "cell.toml: drivers.ur_rtde")


def test_without_the_package_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rtde_control", None)
    with pytest.raises(PluginError, match=r"pip install 'palpate\[ur\]'"):
        UrConnection("192.168.0.10")


def test_an_arm_that_does_not_answer_is_named() -> None:
    pytest.importorskip("rtde_control")
    with pytest.raises(ArmError, match=r"no connection to 127\.0\.0\.99"):
        UrConnection("127.0.0.99")
