"""The table of ur-rtde's methods is that of the installed ur-rtde."""

from __future__ import annotations

import pytest
from ur_rtde_methods import MODULES, collect, public_names, show


@pytest.mark.parametrize("interface", MODULES)
def test_every_public_name_is_tried_or_left_out_for_a_reason(interface: str) -> None:
    rows = [row for row in collect() if row.interface == interface]
    tried = {row.method for row in rows if row.test}
    not_tried = {row.method for row in rows if not row.test}
    assert tried | not_tried == public_names(interface)
    assert not tried & not_tried


def test_the_table_can_be_printed(capsys: pytest.CaptureFixture[str]) -> None:
    rows = collect()
    show(rows, width=200)
    printed = capsys.readouterr().out
    assert all(row.method in printed for row in rows)
    assert f"{sum(len(public_names(interface)) for interface in MODULES)} public names" in printed
