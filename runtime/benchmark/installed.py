"""Whether a contender can take part."""

from __future__ import annotations

import importlib


def missing(needs: tuple[str, ...], install: str) -> str:
    """What to do to have these modules; empty if they are there."""
    try:
        for module in needs:
            importlib.import_module(module)
    except ImportError:
        return f"not installed (pip install {install})"
    return ""
