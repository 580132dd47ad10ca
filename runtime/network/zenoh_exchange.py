"""How cells that share what they learnt reach each other: through a Zenoh router, which `palpate posterior serve` runs.

    palpate/posterior/<format>/known/<cell>    put: the checksum of all that a cell knows
    palpate/posterior/<format>/lacking/<cell>  query: a digest; reply: what it lacks, as lines of JSON

The router belongs to no cell. With keys it lets in those who show a posterior's certificate of the same authority, and
nothing through but this.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh

from runtime.closing import Closing
from runtime.errors import BusError, InputError, PalpateError
from runtime.evidence.exchange import Ears, Join
from runtime.network.access import ROUTER
from runtime.network.sharing_point import host_of
from runtime.network.zenoh_session import config, shown

FORMAT = 1  # of what is said; cells of another one are heard of and left alone
ROLE = "posterior"  # whose certificate a cell shows
_ROOT = "palpate/posterior"
_CONNECT_TIMEOUT = 2000  # [ms]
_LEASE = 3000  # [ms] of silence after which a connection counts as lost


def client(endpoints: Sequence[str], keys: Path | None) -> Join:
    """Ways into the sharing of other cells, through the first of these routers that answers."""

    def join(cell: str, ears: Ears) -> ZenohPeers:
        settings: dict[str, Any] = {
            "mode": "client",
            "connect/endpoints": list(endpoints),
            "connect/timeout_ms": _CONNECT_TIMEOUT,
            "connect/retry": {"period_init_ms": 250, "period_max_ms": 2000, "period_increase_factor": 2},
            "listen/endpoints": [],
        }
        if keys is not None:
            settings |= shown(ROLE, keys, "connect")
        return ZenohPeers(_opened(settings, ", ".join(endpoints), BusError), cell, ears)

    return join


def router(endpoints: Sequence[str], keys: Path | None) -> Join:
    """The place where cells meet, and one who shares there itself. InputError for an endpoint that cannot be had."""

    def join(cell: str, ears: Ears) -> ZenohPeers:
        settings: dict[str, Any] = {"mode": "router", "listen/endpoints": list(endpoints), "connect/endpoints": []}
        if keys is not None:
            settings |= shown(ROUTER, keys, "listen", tuple(host_of(endpoint) for endpoint in endpoints))
            settings["access_control"] = _control()
        return ZenohPeers(_opened(settings, ", ".join(endpoints), InputError), cell, ears, meets_here=True)

    return join


def _opened(settings: dict[str, Any], where: str, failure: type[PalpateError]) -> zenoh.Session:
    try:
        return zenoh.open(config(settings | {"transport/link/tx/lease": _LEASE}))
    except zenoh.ZError as error:
        reason = str(error).splitlines()[0].partition(" at /")[0][:120]
        raise failure(f"{where}: {reason}") from None


def _control() -> dict[str, Any]:
    """Zenoh's `access_control`: posteriors speak of evidence, and nobody of anything else."""
    messages = ["put", "query", "reply", "declare_subscriber", "declare_queryable"]
    rule = {"id": "shares", "permission": "allow", "flows": ["ingress", "egress"], "messages": messages}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [{**rule, "key_exprs": [f"{_ROOT}/**"]}],
        "subjects": [{"id": ROLE, "cert_common_names": [ROLE]}],
        "policies": [{"rules": ["shares"], "subjects": [ROLE]}],
    }


class ZenohPeers(Closing):
    """The other cells, on a Zenoh session that belongs to this object. It connects again by itself."""

    def __init__(self, session: zenoh.Session, cell: str, ears: Ears, *, meets_here: bool = False) -> None:
        self._session, self._cell, self._ears, self._meets_here = session, cell, ears, meets_here
        self._closed = threading.Lock()
        self._declared = [
            session.declare_queryable(_key("lacking", cell), self._on_query),
            session.declare_subscriber(f"{_ROOT}/*/known/*", self._on_sample),
        ]

    @property
    def reached(self) -> bool:
        """Whether there is a router."""
        return self._meets_here or bool(self._session.info.routers_zid())

    def announce(self, checksum: str) -> None:
        """Tell all what checksum this cell's evidence has."""
        try:
            self._session.put(
                _key("known", self._cell), checksum.encode(), congestion_control=zenoh.CongestionControl.DROP
            )
        except zenoh.ZError as error:
            raise BusError(f"nothing could be announced: {error}") from None

    def ask(self, cell: str, question: bytes, timeout: float) -> bytes | None:
        """One cell's answer to a question; None if there was none within `timeout` seconds."""
        try:
            for reply in self._session.get(_key("lacking", cell), payload=question, timeout=timeout):
                if reply.ok is not None:
                    return bytes(reply.ok.payload)
        except zenoh.ZError as error:
            raise BusError(f"{cell} could not be asked: {error}") from None
        return None

    def close(self) -> None:
        """Leave."""
        with self._closed:
            if not self._session.is_closed():
                self._session.close()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        _, _, spoken, _, cell = str(sample.key_expr).split("/")
        if spoken != str(FORMAT):
            self._ears.misheard(f"{cell} speaks format {spoken[:20]}, this palpate {FORMAT}")
        elif sample.kind == zenoh.SampleKind.PUT:
            self._ears.heard(cell, bytes(sample.payload))

    def _on_query(self, query: zenoh.Query) -> None:
        with query:  # without an answer the asker learns at once that there is none
            try:
                answer = self._ears.asked(b"" if query.payload is None else bytes(query.payload))
            except InputError as error:
                self._ears.misheard(str(error))
                return
            except PalpateError:  # the store is busy: the asker comes again
                return
            with suppress(zenoh.ZError):  # it has gone meanwhile
                query.reply(_key("lacking", self._cell), answer)


def _key(kind: str, cell: str) -> str:
    return f"{_ROOT}/{FORMAT}/{kind}/{cell}"
