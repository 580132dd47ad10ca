"""Spans of session time in which something holds, half open: [begin, end) in nanoseconds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

Span = tuple[int, int]


def holds(spans: Iterable[Span], now: int) -> bool:
    """Whether `now` lies in one of them."""
    return any(begin <= now < end for begin, end in spans)


def spans_where(condition: Callable[[int], bool], moments: Sequence[int]) -> tuple[Span, ...]:
    """The longest spans in which a condition holds that only changes at `moments`, which are in order; sorted.

    It must not hold before the first moment, nor after the last.
    """
    found: list[Span] = []
    for begin, end in pairwise(moments):
        if not condition(begin):
            continue
        if found and found[-1][1] == begin:
            found[-1] = (found[-1][0], end)
        else:
            found.append((begin, end))
    return tuple(found)
