"""How a Zenoh session of ours is set up: no multicast, nothing that was not asked for, and TLS where there are keys."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import zenoh

_BLOCKED_FOR = (
    60_000_000  # [us] a slow receiver may hold a sender up before the transport gives up; zenoh's default is 5 s
)


def config(settings: dict[str, Any]) -> zenoh.Config:
    """What all our sessions have in common, and `settings` on top of it."""
    made = zenoh.Config()
    common = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "timestamping/enabled": True,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": _BLOCKED_FOR,
    }
    for name, value in (common | settings).items():
        made.insert_json5(name, json.dumps(value))
    return made


def shown(role: str, keys: Path, side: str, hosts: tuple[str, ...] = ()) -> dict[str, Any]:
    """What a role shows on its side, `listen` or `connect`, of a connection. Raises InputError without keys."""
    from runtime.network.keys import credentials

    own = credentials(keys, role, hosts)
    tls = "transport/link/tls"
    return {
        f"{tls}/root_ca_certificate": str(own.authority.resolve()),
        f"{tls}/{side}_certificate": str(own.certificate.resolve()),
        f"{tls}/{side}_private_key": str(own.key.resolve()),
        f"{tls}/enable_mtls": True,
        f"{tls}/close_link_on_expiration": False,  # an arm at work is not stopped by a date
    }
