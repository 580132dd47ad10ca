"""`palpate robot` as a user has it: a process, its words, its ports, its end."""

from __future__ import annotations

import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from cells import Palpate
from robots import PATIENCE, loopback

from runtime.messages import Ossd, header, stamp_of
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.topics import OSSD


@pytest.fixture
def palpate(tmp_path: Path) -> Palpate:
    return Palpate(tmp_path)


@pytest.fixture
def host() -> str:
    return loopback()


def lines_of(process: subprocess.Popen[str]) -> Iterator[str]:
    assert process.stdout is not None
    return (line.rstrip("\n") for line in process.stdout)


def wait_for(process: subprocess.Popen[str], words: str) -> list[str]:
    """Everything that is said up to a line with these words."""
    seen = []
    for line in lines_of(process):
        seen.append(line)
        if words in line:
            return seen
    raise AssertionError(f"never said {words!r}: {seen}")


def start(palpate: Palpate, *arguments: str) -> subprocess.Popen[str]:
    process = palpate.start("robot", "--rerun", "off", *arguments, stdin=subprocess.PIPE)
    wait_for(process, "Ctrl-C ends")
    return process


def say(process: subprocess.Popen[str], text: str) -> None:
    assert process.stdin is not None
    process.stdin.write(text + "\n")
    process.stdin.flush()


def wait_until_nothing_is_left(palpate: Palpate) -> None:
    deadline = time.monotonic() + PATIENCE
    while palpate.processes():
        assert time.monotonic() < deadline, palpate.processes()


def end(process: subprocess.Popen[str], palpate: Palpate) -> int:
    code = process.wait(PATIENCE)
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            stream.close()
    wait_until_nothing_is_left(palpate)
    return code


def ask(host: str, question: str) -> str:
    with socket.create_connection((host, 29999), timeout=PATIENCE) as link, link.makefile("rw", newline="\n") as talk:
        assert talk.readline() == "Connected: Universal Robots Dashboard Server\n"
        talk.write(question + "\n")
        talk.flush()
        return talk.readline().rstrip("\n")


def test_it_announces_its_ports_and_obeys_the_panel(palpate: Palpate, host: str) -> None:
    process = palpate.start("robot", "--rerun", "off", "--host", host, "--polyscope", "5.12", stdin=subprocess.PIPE)
    said = "\n".join(wait_for(process, "Ctrl-C ends"))
    assert f"PolyScope 5.12.0.1101319, scene igbt, on {host}" in said
    for port in ("29999", "30001", "30002", "30003", "30004"):
        assert port in said
    assert "\x1b" not in said
    assert ask(host, "PolyscopeVersion").startswith("URSoftware 5.12.0.")
    assert ask(host, "safetymode") == "Safetymode: NORMAL"
    say(process, "safeguard open")
    wait_for(process, "safeguard input open")
    wait_for(process, "safety mode safeguard stop")
    assert ask(host, "safetymode") == "Safetymode: SAFEGUARD_STOP"
    say(process, "safegard close")
    assert "did you mean 'safeguard'" in wait_for(process, "no such action")[-1]
    say(process, "quit")
    assert "late cycles" in wait_for(process, "ended after")[-1]
    assert end(process, palpate) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_and_leaves_nothing(palpate: Palpate, host: str, number: signal.Signals) -> None:
    process = start(palpate, "--host", host)
    process.send_signal(number)
    assert end(process, palpate) == 130
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((host, 30004), timeout=5.0)


def test_it_ends_with_whoever_started_it(palpate: Palpate, host: str) -> None:
    process = start(palpate, "--host", host)
    process.kill()
    assert end(process, palpate) == -signal.SIGKILL


def test_a_dashboard_client_can_shut_it_down(palpate: Palpate, host: str) -> None:
    process = start(palpate, "--host", host)
    assert ask(host, "shutdown") == "Shutting down"
    assert end(process, palpate) == 0


def test_ports_that_are_taken_are_named(palpate: Palpate, host: str) -> None:
    first = start(palpate, "--host", host)
    second = palpate.run("robot", "--rerun", "off", "--host", host)
    assert second.returncode == 2
    assert "port 29999 (dashboard)" in second.stderr
    assert "is taken" in second.stderr
    assert len(second.stderr.strip().splitlines()) == 1
    first.send_signal(signal.SIGINT)
    end(first, palpate)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scene", "kitchen"), "no cell file 'kitchen'"),
        (("--host", "robot.local"), "no IP address"),
        (("--host", "198.51.100.7"), "198.51.100.7"),
        (("--polyscope", "10.7"), "no PolyScope '10.7'"),
        (("--programs", "nowhere"), "nowhere is no folder"),
        (("--rerun", "spawn"), "needs a display"),
    ],
)
def test_wrong_input_is_one_line_and_code_2(palpate: Palpate, arguments: tuple[str, ...], words: str) -> None:
    options = arguments if "--rerun" in arguments else ("--rerun", "off", *arguments)
    ended = palpate.run("robot", *options)
    assert ended.returncode == 2, ended.stderr
    assert words in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1
    assert "Traceback" not in ended.stderr
    wait_until_nothing_is_left(palpate)


def test_listening_beyond_loopback_is_warned_of(palpate: Palpate) -> None:
    ended = palpate.run("robot", "--rerun", "off", "--host", "198.51.100.7")
    assert "warning: listening on 198.51.100.7" in ended.stdout


def test_a_cell_s_light_curtain_is_its_safeguard_input(palpate: Palpate, host: str) -> None:
    def tell(clear: bool, wanted: str) -> None:
        """Let the curtain speak, as it does all the time, until the controller is in a safety mode."""
        deadline = time.monotonic() + PATIENCE
        while ask(host, "safetymode") != f"Safetymode: {wanted}":
            assert time.monotonic() < deadline
            curtain.send(Ossd(header(0), clear, clear, stamp_of(0)), 0)

    process = start(palpate, "--host", host, "--curtain", str(palpate.port))
    with ZenohRouter(palpate.port), ZenohBus("light_curtain", palpate.port) as bus:
        curtain = bus.publisher(OSSD)
        bus.announce()
        tell(False, "SAFEGUARD_STOP")
        tell(True, "NORMAL")
        tell(False, "SAFEGUARD_STOP")
    wait_for(process, "safeguard input closed")  # by the curtain, and again when its cell has gone
    wait_for(process, "safeguard input closed")
    assert ask(host, "safetymode") == "Safetymode: NORMAL"
    say(process, "quit")
    assert end(process, palpate) == 0


def test_a_viewer_follows_it(palpate: Palpate, host: str) -> None:
    process = palpate.start(
        "robot", "--rerun", "save", "--host", host, "--port", str(palpate.port), stdin=subprocess.PIPE
    )
    wait_for(process, "Ctrl-C ends")
    say(process, "push 0 0 -30")
    wait_for(process, "pushing with")
    say(process, "quit")
    assert end(process, palpate) == 0
    assert (palpate.folder / "robot.rrd").stat().st_size > 20_000
