"""What a session looks like in Rerun: every part of the scene is there, in session time, and nothing fails to show."""

import contextlib
import io
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import log_samples
import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from runtime import messages as m
from runtime import topics as t
from runtime.bus import Envelope
from runtime.component import COMPONENTS
from runtime.errors import InputError, LogError
from runtime.local_bus import LocalExchange
from runtime.log_file import open_log
from runtime.view_board import board_of
from runtime.viewer import Viewer, check, view

ENTITIES = {
    "/robot/ur3e/visual_geometries/gripper/visual_0",
    "/tf/shoulder_link",
    "/tf/gripper",
    "/cell/board/plate",
    "/cell/board/holes",
    "/cell/board/current",
    "/cell/board/parts/1/body",
    "/cell/board/parts/2/pins",
    "/cell/held",
    "/cell/held/part/body",
    "/hole/attempts",
    "/hole/next",
    "/hole/belief",
    "/hole/earlier_seats",
    "/hole/true",
    "/hole/grid/search_radius",
    "/plots/force/F",
    "/plots/force/Fz",
    "/plots/attempts/this_search",
    "/plots/total/attempts",
    "/plots/duration/search",
    "/interlock",
    "/arm",
    "/session",
    "/log/assembly",
    "/log/interlock",
}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    log_samples.record(path)
    return path


@pytest.fixture(scope="module")
def rrd(log: Path) -> Path:
    file = log.with_suffix(".rrd")
    said: list[str] = []
    view(log, "save", file, said.append)
    assert said == [f"open it with: rerun {file}"]
    return file


def rows(rrd: Path, entity: str, component: str) -> list[tuple[float, Any]]:
    """Session times [s] and values of one component of an entity, in order of time."""
    found: list[tuple[Any, Any]] = []
    for chunk in RrdReader(rrd).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            columns = chunk.to_record_batch().to_pydict()
            name = next((column for column in columns if column.endswith(component)), None)
            if name is not None:
                found += zip(columns["session_time"], columns[name], strict=True)
    return sorted(((when.total_seconds(), value) for when, value in found), key=lambda row: row[0])


def test_every_part_of_the_scene_is_there(rrd: Path) -> None:
    assert {chunk.entity_path for chunk in RrdReader(rrd).stream()} >= ENTITIES


def test_session_time_is_the_only_timeline(rrd: Path) -> None:
    moving = [chunk for chunk in RrdReader(rrd).stream() if not chunk.is_static and chunk.entity_path in ENTITIES]
    assert {name for chunk in moving for name in chunk.timeline_names} == {"session_time"}


def test_attempts_and_states_are_shown_when_they_happened(log: Path, rrd: Path) -> None:
    with open_log(log) as recorded:
        attempts = [(stamp / 1e9, [float(attempt.number)]) for stamp, attempt in recorded.read(t.ATTEMPT)]
        permits = [(stamp / 1e9, permit.granted) for stamp, permit in recorded.read(t.PERMIT)]
    shown = [row for row in rows(rrd, "/plots/attempts/this_search", "scalars") if row[1] != [0.0]]
    assert [value for _, value in shown] == [value for _, value in attempts]
    assert [when for when, _ in shown] == pytest.approx([when for when, _ in attempts])
    changes = [row for row, before in zip(permits, [(0.0, None), *permits], strict=False) if row[1] != before[1]]
    lane = rows(rrd, "/interlock", "state")
    assert [when for when, _ in lane] == pytest.approx([when for when, _ in changes])
    assert [value == ["permitted"] for _, value in lane] == [granted for _, granted in changes]


def test_forces_are_drawn_from_every_control_cycle_where_there_is_a_trace(tmp_path: Path) -> None:
    period = 2_000_000  # [ns]
    wrenches = np.random.default_rng(1).normal(size=(200, 6))

    def traced() -> Iterator[log_samples.Sent]:
        for start in range(0, 200, 50):
            rows_of = wrenches[start : start + 50]
            stamp = (start + 49) * period
            nothing = np.zeros(300)
            first = m.header(start * period, "tool0")
            yield "arm", t.TRACE, m.ControlTrace(first, 0.002, nothing, nothing, rows_of.ravel()), stamp
        still = m.Wrench(m.Vector3(0.0, 0.0, 0.0), m.Vector3(0.0, 0.0, 0.0))
        yield "arm", t.WRENCH, m.WrenchStamped(m.header(200 * period), still), 200 * period

    path, file = tmp_path / "traced.mcap", tmp_path / "traced.rrd"
    log_samples.record(path, traced())
    view(path, "save", file, lambda _said: None)
    sizes = np.linalg.norm(wrenches[:, :3], axis=1)
    strongest = [start + int(sizes[start : start + 10].argmax()) for start in range(0, 200, 10)]
    shown = rows(file, "/plots/force/F", "scalars")
    assert [when for when, _ in shown] == pytest.approx([row * period / 1e9 for row in strongest])
    assert [value[0] for _, value in shown] == pytest.approx(sizes[strongest].tolist())


def test_streams_are_sampled_but_no_contact_is_missed(log: Path, rrd: Path) -> None:
    with open_log(log) as recorded:
        forces = [
            math.hypot(item.wrench.force.x, item.wrench.force.y, item.wrench.force.z)
            for _, item in recorded.read(t.WRENCH)
        ]
        seconds = (recorded.end - recorded.start) / 1e9
    shown = rows(rrd, "/plots/force/F", "scalars")
    assert 15 * seconds < len(shown) < 25 * seconds
    assert max(value[0] for _, value in shown) == pytest.approx(max(forces))
    poses = rows(rrd, "/tf/wrist_3_link", "translation")
    assert 15 * seconds < len(poses) < 25 * seconds


def test_inserted_parts_stand_where_they_went_in(log: Path, rrd: Path) -> None:
    with open_log(log) as recorded:
        [goal, _] = [goal for _, goal in recorded.read(t.SEARCH_GOAL)]
        [result, _] = [result for _, result in recorded.read(t.SEARCH_RESULT)]
    [(when, pins)] = rows(rrd, "/cell/board/parts/1/pins", "centers")
    p, part = goal.nominal.position, COMPONENTS["igbt"]
    tips = p.z - part.depth
    # the part hangs tool down: its y axis and its z axis are mirrored
    expected = [
        [p.x + result.seated_x + pin.x, p.y + result.seated_y - pin.y, tips + pin.length / 2] for pin in part.pins
    ]
    assert np.array(pins) == pytest.approx(np.array(expected), abs=1e-7)
    assert when == pytest.approx(m.nanoseconds_of(result.header.stamp) / 1e9)


def test_without_the_settings_the_goals_tell_the_board(tmp_path: Path, log: Path) -> None:
    path = tmp_path / "bare.mcap"
    log_samples.record(path, metadata={})
    view(path, "save", tmp_path / "bare.rrd", lambda _: None)
    assert {chunk.entity_path for chunk in RrdReader(tmp_path / "bare.rrd").stream()} >= ENTITIES
    with open_log(log) as recorded:
        board = board_of([goal for _, goal in recorded.read(t.SEARCH_GOAL)])
    holes = {hole.name: (board.x + hole.x, board.y + hole.y, hole.orientation) for hole in board.holes}
    for name in ("1", "2"):
        hole = log_samples.BOARD.hole(name)
        assert holes[name] == pytest.approx((log_samples.BOARD.x + hole.x, log_samples.BOARD.y + hole.y, 0.0))


def test_a_log_without_a_search_can_be_viewed(tmp_path: Path) -> None:
    log_samples.record(tmp_path / "short.mcap", log_samples.messages(()), metadata={})
    view(tmp_path / "short.mcap", "save", tmp_path / "short.rrd", lambda _: None)
    assert "/interlock" in {chunk.entity_path for chunk in RrdReader(tmp_path / "short.rrd").stream()}


def test_a_live_view_shows_what_a_finished_log_shows(tmp_path: Path, rrd: Path) -> None:
    file = tmp_path / "live.rrd"
    exchange = LocalExchange()
    with live(Viewer("save", str(file)), exchange):
        log_samples.publish(exchange, log_samples.messages())
    assert {chunk.entity_path for chunk in RrdReader(file).stream()} >= ENTITIES
    for entity, component in (("/plots/force/F", "scalars"), ("/interlock", "state"), ("/hole/attempts", "positions")):
        assert rows(file, entity, component) == rows(rrd, entity, component)


@contextlib.contextmanager
def live(viewer: Viewer, exchange: LocalExchange) -> Iterator[None]:
    """A running viewer on an exchange."""
    surroundings = log_samples.context(exchange, "viewer")
    failures: list[BaseException] = []

    def run() -> None:
        try:
            viewer.run(surroundings)
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    while exchange.wait_for({"viewer"}, 0.1) and thread.is_alive():
        pass
    try:
        yield
    finally:
        surroundings.stop()
        thread.join()
    assert not failures


def test_the_browser_is_served_on_loopback_only_and_until_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home(tmp_path, monkeypatch)
    before, exchange = listening(), LocalExchange()
    listener = log_samples.context(exchange, "recorder").bus
    listener.subscribe(t.ROSOUT)
    session = log_samples.context(exchange, "launcher").bus.publisher(t.SESSION)
    with live(Viewer("web"), exchange):
        session.send(m.SessionState(m.header(0), "test", int(m.Phase.STARTING), ""), 0)
        item = listener.inbox.receive(30.0)
        assert isinstance(item, Envelope)
        spoken = item.read(t.ROSOUT).msg
        with urllib.request.urlopen(spoken.split()[1], timeout=30) as page:
            assert page.status == 200
        opened = listening() - before
        assert {address for address, _ in opened} == {"0100007F"}
        port = int(spoken.split("127.0.0.1:")[1].split("/")[0])
        assert port in {number for _, number in opened}
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), timeout=5)


def listening() -> set[tuple[str, int]]:
    """Addresses and ports that are listened on, as the kernel writes them."""
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    ends = [line[1].split(":") for line in lines if line[3] == "0A"]
    return {(address, int(port, 16)) for address, port in ends}


def home(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give Rerun a home where it counts and sends nothing."""
    for name, value in log_samples.rerun_home(folder).items():
        monkeypatch.setenv(name, value)


def test_no_display_ends_with_the_way_out(monkeypatch: pytest.MonkeyPatch, log: Path) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(InputError, match=r"--rerun web.*--rerun save"):
        view(log, "spawn")
    monkeypatch.setenv("DISPLAY", ":0")
    check("spawn", None)


def test_what_cannot_be_shown_or_written_is_refused(tmp_path: Path, log: Path) -> None:
    with pytest.raises(LogError, match="no log"):
        view(tmp_path / "none.mcap", "save", tmp_path / "a.rrd")
    with pytest.raises(InputError, match="needs the path"):
        view(log, "save")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        view(log, "save", tmp_path / "file" / "a.rrd")


def vulkan() -> bool:
    """Whether a Vulkan driver is installed."""
    folders = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"), Path("/usr/local/share/vulkan/icd.d")]
    return bool(os.environ.get("VK_ICD_FILENAMES")) or any(any(folder.glob("*.json")) for folder in folders)


@pytest.mark.skipif(not vulkan(), reason="no Vulkan driver; Debian has one in mesa-vulkan-drivers")
def test_rerun_shows_every_view_without_an_error(tmp_path: Path, rrd: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    environment = {**os.environ, **log_samples.rerun_home(tmp_path), "RUST_LOG": "error"}
    process = subprocess.Popen([*command, "--window-size", "900x640"], start_new_session=True, env=environment)
    try:
        client = connected(port, process)
        client.open(str(rrd))
        client.set_time("session_time", duration=3.0, play_state="paused")
        image = painted(client)
        views = client.get_state().views
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert len(views) == 9
    assert {(view.name, report.summary) for view in views for report in view.reports} == set()
    assert image.std() > 30.0


def connected(port: int, process: subprocess.Popen[bytes]) -> ViewerClient:
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
    pytest.skip("Rerun does not start without a window here")


def painted(client: ViewerClient) -> Any:
    """The arm's half of the picture once everything is loaded, as brightness (height, width)."""
    deadline = time.monotonic() + 60
    arm = np.zeros((1, 1))
    while time.monotonic() < deadline:
        with contextlib.suppress(Exception):  # a busy machine paints slowly, and the viewer gives up waiting
            loaded = not client.get_state().loading
            picture = np.asarray(Image.open(io.BytesIO(client.take_screenshot())).convert("L"), dtype=float)
            height, width = picture.shape
            arm = picture[height // 10 : height // 2, : width // 2]
            if loaded and arm.std() > 30.0:
                break
    return arm
