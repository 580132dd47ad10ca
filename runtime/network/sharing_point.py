"""Where cells meet that share what they learnt: `tcp/192.168.0.2:7460`, or `tls/…` with keys."""

from __future__ import annotations

import ipaddress
import re

from runtime.errors import InputError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7460"
_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9][A-Za-z0-9.-]*):(\d{1,5})")


def check_endpoint(endpoint: str, *, keys: bool) -> None:
    """Raise InputError for what is no endpoint, and for TLS without keys or keys without TLS."""
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or not 1 <= int(match[3]) <= 65535:
        raise InputError(f"{endpoint!r} is no address of a router; write tcp/HOST:PORT, such as {DEFAULT_ENDPOINT}")
    if match[1] == "tls" and not keys:
        raise InputError(f"{endpoint} needs keys, which 'palpate keys' makes; without them write tcp/")
    if match[1] == "tcp" and keys and not is_loopback(host_of(endpoint)):
        raise InputError(f"{endpoint} would send in the clear what there are keys for; write tls/")


def host_of(endpoint: str) -> str:
    """The host in an endpoint."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")


def is_loopback(host: str) -> bool:
    """Whether a host is this machine, out of reach of the network."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
