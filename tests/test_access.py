"""Who may join a cell, and what it may say and hear there: real certificates, real TLS, real routers."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import socket
import stat
import subprocess
import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh
from cells import Palpate, cell_text, write_cell
from conftest import unused_port

from runtime import config
from runtime import topics as t
from runtime.bus import Envelope, encode
from runtime.cli import main
from runtime.errors import BusError, CellError, InputError
from runtime.in_process import run_in_process
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.messages import (
    ArmStatus,
    Permit,
    Reset,
    SafetyState,
    SnapshotReply,
    SnapshotRequest,
    Truth,
    header,
    stamp_of,
)
from runtime.network import rmw_zenoh
from runtime.network.access import CLIENTS, GUEST, ROLES, may_publish
from runtime.network.keys import credentials, make_keys
from runtime.network.meeting_point import MeetingPoint
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter

PATIENCE = 20.0
STATUS = ArmStatus(header(0), 7, 1, 1.0, "home", "")


def permit(reason: str) -> Permit:
    return Permit(header(1), True, SafetyState.PERMITTED, reason, stamp_of(2))


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cell") / "keys"
    make_keys(folder)
    return folder


@pytest.fixture
def router(keys: Path) -> Iterator[ZenohRouter]:
    with ZenohRouter(MeetingPoint(unused_port(), keys=keys)) as made:
        yield made


def disguised(router: ZenohRouter, folder: Path, role: str, claimed: str) -> MeetingPoint:
    """The same cell for one who claims another role than its certificate has."""
    assert router.point.keys is not None
    folder.mkdir(exist_ok=True)
    shutil.copy(router.point.keys / "ca.pem", folder)
    for ending in ("pem", "key"):
        shutil.copy(router.point.keys / f"{role}.{ending}", folder / f"{claimed}.{ending}")
    return MeetingPoint(router.point.port, keys=folder)


def begin(router: ZenohRouter, *buses: ZenohBus) -> None:
    """Let publishers know of all subscribers. The router has handled what a bus declared once it has answered it."""
    for _ in range(2):
        for bus in buses:
            bus.settle()


def heard(bus: ZenohBus, count: int) -> list[Envelope]:
    """The next messages, and no more than these."""
    found = [bus.inbox.receive(PATIENCE) for _ in range(count)]
    assert bus.inbox.poll() is None
    assert all(isinstance(item, Envelope) for item in found), found
    return [item for item in found if isinstance(item, Envelope)]


def test_a_client_without_keys_or_with_those_of_another_cell_does_not_come_in(
    router: ZenohRouter, tmp_path: Path
) -> None:
    port = router.point.port
    with pytest.raises(BusError, match="no cell answers"):
        ZenohBus("recorder", MeetingPoint(port), patience=0.3)
    make_keys(tmp_path / "other", ["recorder"])
    with pytest.raises(BusError, match="no cell answers"):
        ZenohBus("recorder", MeetingPoint(port, keys=tmp_path / "other"), patience=0.3)
    shutil.copy(router.point.keys / "ca.pem" if router.point.keys else "", tmp_path / "other")  # trusts, is not trusted
    with pytest.raises(BusError, match="no cell answers"):
        ZenohBus("recorder", MeetingPoint(port, keys=tmp_path / "other"), patience=0.3)
    with ZenohBus("recorder", router.point) as bus:
        bus.announce()
        assert router.wait_for({"recorder"}, PATIENCE) == set()


def test_tls_without_a_certificate_of_its_own_does_not_come_in(router: ZenohRouter) -> None:
    settings = {
        "mode": "client",
        "connect/endpoints": [f"tls/127.0.0.1:{router.point.port}"],
        "connect/timeout_ms": 300,
        "scouting/multicast/enabled": False,
        "transport/link/tls/root_ca_certificate": str((router.point.keys or Path()) / "ca.pem"),
    }
    plain = zenoh.Config()
    for name, value in settings.items():
        plain.insert_json5(name, json.dumps(value))
    with pytest.raises(zenoh.ZError):
        zenoh.open(plain)


def test_a_strategy_can_neither_permit_motion_nor_make_up_attempts_nor_read_the_truth(
    router: ZenohRouter, tmp_path: Path
) -> None:
    forger = disguised(router, tmp_path / "a", "strategy", "interlock")
    spy = disguised(router, tmp_path / "b", "strategy", "viewer")
    with (
        ZenohBus("arm", router.point) as arm,
        ZenohBus("interlock", router.point) as interlock,
        ZenohBus("recorder", router.point) as recorder,
        ZenohBus("interlock", forger) as strategy,
        ZenohBus("viewer", spy) as watcher,
    ):
        arm.subscribe(t.PERMIT)
        recorder.subscribe_all()
        watcher.subscribe(t.TRUTH)
        watcher.subscribe_all()
        forged, made_up = strategy.publisher(t.PERMIT), strategy.publisher(t.ATTEMPT)
        real, truths, statuses = interlock.publisher(t.PERMIT), arm.publisher(t.TRUTH), arm.publisher(t.ARM_STATUS)
        strategy.announce()
        begin(router, arm, interlock, recorder, strategy, watcher)
        forged.send(permit("forged"), 1)
        made_up.send_raw(b"made up", 1)
        strategy.settle()  # the router has handled what was sent before
        real.send(permit("real"), 1)
        assert [item.read(t.PERMIT).reason for item in heard(arm, 1)] == ["real"]
        truths.send(Truth(header(1), 1, 1, "1", *[0.0] * 8), 1)
        statuses.send(STATUS, 2)
        assert [item.topic for item in heard(watcher, 2)] == [t.PERMIT.name, t.ARM_STATUS.name]
        topics = {recorder.inbox.receive(PATIENCE).topic for _ in range(3)}  # type: ignore[union-attr]
        assert topics == {t.PERMIT.name, t.TRUTH.name, t.ARM_STATUS.name}
        assert router.wait_for({"interlock"}, 0.0) == {"interlock"}  # nor can it pass for one that is there


def test_no_wildcard_carries_a_message_where_its_name_would_not(router: ZenohRouter) -> None:
    assert router.point.keys is not None
    own = credentials(router.point.keys, "strategy")
    settings = {
        "mode": "client",
        "connect/endpoints": [f"tls/127.0.0.1:{router.point.port}"],
        "scouting/multicast/enabled": False,
        "transport/link/tls/root_ca_certificate": str(own.authority),
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/connect_certificate": str(own.certificate),
        "transport/link/tls/connect_private_key": str(own.key),
    }
    raw = zenoh.Config()
    for name, value in settings.items():
        raw.insert_json5(name, json.dumps(value))
    with ZenohBus("arm", router.point) as arm, ZenohBus("interlock", router.point) as interlock:
        arm.subscribe(t.PERMIT)
        real = interlock.publisher(t.PERMIT)
        begin(router, arm, interlock)
        attachment = rmw_zenoh.Attachment(1, 1, bytes(16)).pack()
        with zenoh.open(raw) as session:
            for key in ("0/**", "0/safety/**", rmw_zenoh.key(t.PERMIT)):
                session.put(key, encode(permit("forged")), attachment=attachment)
            for _ in session.liveliness().get(rmw_zenoh.node_tokens()):
                pass
        real.send(permit("real"), 1)
        assert [item.read(t.PERMIT).reason for item in heard(arm, 1)] == ["real"]


def test_a_guest_reads_and_says_nothing(router: ZenohRouter) -> None:
    with (
        ZenohBus("arm", router.point) as arm,
        ZenohBus("recorder", router.point) as recorder,
        ZenohBus(GUEST, router.point) as guest,
        ZenohBus("operator", router.point) as operator,
    ):
        status = arm.publisher(t.ARM_STATUS)
        arm.subscribe(t.RESET, t.SESSION)
        recorder.serve(t.SNAPSHOT)
        begin(router, arm, recorder)
        status.send(STATUS, 1)
        guest.subscribe(t.ARM_STATUS)  # latched: the last word reaches one who comes late
        assert heard(guest, 1)[0].read(t.ARM_STATUS).activity == "home"
        pressed, allowed = guest.publisher(t.RESET), operator.publisher(t.RESET)
        begin(router, guest, operator, arm)
        pressed.send(Reset(header(1), "guest"), 1)
        with pytest.raises(BusError, match="gave no answer"):
            guest.request(t.SNAPSHOT, SnapshotRequest("curious"), 0.5)
        allowed.send(Reset(header(1), "operator"), 1)
        assert [item.read(t.RESET).source for item in heard(arm, 1)] == ["operator"]
        assert recorder.inbox.poll() is None


def test_a_recorder_answers_an_operator(router: ZenohRouter) -> None:
    with ZenohBus("recorder", router.point) as recorder, ZenohBus("operator", router.point) as operator:
        recorder.serve(t.SNAPSHOT)
        begin(router, recorder, operator)

        def answer() -> None:
            request = recorder.inbox.receive(PATIENCE)
            assert not isinstance(request, Envelope)
            assert request is not None
            request.reply(SnapshotReply("/a", 1, request.read(t.SNAPSHOT).reason))

        thread = threading.Thread(target=answer)
        thread.start()
        assert operator.request(t.SNAPSHOT, SnapshotRequest("why"), PATIENCE).error == "why"
        thread.join()


def test_a_player_speaks_for_all_on_its_own_router_alone(keys: Path) -> None:
    for playback in (False, True):
        with (
            ZenohRouter(MeetingPoint(unused_port(), keys=keys), playback=playback) as router,
            ZenohBus("player", router.point) as player,
            ZenohBus("launcher", router.point) as launcher,
            ZenohBus("viewer", router.point) as viewer,
        ):
            viewer.subscribe(t.PERMIT, t.SESSION)
            played, own = player.publisher(t.PERMIT), launcher.publisher(t.RESET)
            viewer.subscribe(t.RESET)
            begin(router, player, launcher, viewer)
            played.send(permit("played"), 1)
            player.settle()
            own.send(Reset(header(1), "real"), 1)
            topics = [item.topic for item in heard(viewer, 1 + playback)]
            assert topics == [t.PERMIT.name, t.RESET.name][not playback :]


def test_the_map_says_who_may_publish_what() -> None:
    assert [role for role in CLIENTS if may_publish(role, t.PERMIT)] == ["interlock"]
    assert [role for role in CLIENTS if may_publish(role, t.ATTEMPT)] == ["arm"]
    assert not [topic.name for topic in t.topics().values() if may_publish(GUEST, topic)]
    named = {topic.publisher for topic in t.topics().values()} | {service.server for service in t.services().values()}
    assert named - {"any", "clerk"} <= set(ROLES)


def listening(pids: Iterable[int]) -> set[tuple[str, int]]:
    """Addresses and ports that processes listen on: IPv4 in words, IPv6 as the kernel writes it."""
    sockets = set()
    for pid in pids:
        with contextlib.suppress(OSError):  # ended meanwhile
            for link in Path(f"/proc/{pid}/fd").iterdir():
                with contextlib.suppress(OSError):
                    sockets.add(link.readlink().name)
    found = set()
    for name in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]:
            _, local, _, state, *_, inode = line.split()[:10]
            if f"socket:[{inode}]" in sockets and (state == "0A" or name.startswith("udp")):
                address, port = local.split(":")
                words = socket.inet_ntoa(bytes.fromhex(address)[::-1]) if len(address) == 8 else address
                found.add((words, int(port, 16)))
    return found


def decisions_of(path: Path) -> list[tuple[object, ...]]:
    with open_log(path) as log:
        assert log.metadata["palpate.recording"]["lost"] == "0"
        return [
            (stamp, item)
            for topic in (t.CANDIDATE, t.ATTEMPT, t.SEARCH_RESULT)
            for stamp, item in log.read(topic)  # type: ignore[var-annotated, attr-defined]
        ]


def secrets(keys: Path) -> list[bytes]:
    """What the private keys are, as text and as bytes."""
    found = []
    for path in keys.glob("*.key"):
        text = "".join(line for line in path.read_text().splitlines() if not line.startswith("-"))
        found += [text.encode()[40:80], base64.b64decode(text)[36:68]]  # 32 bytes: the number itself
    return found


@pytest.mark.parametrize("cell", config.shipped())
def test_a_cell_listens_on_loopback_alone(cell: str) -> None:
    port = unused_port()
    with ZenohRouter(replace(config.load(cell).meeting_point, port=port)) as router, ZenohBus("arm", router.point):
        assert listening([os.getpid()]) == {("127.0.0.1", port)}


def test_a_session_with_security(tmp_path: Path, keys: Path) -> None:
    palpate = Palpate(tmp_path)
    shutil.copytree(keys, tmp_path / "keys")
    cell = write_cell(tmp_path, cell_text(holes=1) + '\n[bus]\nsecurity = "mtls"\n')
    process = palpate.start("launch", cell, "--port", str(palpate.port))
    seen: set[tuple[str, int]] = set()
    while process.poll() is None:
        seen |= listening(palpate.processes())
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.2)
    out, err = process.communicate()
    assert process.returncode == 0, (out, err)
    assert seen == {("127.0.0.1", palpate.port)}
    here = tmp_path / "here"
    local = run_in_process(Order(config.load(str(cell)), here / "logs")).log
    (log_path,) = palpate.logs()
    assert decisions_of(log_path) == decisions_of(local)
    with open_log(log_path) as log:
        said = [message.payload for message in log.messages()]
        said += [*log.attachments.values(), json.dumps(log.metadata).encode(), out.encode(), err.encode()]
        assert {topic.name for topic in log.topics} >= {t.PERMIT.name, t.TRUTH.name, t.TF_STATIC.name, t.ROSOUT.name}
    assert len(secrets(tmp_path / "keys")) == 2 * (len(ROLES) + 1)
    assert not [secret for secret in secrets(tmp_path / "keys") if any(secret in text for text in said)]
    assert not any(str(tmp_path / "keys").encode() in text for text in said)


@pytest.mark.parametrize(
    ("bus", "said"),
    [
        ('listen = "192.168.0.5"', 'bus.listen: 192.168.0.5 is open to the network; .*security = "mtls"'),
        ('listen = ["127.0.0.1", "0.0.0.0"]', "bus.listen: 0.0.0.0 is open"),
        ('listen = "cell-7.plant"', "bus.listen: cell-7.plant is open"),
        ('security = "tls"', "bus.security: "),
        ("listen = []", "bus.listen"),
    ],
)
def test_a_cell_does_not_open_to_a_network_by_mistake(tmp_path: Path, bus: str, said: str) -> None:
    with pytest.raises(CellError, match=said):
        config.load(str(write_cell(tmp_path, cell_text(extra=f"\n[bus]\n{bus}\n"))))


def test_a_cell_file_says_where_its_cell_is_joined(tmp_path: Path) -> None:
    text = cell_text(extra='\n[bus]\nlisten = ["192.168.0.5", "::1"]\nsecurity = "mtls"\nport = 7450\n')
    point = config.meeting_point(str(write_cell(tmp_path, text)), None)
    assert point == MeetingPoint(7450, 0, ("192.168.0.5", "::1"), tmp_path / "keys")
    assert [point.endpoint(host) for host in point.hosts] == ["tls/192.168.0.5:7450", "tls/[::1]:7450"]
    assert config.meeting_point(None, None) == MeetingPoint(7447)


def test_keys_are_for_their_owner_and_are_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "keys"
    assert main(["keys", str(folder), "--host", "192.168.0.5"]) == 0
    assert {path.name for path in folder.iterdir()} == {
        f"{name}.{ending}" for name in (*ROLES, "ca") for ending in ("pem", "key")
    }
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in folder.iterdir())
    before = {path: path.read_bytes() for path in folder.iterdir()}
    capsys.readouterr()
    assert main(["keys", str(folder)]) == 2
    assert "is there already; --renew" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in folder.iterdir()}
    assert main(["keys", str(folder), "--renew", "--role", "router", "--host", "cell-7"]) == 0
    changed = {path.name for path in folder.iterdir() if before.get(path) != path.read_bytes()}
    assert changed == {"router.pem", "router.key"}
    credentials(folder, "router", ["192.168.0.5", "cell-7", "0.0.0.0"])
    with pytest.raises(InputError, match=r"does not name 10\.0\.0\.1; 'palpate keys .* --host 10\.0\.0\.1' adds it"):
        credentials(folder, "router", ["10.0.0.1"])
    assert main(["keys", str(folder), "--role", "gest"]) == 2
    assert "did you mean 'guest'" in capsys.readouterr().err
    (folder / "ca.key").unlink()
    assert main(["keys", str(folder), "--renew"]) == 2
    assert "ca.key is missing" in capsys.readouterr().err


def test_keys_that_are_of_no_use_are_told_in_one_line(tmp_path: Path, keys: Path) -> None:
    for name in ("ca.pem", "arm.pem", "arm.key"):
        shutil.copy(keys / name, tmp_path)
    credentials(tmp_path, "arm")
    with pytest.raises(InputError, match=r"strategy\.pem is missing; 'palpate keys .*' makes"):
        credentials(tmp_path, "strategy")
    (tmp_path / "arm.key").chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        ZenohBus("arm", MeetingPoint(unused_port(), keys=tmp_path))
    (tmp_path / "arm.pem").write_text("no certificate")
    with pytest.raises(InputError, match=r"arm\.pem is no certificate"):
        credentials(tmp_path, "arm")
    make_keys(tmp_path / "old", ["arm"], days=0)
    with pytest.raises(InputError, match=r"arm\.pem was valid until .*--renew"):
        credentials(tmp_path / "old", "arm")
