"""palpate posterior serve: the place where cells meet that share what they learn, and a store of it all."""

from __future__ import annotations

import logging
import secrets
import threading
from datetime import datetime
from pathlib import Path

from rich.console import Console

from runtime.clock import wall_clock
from runtime.errors import InputError
from runtime.evidence.exchange import EvidenceExchange
from runtime.evidence.store import PosteriorStore
from runtime.network.sharing_point import DEFAULT_ENDPOINT, check_endpoint, host_of, is_loopback
from runtime.network.zenoh_exchange import router

_LOOK = 0.5  # [s] between looks for something to say


def serve(path: Path, endpoints: list[str] | None, keys: Path | None) -> None:
    """Serve until KeyboardInterrupt. Raises InputError for an address that cannot be had or keys that are not right."""
    endpoints = endpoints or [DEFAULT_ENDPOINT]
    for endpoint in endpoints:
        check_endpoint(endpoint, keys=keys is not None)
    console = Console()

    def say(text: str, level: int = logging.INFO) -> None:
        mark = "warning: " if level >= logging.WARNING else ""
        time = datetime.now().strftime("%Y-%m-%d %H:%M:%S")
        console.print(f"{time}  {mark}{text}", highlight=False, markup=False, soft_wrap=True)

    with PosteriorStore(path) as store:
        if store.set_aside is not None:
            say(f"the store was damaged: set aside as {store.set_aside.name}, begun anew", logging.WARNING)
        where = ", ".join(endpoints)
        name = f"serve-{wall_clock()}-{secrets.token_hex(4)}"
        with EvidenceExchange(store, name, router(endpoints, keys), where, at_once=True) as exchange:
            open_to = [endpoint for endpoint in endpoints if not is_loopback(host_of(endpoint))]
            if open_to and keys is None:
                say(f"whoever reaches {open_to[0]} can add evidence and forget it; --keys lets only cells in", 30)
            waiting = threading.Event()
            while not waiting.wait(_LOOK):
                for text, level in exchange.reports():
                    say(text, level)


def folder_of(name: str | None) -> Path | None:
    """A folder of keys as given. InputError if there is none."""
    if name is None:
        return None
    if not Path(name).is_dir():
        raise InputError(f"{name} is no folder of keys; 'palpate keys {name}' makes one")
    return Path(name)
