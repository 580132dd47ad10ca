"""The sockets of a control box, with real clients on loopback."""

import resource
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator

import pytest
from control_box_peers import NotingBox

from drivers.ur3e.control_box.dashboard import DashboardConversation
from drivers.ur3e.control_box.peer import Conversation, Peer, PeerError
from drivers.ur3e.control_box.ports import Limits, Ports
from drivers.ur3e.control_box.realtime import RealtimePackage
from drivers.ur3e.control_box.script_port import PrimaryConversation, RealtimeConversation
from runtime.errors import InputError

BOX = NotingBox()


class Echo:
    """Says hello, sends back what it gets, and misbehaves when asked to."""

    def __init__(self, peer: Peer, log: list[str]) -> None:
        self.peer = peer
        self.log = log
        self.cycles = 0

    def opened(self) -> None:
        self.peer.send(b"hello\n")

    def received(self, data: bytes) -> None:
        self.log.append(f"{len(data)} from {self.peer.name}")
        if data == b"protocol\n":
            raise PeerError("speaks another language")
        if data == b"bug\n":
            raise ZeroDivisionError("by nought")
        if data == b"more\n":
            self.peer.send(b"m" * 300_000)
            return
        self.peer.send(data)
        if data == b"bye\n":
            self.peer.close()

    def cycle(self) -> None:
        self.cycles += 1

    def closed(self) -> None:
        self.log.append(f"closed {self.peer.name}")


class House:
    """Ports with a log, and clients that are let go of at the end."""

    def __init__(self, limits: Limits | None = None, **services: Callable[[Peer], Conversation]) -> None:
        self.log: list[str] = []
        self.seen: list[str] = []
        factories = services or {"echo": lambda peer: Echo(peer, self.seen)}
        self.ports = Ports("127.0.0.1", {name: (0, make) for name, make in factories.items()}, self.log.append, limits)
        self.clients: list[socket.socket] = []
        OPEN.append(self)

    def connect(self, name: str = "echo", buffer: int = 0) -> socket.socket:
        client = socket.socket()
        if buffer:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        client.connect(("127.0.0.1", self.ports.number(name)))
        client.settimeout(5.0)
        self.clients.append(client)
        return client

    def turn(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.ports.receive()
            self.ports.cycle()

    def until(self, condition: Callable[[], bool]) -> None:
        """Go on until something has become so; loopback is quick, but not instant."""
        end = time.monotonic() + 10
        while not condition():
            assert time.monotonic() < end, "it has not come about"
            self.turn()

    def read(self, client: socket.socket, size: int) -> bytes:
        """Exactly so many bytes, while the ports go on."""
        data = b""
        client.setblocking(False)
        while len(data) < size:
            self.until(lambda: bool(select.select([client], [], [], 0)[0]))
            part = client.recv(size - len(data))
            if not part:
                break
            data += part
        return data

    def hung_up(self, client: socket.socket) -> bool:
        """Whether the client has been let go of."""
        self.until(lambda: bool(select.select([client], [], [], 0)[0]))
        try:
            return client.recv(1) == b""
        except ConnectionResetError:
            return True


OPEN: list[House] = []


@pytest.fixture(autouse=True)
def shut() -> Iterator[None]:
    yield
    for house in OPEN:
        house.ports.close()
        for client in house.clients:
            client.close()
    OPEN.clear()


@pytest.fixture
def house() -> House:
    return House()


def test_a_conversation_over_a_socket(house: House) -> None:
    client = house.connect()
    assert house.read(client, 6) == b"hello\n"
    client.sendall(b"bonjour")
    assert house.read(client, 7) == b"bonjour"
    assert house.ports.peers("echo") == 1
    client.close()
    house.until(lambda: house.ports.peers("echo") == 0)
    assert house.seen[-1].startswith("closed 127.0.0.1:")
    assert house.log == []


def test_a_conversation_ends_when_all_is_sent(house: House) -> None:
    client = house.connect()
    client.sendall(b"bye\n")
    assert house.read(client, 10) == b"hello\nbye\n"
    assert house.hung_up(client)
    assert house.log == []


def test_who_breaks_the_protocol_is_dropped_and_the_rest_stay(house: House) -> None:
    good, bad, unlucky = house.connect(), house.connect(), house.connect()
    for client in (good, bad, unlucky):
        assert house.read(client, 6) == b"hello\n"
    bad.sendall(b"protocol\n")
    assert house.hung_up(bad)
    unlucky.sendall(b"bug\n")
    assert house.hung_up(unlucky)
    assert "dropped: speaks another language" in house.log[0]
    assert "please report it: ZeroDivisionError: by nought at test_ports.py:" in house.log[1]
    good.sendall(b"still here")
    assert house.read(good, 10) == b"still here"


def test_an_error_at_opening_in_a_cycle_or_at_the_end_stops_nothing() -> None:
    class Faulty(Echo):
        def __init__(self, peer: Peer, where: str) -> None:
            super().__init__(peer, [])
            self.where = where

        def opened(self) -> None:
            self.fail("opened")

        def cycle(self) -> None:
            self.fail("cycle")

        def closed(self) -> None:
            self.fail("closed")

        def fail(self, where: str) -> None:
            if where == self.where:
                raise RuntimeError(where)

    house = House(
        opened=lambda peer: Faulty(peer, "opened"),
        cycle=lambda peer: Faulty(peer, "cycle"),
        closed=lambda peer: Faulty(peer, "closed"),
    )
    for name in ("opened", "cycle", "closed"):
        client = house.connect(name)
        if name == "closed":
            house.until(lambda: house.ports.peers("closed") == 1)
            client.close()
        count = len(house.log)
        house.until(lambda count=count: len(house.log) > count)  # type: ignore[misc]
        assert f"RuntimeError: {name}" in house.log[-1]
        assert house.ports.peers(name) == 0


def test_a_port_that_is_taken_is_named() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        number = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {number} \(dashboard\) of 127\.0\.0\.1 is taken"):
            Ports("127.0.0.1", {"dashboard": (number, lambda peer: Echo(peer, []))}, print)
    with pytest.raises(InputError, match=r"cannot listen on 'no\.such\.host\.invalid'"):
        Ports("no.such.host.invalid", {"a": (0, lambda peer: Echo(peer, []))}, print)


def test_a_port_can_be_opened_again_at_once() -> None:
    first = House()
    number = first.ports.number("echo")
    client = first.connect()
    first.read(client, 6)
    OPEN.remove(first)
    first.ports.close()
    client.close()
    again = Ports("127.0.0.1", {"echo": (number, lambda peer: Echo(peer, []))}, print)
    assert again.number("echo") == number
    again.close()


def test_too_many_clients_are_turned_away() -> None:
    house = House(Limits(peers=3))
    clients = [house.connect() for _ in range(5)]
    house.until(lambda: len(house.log) == 2)
    assert house.ports.peers("echo") == 3
    assert "refused, 3 clients are connected already" in house.log[0]
    assert all(house.hung_up(client) for client in clients[3:])
    assert house.read(clients[0], 6) == b"hello\n"
    clients[0].close()
    house.until(lambda: house.ports.peers("echo") == 2)
    assert house.read(house.connect(), 6) == b"hello\n"


def test_what_a_client_does_not_take_is_kept_and_comes_in_order() -> None:
    house = House(Limits(backlog=50_000_000))
    client = house.connect(buffer=4096)
    assert house.read(client, 6) == b"hello\n"
    for index in range(30):
        count = len(house.seen)
        client.sendall(b"more\n")
        house.until(lambda count=count: len(house.seen) > count)  # type: ignore[misc]
        if index == 14:
            client.sendall(b"middle")
            house.until(lambda count=count: len(house.seen) > count + 1)  # type: ignore[misc]
    data = house.read(client, 30 * 300_000 + 6)
    assert data.index(b"middle") == 15 * 300_000
    client.sendall(b"and on")
    assert house.read(client, 6) == b"and on"


def test_who_never_reads_is_dropped_with_a_word() -> None:
    house = House(Limits(backlog=500_000))
    client = house.connect(buffer=4096)
    house.until(lambda: house.ports.peers("echo") == 1)
    for _ in range(200):
        if house.ports.peers("echo") == 0:
            break
        client.sendall(b"more\n")
        count = len(house.seen)
        house.until(lambda count=count: len(house.seen) > count)  # type: ignore[misc]
    assert house.ports.peers("echo") == 0
    assert "does not read:" in house.log[0]


def test_a_flood_is_read_in_portions_and_starves_nobody() -> None:
    house = House(Limits(read=1000, read_total=3000))
    floods = [house.connect() for _ in range(6)]
    quiet = house.connect()
    house.until(lambda: house.ports.peers("echo") == 7)
    for client in floods:
        client.sendall(b"x" * 50_000)
    quiet.sendall(b"one word")
    house.seen.clear()
    while not any(line.startswith("8 from") for line in house.seen):
        before = len(house.seen)
        house.turn()
        assert sum(int(line.split()[0]) for line in house.seen[before:]) <= 3000
    shares = [sum(line.endswith(str(c.getsockname()[1])) for line in house.seen) for c in floods]
    assert max(shares) - min(shares) <= 1


def test_a_deadline_leaves_the_rest_for_the_next_cycle() -> None:
    house = House()
    clients = [house.connect() for _ in range(4)]
    house.until(lambda: house.ports.peers("echo") == 4)
    for client in clients:
        client.sendall(b"word")
    for count in range(1, 5):
        house.ports.receive(deadline=0.0)
        assert len(house.seen) == count
    assert len(set(house.seen)) == 4


def test_thousands_of_connections_are_survived(house: House) -> None:
    faithful = house.connect()
    assert house.read(faithful, 6) == b"hello\n"
    address = ("127.0.0.1", house.ports.number("echo"))
    for index in range(3000):
        visitor = socket.create_connection(address)
        if index % 3 == 0:
            visitor.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset, not closed
        visitor.close()
        house.turn()
    house.until(lambda: house.ports.peers("echo") == 1)
    faithful.sendall(b"patient")
    assert house.read(faithful, 7) == b"patient"


def test_no_more_descriptors_are_no_end(house: House) -> None:
    client = house.connect()
    assert house.read(client, 6) == b"hello\n"
    waiting = house.connect()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    spare = socket.socket()
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (spare.fileno(), hard))
        house.until(lambda: any("cannot accept" in line for line in house.log))
        client.sendall(b"unharmed")
        assert house.read(client, 8) == b"unharmed"
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        spare.close()
    assert house.read(waiting, 6) == b"hello\n"


def test_the_log_is_not_flooded(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("drivers.ur3e.control_box.ports.time.monotonic", lambda: now)
    house = House(Limits(peers=0, accepts=100))
    for _ in range(25):
        house.connect()
    for _ in range(100_000):
        house.turn()
        if not select.select([house.clients[-1]], [], [], 0)[0]:
            continue
        break
    assert len(house.log) == 10
    now += 1.0
    house.turn()
    assert house.log[10:] == ["15 more lines about clients were left out"]


def test_all_protocols_together_idle_cheaply() -> None:
    package = RealtimePackage(BOX)
    house = House(
        dashboard=lambda peer: DashboardConversation(BOX, peer),
        primary=lambda peer: PrimaryConversation(BOX, peer),
        realtime=lambda peer: RealtimeConversation(BOX, peer, package),
    )
    dashboard, primary, realtime = (house.connect(name) for name in ("dashboard", "primary", "realtime"))
    assert house.read(dashboard, 45) == b"Connected: Universal Robots Dashboard Server\n"
    dashboard.sendall(b"robotmode\n")
    assert house.read(dashboard, 19) == b"Robotmode: RUNNING\n"
    (size,) = struct.unpack(">i", house.read(primary, 4))
    assert house.read(primary, size - 4)[10] == 3
    assert struct.unpack_from(">i", house.read(realtime, 1220)) == (1220,)
    primary.sendall(b"sync()\n")
    house.until(lambda: bool(BOX.programs))
    assert BOX.programs == [("sync()\n", f"primary 127.0.0.1:{primary.getsockname()[1]}")]
