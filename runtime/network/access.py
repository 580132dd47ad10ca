"""Who may say and hear what in a cell that is open to a network: Zenoh's access control, built from THE MAP.

The router knows each client by the name in its certificate, and checks what comes in and what goes out:

    publish     a topic's publisher alone; everybody but a guest where the map says "any"
    read        everybody, hidden topics the recorder and the viewer alone
    answer      a service's server alone
    ask         everybody but a guest
    announce    everybody by its own name alone
    all else    nobody

A message under a key expression with wildcards reaches every topic that it matches, so nothing is allowed by one where
a topic's name would do.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from runtime.bus import READS_HIDDEN
from runtime.network import rmw_zenoh
from runtime.topics import ANYBODY, Service, Topic, services, topics

ROUTER = "router"  # the launcher's, or that of a log that is played
GUEST = "guest"  # reads what is not hidden, and says nothing
OPERATOR = "operator"  # presses buttons, asks for snapshots, leads a player
PLAYER = "player"
RECORDER = "recorder"
PLUGINS = ("arm", "light_curtain", "interlock", "strategy", "posterior", "assembly", RECORDER, "viewer")
CLIENTS = (*PLUGINS, "launcher", OPERATOR, PLAYER, GUEST)
ROLES = (ROUTER, *CLIENTS)  # each has a certificate with this name

_LISTENING = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")


def service_key(service: Service[Any, Any]) -> str:
    """Key expression that a service answers under."""
    return f"palpate{service.name}"


def control(domain: int, *, playback: bool = False) -> dict[str, Any]:
    """Zenoh's `access_control` for the router of a cell; with `playback`, of a log that is played in its place."""
    known = [topic for topic in topics().values() if topic.publisher in (*CLIENTS, ANYBODY)]
    rules: list[dict[str, Any]] = []
    for role in CLIENTS:
        rules += _rules(role, domain, known, plays=playback and role == PLAYER)
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": role, "cert_common_names": [role]} for role in CLIENTS],
        "policies": [
            {"rules": [rule["id"] for rule in rules if rule["id"].startswith(f"{role} ")], "subjects": [role]}
            for role in CLIENTS
        ],
    }


def _rules(role: str, domain: int, known: list[Topic[Any]], *, plays: bool) -> list[dict[str, Any]]:
    everything = [f"{domain}/**", f"{domain}/**/@adv/**"]  # ** does not match a part that begins with @
    tokens = f"@ros2_lv/{domain}/**"
    own_tokens = [f"@ros2_lv/{domain}/*/*/*/*/%/%/{role}", f"@ros2_lv/{domain}/*/*/*/*/%/%/{role}/**"]
    published = [topic for topic in known if may_publish(role, topic)]
    readable = [topic for topic in known if not topic.hidden or role in READS_HIDDEN]
    says = everything if plays else _keys(published, domain)
    hears = everything if role == RECORDER else _keys(readable, domain)
    kept = everything if plays else _caches(published, domain)  # last words of latched topics, and their heartbeats
    caches = _caches(readable, domain)
    asks = [service_key(service) for service in services().values() if role != GUEST]
    answers = [service_key(service) for service in services().values() if service.server == role]

    def rule(name: str, flow: str, messages: Iterable[str], keys: list[str]) -> list[dict[str, Any]]:
        if not keys:
            return []
        whole = {"id": f"{role} {name}", "flows": [flow], "messages": list(messages), "permission": "allow"}
        return [{**whole, "key_exprs": keys}]

    return [
        *rule("says", "ingress", ["put"], [*says, *kept]),
        *rule(
            "answers", "ingress", ["reply", "declare_queryable"], [*answers, *kept, *_latched_keys(published, domain)]
        ),
        *rule("is asked", "egress", ["query"], [*answers, *kept]),
        *rule("asks", "ingress", ["query"], [*asks, *caches]),
        *rule("is answered", "egress", ["reply"], [*asks, *caches, *_latched_keys(readable, domain)]),
        *rule("is present", "ingress", ["liveliness_token"], [*own_tokens, *kept]),
        # What may be heard is decided where it goes out: who listens to everything hears what it may.
        *rule("listens", "ingress", _LISTENING, [*everything, tokens]),
        *rule("hears", "egress", ["put"], [*hears, *caches]),
        *rule(
            "knows who is there",
            "egress",
            ["declare_subscriber", "declare_queryable", "liveliness_token", "declare_liveliness_subscriber"],
            [*everything, tokens, "palpate/**"],
        ),
    ]


def may_publish(role: str, topic: Topic[Any]) -> bool:
    """Whether a client of this role may publish a topic."""
    return topic.publisher == role or (topic.publisher == ANYBODY and role != GUEST)


def _keys(chosen: list[Topic[Any]], domain: int) -> list[str]:
    return [rmw_zenoh.key(topic, domain) for topic in chosen]


def _latched_keys(chosen: list[Topic[Any]], domain: int) -> list[str]:
    return _keys([topic for topic in chosen if topic.latched], domain)


def _caches(chosen: list[Topic[Any]], domain: int) -> list[str]:
    """Where latched publishers keep their last message and tell that they are there."""
    return [f"{key}/@adv/**" for key in _latched_keys(chosen, domain)]
