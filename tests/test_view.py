"""What a session looks like in Rerun: every part of the scene is there, in session time, and nothing fails to show."""

import contextlib
import io
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import log_samples
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from rerun.chunk import RrdReader
from rerun.experimental import View, ViewerClient

from runtime import messages as m
from runtime import topics as t
from runtime.bus import Envelope
from runtime.component import COMPONENTS
from runtime.errors import InputError, LogError
from runtime.local_bus import LocalExchange
from runtime.log.file import open_log
from runtime.view.board import board_of
from runtime.view.log import check, view
from runtime.viewer import POSES_KEPT, REFRESH, Viewer

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
    assert saved(log, file) == [f"open it with: rerun {file}"]
    return file


def saved(path: Path, file: Path) -> list[str]:
    """Write a log as an .rrd file; what was said about it."""
    said: list[str] = []
    with open_log(path) as log:
        view(log, save=file, say=said.append)
    return said


def rows(rrd: Path, entity: str, component: str, timeline: str = "session_time") -> list[tuple[Any, Any]]:
    """Times, session times in seconds, and values of one component of an entity, in order of time."""
    found: list[tuple[Any, Any]] = []
    for chunk in RrdReader(rrd).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            columns = chunk.to_record_batch().to_pydict()
            name = next((column for column in columns if column.endswith(component)), None)
            if name is not None:
                found += zip(columns[timeline], columns[name], strict=True)
    if timeline == "session_time":
        found = [(when.total_seconds(), value) for when, value in found]
    return sorted(found, key=lambda row: row[0])


def test_every_part_of_the_scene_is_there(rrd: Path) -> None:
    assert {chunk.entity_path for chunk in RrdReader(rrd).stream()} >= ENTITIES


def test_everything_is_in_session_time_and_counted_by_attempts(rrd: Path) -> None:
    moving = [chunk for chunk in RrdReader(rrd).stream() if not chunk.is_static and chunk.entity_path in ENTITIES]
    assert {tuple(sorted(chunk.timeline_names)) for chunk in moving} == {("attempt", "session_time")}


def test_one_can_step_from_attempt_to_attempt(log: Path, rrd: Path) -> None:
    with open_log(log) as recorded:
        attempts = [(stamp / 1e9, attempt.number) for stamp, attempt in recorded.read(t.ATTEMPT)]
    assert rows(rrd, "/plots/total/attempts", "scalars", "attempt") == [
        (number, [float(number)]) for number in range(1, len(attempts) + 1)
    ]
    # the close-up of a step is that of its attempt, and of a new search before its first attempt there are none yet
    points: dict[int, int] = {}
    for number, places in rows(rrd, "/hole/attempts", "positions", "attempt"):
        points[number] = len(places or ())
    assert points == {number: of_search for number, (_, of_search) in enumerate(attempts, 1)}
    # what is published all the time belongs to the attempt that it was a part of
    arm = zip(
        rows(rrd, "/tf/wrist_3_link", "translation"),
        rows(rrd, "/tf/wrist_3_link", "translation", "attempt"),
        strict=True,
    )
    for (when, _), (number, _) in arm:
        assert number <= 1 + sum(end <= when for end, _ in attempts)
        assert number >= sum(end < when for end, _ in attempts)


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
    saved(path, file)
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
    saved(path, tmp_path / "bare.rrd")
    assert {chunk.entity_path for chunk in RrdReader(tmp_path / "bare.rrd").stream()} >= ENTITIES
    with open_log(log) as recorded:
        board = board_of([goal for _, goal in recorded.read(t.SEARCH_GOAL)])
    holes = {hole.name: (board.x + hole.x, board.y + hole.y, hole.orientation) for hole in board.holes}
    for name in ("1", "2"):
        hole = log_samples.BOARD.hole(name)
        assert holes[name] == pytest.approx((log_samples.BOARD.x + hole.x, log_samples.BOARD.y + hole.y, 0.0))


def test_a_log_without_a_search_can_be_viewed(tmp_path: Path) -> None:
    log_samples.record(tmp_path / "short.mcap", log_samples.messages(()), metadata={})
    saved(tmp_path / "short.mcap", tmp_path / "short.rrd")
    assert "/interlock" in {chunk.entity_path for chunk in RrdReader(tmp_path / "short.rrd").stream()}


def test_a_live_view_shows_what_a_finished_log_shows(tmp_path: Path, rrd: Path) -> None:
    file = tmp_path / "live.rrd"
    exchange = LocalExchange()
    with live(Viewer("save", str(file)), exchange):
        log_samples.publish(exchange, log_samples.messages())
    assert {chunk.entity_path for chunk in RrdReader(file).stream()} >= ENTITIES
    for entity, component in (
        ("/hole/attempts", "positions"), ("/hole/next", "strips"), ("/hole/belief", "strips"), ("/arm", "state"),
        ("/plots/total/attempts", "scalars"), ("/plots/duration/search", "scalars"), ("/log/assembly", "text"),
        ("/log/interlock", "text"), ("/session", "state"),
    ):  # fmt: skip
        assert rows(file, entity, component) == rows(rrd, entity, component)
        if entity != "/arm":  # of what the arm and others said at one time only the live view knows the order
            assert rows(file, entity, component, "attempt") == rows(rrd, entity, component, "attempt")


def test_a_live_view_looks_now_and_then_at_what_is_published_all_the_time(tmp_path: Path, rrd: Path) -> None:
    file = tmp_path / "live.rrd"
    exchange = LocalExchange()
    began = time.monotonic()
    with live(Viewer("save", str(file)), exchange):
        log_samples.publish(exchange, log_samples.messages())
    looks = (time.monotonic() - began) / REFRESH + 2
    shown = rows(file, "/tf/wrist_3_link", "translation")
    assert 0 < len(shown) <= POSES_KEPT * looks
    assert shown[-1][0] > rows(rrd, "/tf/wrist_3_link", "translation")[-1][0] - 0.2


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
        session.send(m.SessionState(m.header(0), "20260101-120000", int(m.Phase.STARTING), ""), 0)
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
    with open_log(log) as recorded, pytest.raises(InputError, match=r"--web.*--save FILE"):
        view(recorded)
    monkeypatch.setenv("DISPLAY", ":0")
    check(web=False, save=None)


def test_what_cannot_be_shown_or_written_is_refused(tmp_path: Path, log: Path) -> None:
    with pytest.raises(InputError, match="does not end in"):
        saved(log, log)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        saved(log, tmp_path / "file" / "a.rrd")
    damaged = bytearray(log.read_bytes())
    damaged[len(damaged) // 3 : len(damaged) // 3 + 2000] = bytes(2000)
    (tmp_path / "damaged.mcap").write_bytes(damaged)
    with pytest.raises(LogError, match="is damaged"):
        saved(tmp_path / "damaged.mcap", tmp_path / "damaged.rrd")


def vulkan() -> bool:
    """Whether a Vulkan driver is installed."""
    folders = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"), Path("/usr/local/share/vulkan/icd.d")]
    return bool(os.environ.get("VK_ICD_FILENAMES")) or any(any(folder.glob("*.json")) for folder in folders)


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerClient]:
    """Rerun's viewer, which paints without a display."""
    if not vulkan():
        pytest.skip("no Vulkan driver; Debian has one in mesa-vulkan-drivers")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "rerun", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    home = log_samples.rerun_home(tmp_path_factory.mktemp("home"))
    environment = {**os.environ, **home, "RUST_LOG": "error"}
    process = subprocess.Popen([*command, "--window-size", "640x480"], start_new_session=True, env=environment)
    try:
        yield connected(port, process)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def connected(port: int, process: subprocess.Popen[bytes]) -> ViewerClient:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
    raise AssertionError(f"Rerun does not start although there is a Vulkan driver: exit code {process.poll()}")


Name = tuple[str, str]  # class and name of a view
VIEWS = 9  # of our layout
Painted = dict[Name, tuple[View, NDArray[np.float64]]]  # views and their brightness (height, width)


def painted(
    window: ViewerClient, file: Path, when: tuple[str, float] | None, until: Callable[[Painted], bool]
) -> Painted:
    """What the views of a file show at a time [s] of a timeline, once that is as it should be or the patience ends."""
    window.open(str(file))
    deadline = time.monotonic() + 40
    found: Painted = {}
    while time.monotonic() < deadline:
        with contextlib.suppress(Exception):  # a busy machine paints slowly, and the viewer gives up waiting
            state = window.get_state()
            if state.loading or file.stem not in (state.active_recording or ""):
                continue
            if when is not None:
                window.set_time(when[0], duration=when[1], play_state="paused")
            for view in state.views:
                found[view.view_class, view.name] = (view, brightness(window.take_screenshot(view.view_id)))
            if until(found):
                break
    return found


def brightness(png: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(png)).convert("L"), dtype=float)


def share(picture: NDArray[np.float64]) -> float:
    """Of the pixels that are bright."""
    return float((picture > 100).mean())


def test_rerun_shows_every_view_without_an_error(tmp_path: Path, window: ViewerClient, rrd: Path) -> None:
    log_samples.record(tmp_path / "empty.mcap", iter(()))
    saved(tmp_path / "empty.mcap", tmp_path / "empty.rrd")
    empty = painted(window, tmp_path / "empty.rrd", None, lambda found: len(found) == VIEWS)

    # without lanes their view explains itself in as many bright letters
    compared = [name for name in empty if name[0] != "StateTimeline"]

    def complaints(found: Painted) -> set[tuple[str, str]]:
        return {(view.name, report.summary) for view, _ in found.values() for report in view.reports}

    def richer(found: Painted) -> bool:
        return all(share(found[name][1]) > share(empty[name][1]) + 0.002 for name in compared)

    full = painted(window, rrd, ("session_time", 3.0), lambda found: richer(found) and not complaints(found))
    assert len(full) == VIEWS
    assert complaints(full) == set()
    assert richer(full)


def test_rerun_shows_the_log_itself_without_us(tmp_path: Path, window: ViewerClient, log: Path) -> None:
    converted = tmp_path / "converted.rrd"
    log_samples.rerun(tmp_path, "mcap", "convert", str(log), "-o", str(converted))
    chunks = [chunk for chunk in RrdReader(converted).stream() if not chunk.entity_path.startswith("/__")]
    columns: dict[str, set[str]] = {}
    for chunk in chunks:
        columns.setdefault(chunk.entity_path, set()).update(chunk.to_record_batch().schema.names)
    links = [name for name in columns if name.startswith("/ur3e/visual_geometries/wrist_3_link/")]
    assert all({"Cylinders3D:radii", "Boxes3D:half_sizes"} & columns[name] for name in links)
    assert links
    assert {"Transform3D:child_frame", "Transform3D:quaternion"} <= columns["/tf"]
    assert "Scalars:scalars" in columns["/arm/peak_force"]
    assert "Scalars:scalars" in columns["/joint_states/position"]
    assert "TextLog:text" in columns["/rosout"]
    with open_log(log) as recorded:
        forces = [message.data.tolist() for _, message in recorded.read(t.PEAK_FORCE)]
    plotted = [
        value
        for chunk in chunks
        if chunk.entity_path == "/arm/peak_force" and not chunk.is_static
        for value in chunk.to_record_batch().to_pydict()["Scalars:scalars"]
    ]
    assert plotted == forces
    arm, others = ("3D", "/"), (("TimeSeries", "arm/peak_force"), ("TextLog", "/"))
    begun = painted(window, log, ("message_log_time", 0.1), lambda found: share(found[arm][1]) > 0.02)

    def moved(found: Painted) -> bool:
        seen = all(share(found[name][1]) > 0.005 for name in others)
        return seen and bool(np.abs(found[arm][1] - begun[arm][1]).mean() > 1.0)

    assert moved(painted(window, log, ("message_log_time", 2.0), moved))


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="util-linux is not installed")
def test_a_killed_viewer_leaves_no_server(tmp_path: Path, log: Path) -> None:
    environment = {**os.environ, **log_samples.rerun_home(tmp_path)}
    command = [sys.executable, "-m", "runtime.cli", "view", str(log), "--web"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[1]
            port = int(address.split("127.0.0.1:")[1].split("/")[0])
            with socket.create_connection(("127.0.0.1", port), timeout=30):
                pass
        finally:
            process.kill()
    deadline = time.monotonic() + 30
    while any(number == port for _, number in listening()) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert port not in {number for _, number in listening()}
