"""palpate replay: publish a recorded session on Zenoh again."""

from __future__ import annotations
