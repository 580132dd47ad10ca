"""How punctual the simulated controller is, seen from outside: two real clients in processes of their own.

One reads RTDE at 500 Hz and notes when each package arrives. The other is ur-rtde's control interface, which asks one
question after another through the uploaded program. The controller runs as `palpate robot` runs it.
"""

from __future__ import annotations

import json
import multiprocessing
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from drivers.ur3e.control_box.rtde_wire import HEADER, LAYOUT, package
from drivers.ur3e.parameters import CYCLE
from runtime.clock import Stopwatch, pause
from runtime.errors import InputError, SessionError
from runtime.plugin import Punctuality

_HOST = "127.0.0.1"
_ON_TIME = 1e-3  # [s] after the moment at which a package was due
_SETTLE = 2.0  # [s] at the beginning that are not counted: the clients connect, a program is compiled
_TIMEOUT = 60.0  # [s] for anything to start
# What ur-rtde's receive interface asks for by default, less the registers.
_NAMES = (
    "timestamp,target_q,target_qd,target_qdd,target_current,target_moment,actual_q,actual_qd,actual_current,"
    "joint_control_output,actual_TCP_pose,actual_TCP_speed,actual_TCP_force,target_TCP_pose,target_TCP_speed,"
    "actual_digital_input_bits,joint_temperatures,actual_execution_time,robot_mode,joint_mode,safety_mode,"
    "actual_tool_accelerometer,speed_scaling,target_speed_fraction,actual_momentum,actual_main_voltage,"
    "actual_robot_voltage,actual_robot_current,actual_joint_voltage,actual_digital_output_bits,runtime_state,"
    "standard_analog_input0,standard_analog_input1,standard_analog_output0,standard_analog_output1,"
    "robot_status_bits,safety_status_bits,ft_raw_wrench,payload,payload_cog,payload_inertia"
)


def punctuality(module: str, order: dict[str, Any], seconds: float) -> Punctuality:
    """Run controller and clients for a while. Raises InputError if the ports are taken, SessionError if one fails."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(json.dumps({**order, "host": _HOST}) + "\n")
        process.stdin.flush()
        first = json.loads(process.stdout.readline() or "{}")
        if "ports" not in first:
            kind = InputError if first.get("wrong_input") else SessionError
            raise kind(first.get("error", "the controller did not start"))
        arrivals, asked = _clients(seconds)
        process.stdin.close()
        last = [line for line in map(json.loads, process.stdout) if "end" in line]
    finally:
        process.kill()
        process.wait()
    if not last:
        raise SessionError("the controller ended without a word")
    stamps, times = np.array(arrivals).T
    late = (times - times[0]) - (stamps - stamps[0])
    late -= late.min()
    return Punctuality(
        packages=len(times),
        missing=round((stamps[-1] - stamps[0]) / CYCLE) + 1 - len(times),
        on_time_share=float((late <= _ON_TIME).mean()),
        gap_max=float(np.diff(times).max()),
        commands=len(asked),
        command_p50=float(np.percentile(asked, 50)),
        command_p99=float(np.percentile(asked, 99)),
        cycles=last[-1]["end"]["cycles"],
        overruns=last[-1]["end"]["overruns"],
    )


def _clients(seconds: float) -> tuple[list[tuple[float, float]], list[float]]:
    """Controller times and arrival times [s] of packages, and round trips [s] of commands."""
    context = multiprocessing.get_context("spawn")
    links = []
    for work in (_read, _ask):
        mine, other = context.Pipe(duplex=False)
        client = context.Process(target=_client, args=(work, other, seconds), daemon=True)
        client.start()
        links.append((client, mine))
    results = []
    for client, link in links:
        if not link.poll(seconds + _SETTLE + _TIMEOUT):
            raise SessionError("a client of the bench did not answer")
        value, error = link.recv()
        client.join()
        if error:
            raise SessionError(error)
        results.append(value)
    return results[0], results[1]


def _client(work: Callable[[float], Any], link: Connection, seconds: float) -> None:
    try:
        link.send((work(seconds), ""))
    except Exception as error:
        link.send((None, f"a client of the bench failed: {error}"))


def _read(seconds: float) -> list[tuple[float, float]]:
    """Note when the packages arrive."""
    watch = Stopwatch()
    with socket.create_connection((_HOST, 30004), timeout=_TIMEOUT) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream = link.makefile("rb")

        def answer() -> bytes:
            size, _ = HEADER.unpack(stream.read(HEADER.size))
            return stream.read(size - HEADER.size)

        link.sendall(package("V", struct.pack(">H", 2)))
        answer()
        link.sendall(package("O", struct.pack(">d", 1 / CYCLE) + _NAMES.encode()))
        types = answer()[1:].decode().split(",")
        if not set(types) <= set(LAYOUT):
            raise SessionError(f"fields refused: {types}")
        link.sendall(package("S"))
        answer()
        found = []
        end = watch.seconds + _SETTLE + seconds
        begin = watch.seconds + _SETTLE
        while (now := watch.seconds) < end:
            (stamp,) = struct.unpack_from(">d", answer(), 1)
            now = watch.seconds
            if now >= begin:
                found.append((stamp, now))
        return found


def _ask(seconds: float) -> list[float]:
    """Ask one question after another through ur-rtde."""
    try:
        from rtde_control import RTDEControlInterface
    except ImportError:
        raise InputError("the bench needs ur-rtde: pip install 'palpate[ur]'") from None
    control = RTDEControlInterface(_HOST)
    watch = Stopwatch()
    found = []
    while watch.seconds < seconds:
        one = Stopwatch()
        control.isSteady()
        found.append(one.seconds)
        pause(5e-3)
    control.stopScript()
    return found
