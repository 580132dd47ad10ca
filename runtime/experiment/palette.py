"""How figures look. The colour-blind, and a grey print, tell their lines apart; a strategy looks the same in all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from runtime.experiment.contenders import CONTENDERS

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#7F7F7F", "#882255")
"""Okabe and Ito's palette for the colour-blind, without its yellow, which white paper swallows, and two more."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "<")
DASHES = ("-", "--", "-.", ":")

_FIRST = ("bayes", "meta", "spiral", "bayes-slide")  # the plainest colours are theirs


@dataclass(frozen=True)
class Look:
    """How one line, or one bar, of a figure looks."""

    colour: str
    marker: str
    dashes: str


def looks(names: Iterable[str]) -> dict[str, Look]:
    """A look for each name; the known contenders' are the same in every figure."""
    known = list(dict.fromkeys((*_FIRST, *CONTENDERS)))
    given = list(names)
    order = [*known, *(name for name in given if name not in known)]
    every = zip(order, cycle(COLOURS), cycle(MARKERS), cycle(DASHES), strict=False)
    found = {name: Look(colour, marker, dashes) for name, colour, marker, dashes in every}
    return {name: found[name] for name in given}


def style(salt: str) -> Any:
    """Settings of matplotlib for every figure. `salt`: figures with the same one and content are the same bytes."""
    from cycler import cycler

    return {
        "axes.prop_cycle": cycler(color=list(COLOURS)),
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "font.size": 10,
        "grid.alpha": 0.3,
        "legend.frameon": False,
        "svg.hashsalt": salt,
    }
