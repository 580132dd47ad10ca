"""A controller under attack, on real sockets: it keeps its 500 Hz for the others, and drops offenders with a reason.

A bystander reads RTDE all the time. That it misses no control cycle is counted, not timed: every package carries the
controller's time, and they must be 2 ms apart however the packages travelled.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robots import PATIENCE, Robot

from drivers.ur3e.control_box.box import ControlBox
from drivers.ur3e.control_box.rtde_wire import HEADER, package

PORTS = (29999, 30001, 30002, 30003, 30004)
SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=25)


class Bystander:
    """An honest RTDE client."""

    def __init__(self, host: str) -> None:
        self._link = socket.create_connection((host, 30004), timeout=PATIENCE)
        self._stream = self._link.makefile("rb")
        self.stamps: list[float] = []
        for command, payload in (("V", b"\x00\x02"), ("O", struct.pack(">d", 500.0) + b"timestamp"), ("S", b"")):
            self._link.sendall(package(command, payload))
            self._answer()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _answer(self) -> bytes:
        size, _ = HEADER.unpack(self._stream.read(HEADER.size))
        return self._stream.read(size - HEADER.size)

    def _read(self) -> None:
        try:
            while True:
                self.stamps.append(struct.unpack_from(">d", self._answer(), 1)[0])
        except (OSError, struct.error, ValueError):
            return

    def close(self) -> None:
        self._link.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._stream.close()
        self._link.close()

    def watch(self, cycles: int = 250) -> None:
        """Wait for some more packages, then assert that none has ever been missing."""
        aim = len(self.stamps) + cycles
        waited = threading.Event()
        for _ in range(round(PATIENCE / 0.01)):
            if len(self.stamps) >= aim:
                break
            waited.wait(0.01)
        assert len(self.stamps) >= aim
        gaps = np.diff(self.stamps)
        assert gaps == pytest.approx(0.002, abs=1e-6)


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    with Robot("empty") as made:
        made.look(register, 0, 0)  # makes the controller's process import this module, which takes many cycles
        begun = made.beat
        yield made
        beat = made.beat
        late, cycles = beat.overruns - begun.overruns, beat.cycles - begun.cycles
        print(f"under attack {late} of {cycles} cycles began a cycle late")  # noqa: T201


@pytest.fixture(scope="module")
def bystander(robot: Robot) -> Iterator[Bystander]:
    made = Bystander(robot.host)
    yield made
    made.close()


def connect(robot: Robot, port: int) -> socket.socket:
    return socket.create_connection((robot.host, port), timeout=PATIENCE)


def wait_for_line(robot: Robot, words: str) -> str:
    waited = threading.Event()
    for _ in range(round(PATIENCE / 0.02)):
        found = [line for line in robot.lines if words in line]
        if found:
            return found[-1]
        waited.wait(0.02)
    raise AssertionError(f"no line says {words!r}: {robot.lines[-10:]}")


def send(robot: Robot, port: int, data: bytes) -> None:
    """Send and hang up, whatever becomes of it."""
    with connect(robot, port) as link:
        try:
            link.sendall(data)
            link.shutdown(socket.SHUT_WR)
            while link.recv(65536):
                pass
        except OSError:
            pass


@pytest.mark.parametrize("port", PORTS)
def test_garbage_on_a_port_hurts_nobody(robot: Robot, bystander: Bystander, port: int) -> None:
    noise = np.random.default_rng(port).bytes(200_000)
    send(robot, port, noise)
    bystander.watch()


@SHARED
@given(port=st.sampled_from(PORTS), data=st.binary(max_size=2000))
def test_fuzz(robot: Robot, bystander: Bystander, port: int, data: bytes) -> None:
    send(robot, port, data)
    bystander.watch(5)


@pytest.mark.parametrize(
    ("port", "data", "words"),
    [
        (30004, b"\xff\xffV", "65535 bytes"),
        (30004, b"\x00\x01V", "1 bytes"),
        (30004, package("Z"), "no command"),
        (30004, package("U", b"\x07"), "recipe 7"),
    ],
)
def test_an_offender_is_dropped_with_a_reason(
    robot: Robot, bystander: Bystander, port: int, data: bytes, words: str
) -> None:
    with connect(robot, port) as link:
        link.sendall(data)
        assert link.recv(100) == b""
    wait_for_line(robot, words)
    bystander.watch()


def test_thousands_of_connects(robot: Robot, bystander: Bystander) -> None:
    for number in range(3000):
        try:
            connect(robot, PORTS[number % len(PORTS)]).close()
        except OSError:
            continue
    bystander.watch()
    with connect(robot, 29999) as link:
        assert link.recv(100).startswith(b"Connected: Universal Robots Dashboard Server")


def test_hundreds_that_stay(robot: Robot, bystander: Bystander) -> None:
    links = []
    for _ in range(200):
        links.append(connect(robot, 29999))
    bystander.watch()
    for link in links:
        link.close()
    wait_for_line(robot, "dashboard")
    bystander.watch()


def test_a_client_that_never_reads(robot: Robot, bystander: Bystander) -> None:
    with connect(robot, 30004) as greedy:
        greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        names = b",".join([b"actual_q"] * 100)
        for command, payload in (("V", b"\x00\x02"), ("O", struct.pack(">d", 500.0) + names), ("S", b"")):
            greedy.sendall(package(command, payload))
        bystander.watch(1500)
    with connect(robot, 29999) as silent:
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        silent.setblocking(False)
        asked = 0
        while asked < 5_000_000:
            try:
                asked += silent.send(b"robotmode\n" * 1000)
            except BlockingIOError:
                break
            except OSError:
                break
        bystander.watch()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def spin():\n  while True:\n    x = 1\n  end\nend\n", "infinite loop"),
        ('def grow():\n  s = "aaaaaaaa"\n  while True:\n    s = str_cat(s, s)\n  end\nend\n', "line 4"),
        ("def bomb():\n  thread t():\n    sleep(100)\n  end\n  while True:\n    run t()\n  end\nend\n", "line 6"),
        ("def deep(n=1):\n  def f(n):\n    return f(n + 1)\n  end\n  f(1)\nend\n", "line"),
        ('def other():\n  __import__("os").system("true")\nend\n', "line 2"),
        ('def other():\n  open("/etc/passwd")\nend\n', "line 2"),
        ('def other():\n  eval("1")\nend\n', "line 2"),
    ],
)
def test_a_hostile_program_is_stopped_with_its_line(robot: Robot, bystander: Bystander, text: str, words: str) -> None:
    before = len(robot.lines)
    with connect(robot, 30003) as link:
        link.sendall(text.encode())
        waited = threading.Event()
        for _ in range(round(PATIENCE / 0.02)):
            found = [line for line in robot.lines[before:] if words in line]
            if found:
                break
            waited.wait(0.02)
        assert found, robot.lines[before:]
    bystander.watch()


def test_a_program_of_ten_megabytes(robot: Robot, bystander: Bystander) -> None:
    body = b'  textmsg("abcdefghijklmnopqrstuvwxyz")\n' * 260_000
    send(robot, 30002, b"def big():\n" + body + b"end\n")
    bystander.watch()
    wait_for_line(robot, "secondary")


def test_after_all_that_it_still_works(robot: Robot, bystander: Bystander) -> None:
    with connect(robot, 30003) as link:
        link.sendall(b"def fine():\n  write_output_integer_register(5, 77)\nend\n")
        robot.until(register, 5, 77)
    bystander.watch()
    assert robot.beat.cycles > 1000


def register(box: ControlBox, index: int, value: int) -> bool:
    return box.registers.output_int[index] == value
