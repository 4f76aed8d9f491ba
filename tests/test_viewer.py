"""The live viewer and saved pages: in a real browser, and with browsers that come late, leave or never come."""

import argparse
import io
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request

import numpy as np
import pytest
import view_cases
from browser import Browser, find_chromium
from PIL import Image

from cdm_pin.animation import write_ghosts
from cdm_pin.cli import main
from cdm_pin.errors import InputError, ShapeError
from cdm_pin.identify import identify
from cdm_pin.manipulator import save_manipulator
from cdm_pin.recording import save_recording
from cdm_pin.report import write_report
from cdm_pin.scene_mesh import TUBE, tube
from cdm_pin.scene_meshcat import pack_frames
from cdm_pin.show import frame_at, show_model, show_recording
from cdm_pin.viewer import Listener, Viewer, link, listen, watch
from cdm_pin.viewer_server import RATE, Player


@pytest.fixture(scope="module")
def model():
    return view_cases.arm(2)


@pytest.fixture(scope="module")
def show(model):
    return show_recording(model, view_cases.recording(model))


@pytest.fixture(scope="module")
def browser():
    find_chromium()
    with Browser() as page:
        yield page


def pixels(png: bytes) -> np.ndarray:
    """Decode a screenshot, shape (rows, columns, 3)."""
    return np.array(Image.open(io.BytesIO(png)).convert("RGB"), int)


def count_near(image: np.ndarray, colour, tolerance: float = 60.0) -> int:
    return int((np.linalg.norm(image - np.array(colour), axis=2) < tolerance).sum())


def count_changed(one: np.ndarray, other: np.ndarray) -> int:
    return int((np.abs(one - other).max(2) > 20).sum())


def only_local(requests: list[str], *allowed: str) -> bool:
    return bool(requests) and all(address.startswith((*allowed, "data:", "blob:")) for address in requests)


def test_live_page_shows_robot_cables_and_highlight(browser, model, show):
    """In a real browser: the scene tree holds the arm, its cables move, a found place lights up, nothing leaves."""
    with Viewer(show) as viewer:
        browser.visit(viewer.url)
        browser.wait_for("window.cdm && cdm.frames > 3")
        names = browser.evaluate("Object.keys(cdm.viewer.scene_tree.children.robot.children)")
        assert {"body_1", "body_2", "winch_2", "cable_1_upper", "cable_2_lower", "mark_joint_2"} <= set(names)
        triangles = browser.evaluate("node('robot/cable_2_upper/<object>').object.geometry.index.count") / 3
        assert triangles == 2 * TUBE * (show_paths(show)[2].shape[1] - 1)
        browser.call("Runtime.evaluate", expression="byId('side').hidden = true; send({seek: 1.0, playing: false})")
        browser.wait_for("!playing")
        time.sleep(0.3)
        before = pixels(browser.screenshot())
        for name in ("body_1", "body_2", "winch_2", "joint_1_pulley_2", "cable_1_upper", "cable_2_upper"):
            see = f"node('robot/{name}').object.visible = %s; viewer.set_dirty()"
            browser.evaluate(see % "false")
            time.sleep(0.2)
            assert count_changed(before, pixels(browser.screenshot())) > 25, name
            browser.evaluate(see % "true")
        viewer.tell(**link(view_cases.diagnosis()))
        browser.wait_for("document.querySelector('.chip.sure')")
        time.sleep(0.5)
        after = pixels(browser.screenshot())
        red = (213, 94, 0)
        assert count_near(after, red) > count_near(before, red) + 100
        assert len(np.unique(before[:350].reshape(-1, 3), axis=0)) > 200
        assert only_local(browser.requests, viewer.url, viewer.url.replace("http", "ws"))
        assert not browser.log


def show_paths(show):
    from cdm_pin.scene import frames

    return frames(show.scenes[0], show.q[0][:1]).lines


def test_cables_in_the_page_lie_where_python_put_them(browser, show):
    """The rings of vertices between which the page draws a cable stand about the points of its path."""
    with Viewer(show) as viewer:
        browser.visit(viewer.url)
        browser.wait_for("window.cdm && cdm.frames > 3")
        browser.evaluate("send({seek: 0.0, playing: false})")
        browser.wait_for("!playing && byId('seek').value < 0.01")
        time.sleep(0.4)
        get = "(() => { const g = node('robot/%s/<object>').object.geometry, i = Array.from(g.index.array);"
        get += "return [i, [...new Set(i)].sort((a, b) => a - b).map(k => Array.from(g.attributes.position.array"
        get += ".subarray(3 * k, 3 * k + 3)))]; })()"
        for name, path in (("cable_1_lower", show_paths(show)[1][0]), ("cable_2_upper", show_paths(show)[2][0])):
            index, vertices = browser.evaluate(get % name)
            rings = np.array(vertices).reshape(len(path), TUBE, 3)
            np.testing.assert_allclose(rings.mean(1), path, atol=1e-5)
            across = np.linalg.norm(rings - path[:, None], axis=2)
            np.testing.assert_allclose(across, show.scenes[0].cable_radius, atol=1e-5)
            np.testing.assert_array_equal(np.array(index) - min(index), tube(len(path)).faces.ravel())


def test_play_pause_seek_and_speed(browser, show):
    """The bar's controls reach the server, and the clock obeys them."""
    with Viewer(show) as viewer:
        browser.visit(viewer.url)
        browser.wait_for("window.cdm && cdm.frames > 2")
        browser.evaluate("byId('play').click()")
        browser.wait_for("byId('play').textContent === 'Play'")
        time.sleep(0.3)
        count = browser.evaluate("cdm.frames")
        time.sleep(0.5)
        assert browser.evaluate("cdm.frames") == count  # nothing changes, nothing is drawn
        browser.evaluate("byId('seek').value = 7; byId('seek').oninput(); byId('seek').onchange()")
        browser.wait_for("byId('time').textContent.startsWith('7.0 /')")
        browser.evaluate("byId('speed').value = '10'; byId('speed').onchange(); byId('play').click()")
        browser.wait_for("parseFloat(byId('time').textContent) > 9")


def test_news_of_an_identification_reach_the_panel(browser, show):
    """Steps, shrinking intervals, residuals and suspects are shown as they arrive, to a browser that comes late too."""
    with Viewer(show) as viewer:
        progress = Listener(viewer)
        progress("block 1", 0.1, parameters=[("Izz_1", 1.2, 0.2)], residual=[0.3, 0.2])
        progress("block 9", 0.9, parameters=[("Izz_1", 1.1, 0.02)], suspects=[{"kind": "joint", "index": 1}])
        time.sleep(0.3)
        browser.visit(viewer.url)
        browser.wait_for("window.cdm && document.querySelector('.span i') && document.querySelector('.chip')")
        text = browser.evaluate("byId('news').innerText")
        assert "block 9" in text and "1.10 ± 0.02" in text and "joint 1 ?" in text and "0.300" in text
        assert browser.evaluate("parseFloat(document.querySelector('.span i').style.width)") < 60 / 4


def test_estimates_follow_the_replay(browser, model):
    """What an identification reports block by block is shown at its time of the recording, not before."""
    recording = view_cases.recording(model)
    with Viewer(show_recording(model, recording)) as viewer:
        identify(model, [recording], effects=["coulomb_friction:joint2"], cutoff=20.0, progress=Listener(viewer))
        browser.visit(viewer.url)
        browser.wait_for("window.cdm && cdm.frames > 2")
        intervals = []
        for moment in (0.0, 6.0, 19.9):
            browser.evaluate(f"send({{seek: {moment}, playing: false}})")
            browser.wait_for(f"Math.abs(byId('seek').value - {moment}) < 0.1")
            time.sleep(0.3)
            text = browser.evaluate("byId('news').innerText")
            intervals.append(re.findall(r"mx_2\s+\S+ ± (\S+)", text))
        assert not intervals[0], text
        assert intervals[1], text
        assert float(intervals[1][0]) > float(intervals[2][0]) > 0


def test_saved_ghosts_play_from_disk(browser, tmp_path, model):
    """Three ghosts in one file: played from disk, moving, each in its colour, with nothing asked of the network."""
    t, q, _, _ = view_cases.motion(2, seconds=2.0)
    path = tmp_path / "ghosts.html"
    write_ghosts(path, model, t, q, q + 0.4 * t[:, None], q + 0.01 * t[:, None])
    browser.visit(path.as_uri())
    browser.wait_for("window.cdm && cdm.frames > 3")
    names = browser.evaluate("Object.keys(cdm.viewer.scene_tree.children)")
    assert {"recorded", "rigid", "completed"} <= set(names)
    browser.evaluate("setPlaying(false); now = 1.9; byId('side').hidden = true")
    time.sleep(0.5)
    late = pixels(browser.screenshot())
    orange = late[:, :, 0] - late[:, :, 2]
    assert (orange > 80).sum() > 300
    assert only_local(browser.requests, path.as_uri()) and not browser.log


def test_report_reads_without_javascript(browser, tmp_path):
    """With scripting switched off the report shows its words and draws its figures, and asks nothing of the network."""
    arm = view_cases.arm()
    path = tmp_path / "report.html"
    write_report(path, view_cases.diagnosis(), view_cases.evidence(arm), arm)
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.visit(path.as_uri())
        time.sleep(0.7)
        image = pixels(browser.screenshot())
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
    assert count_near(image, (213, 94, 0), 30) > 300  # the verdict's mark and the ring on joint 2
    assert only_local(browser.requests, path.as_uri())
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")  # no sideways scrolling at 500 px


def test_frames_placed_ahead_are_those_of_their_time(show, monkeypatch):
    """Through play, seek, other speeds, the end of the motion and news a frame is within half a tick of its time."""
    clock = [100.0]
    monkeypatch.setattr("cdm_pin.viewer_server.time.monotonic", lambda: clock[0])
    player = Player(show)

    def check(times):
        for _ in range(times):
            clock[0] += 1 / RATE + 0.004 * np.sin(37 * clock[0])
            player.tick()
            kind, t = struct.unpack("<If", player.frame()[:8])
            late = abs(t - player.now) % show.duration
            assert kind == 1 and min(late, show.duration - late) <= 0.51 * player.speed / RATE
            expected = pack_frames(frame_at(show, float(t), player.shown))[0]
            np.testing.assert_allclose(np.frombuffer(player.frame()[8:], "<f4"), expected, atol=2e-4)

    check(40)
    player.asked({"seek": show.duration - 0.3, "speed": 2.0})
    check(20)
    player.told({"accepted_at": [{"kind": "joint", "index": 2}]})
    check(3)
    player.asked({"playing": False, "seek": 3.0})
    assert player.frame() is player.frame() and struct.unpack("<f", player.frame()[4:8])[0] == 3.0


def test_no_browser_ever_comes(show):
    """Without a browser nothing waits: a thousand news are taken at once and the server ends when told."""
    start = time.monotonic()
    viewer = Viewer(show)
    progress = Listener(viewer)
    for k in range(1000):
        progress("step", k / 1000, residual=[0.1, 0.1])
    assert time.monotonic() - start < 3.0
    viewer.close()
    assert viewer.process.poll() is not None and time.monotonic() - start < 12.0


HANDSHAKE = (
    b"GET /stream HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


def test_browsers_that_leave_cost_nothing(show):
    """A client that connects, reads nothing and goes away leaves the server alive for the next one."""
    with Viewer(show) as viewer:
        host, port = viewer.url[7:-1].split(":")
        for _ in range(3):
            rude = socket.create_connection((host, int(port)), timeout=20)
            rude.sendall(HANDSHAKE)
            assert b"101" in rude.recv(100)
            rude.close()
        with urllib.request.urlopen(viewer.url, timeout=20) as answer:
            assert b"MeshCat.Viewer" in answer.read()
        assert viewer.alive


def test_other_names_than_loopback_are_refused(show):
    """A page of another site that points its name at loopback gets nothing."""
    with Viewer(show) as viewer:
        request = urllib.request.Request(viewer.url, headers={"Host": "evil.example"})
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(request, timeout=20)


def test_the_server_dies_with_its_owner(model):
    """Even an owner that is killed leaves no server behind."""
    code = (
        "import sys, time; sys.path.insert(0, sys.argv[1]); import view_cases as c\n"
        "from cdm_pin.show import show_model; from cdm_pin.viewer import Viewer\n"
        "v = Viewer(show_model(c.arm(2))); print(v.process.pid, flush=True); time.sleep(60)"
    )
    here = os.path.dirname(__file__)
    owner = subprocess.Popen([sys.executable, "-c", code, here], stdout=subprocess.PIPE, text=True)
    assert owner.stdout is not None
    server = int(owner.stdout.readline())
    owner.kill()
    owner.wait()
    end = time.monotonic() + 20
    while time.monotonic() < end and os.path.exists(f"/proc/{server}") and not zombie(server):
        time.sleep(0.1)
    assert not os.path.exists(f"/proc/{server}") or zombie(server)


def zombie(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().split(")")[1].split()[0] == "Z"
    except OSError:
        return True


def test_port_in_use_is_said(show):
    """A port asked for and taken is an error that says so; otherwise the next free one is used."""
    with listen("127.0.0.1", None) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} is in use by another program"):
            Viewer(show, port=port)
        with listen("127.0.0.1", None) as other:
            assert other.getsockname()[1] != port
    with pytest.raises(InputError, match=r"--host: cannot listen on '203\.0\.113\.1'"):
        listen("203.0.113.1", 0)
    with pytest.raises(InputError, match="is no port"):
        listen("127.0.0.1", 99999)


@pytest.fixture
def files(tmp_path, model):
    save_manipulator(model.manipulator, tmp_path / "arm.yaml")
    save_recording(view_cases.recording(model), tmp_path / "run.csv")
    (tmp_path / "diagnosis.json").write_text(json.dumps(view_cases.diagnosis()))
    return tmp_path


def test_view_command_writes_a_page(files, capsys):
    """`view -o` writes a page that plays from disk, with the diagnosis on it."""
    given = ["view", str(files / "arm.yaml"), str(files / "run.csv"), "--diagnosis", str(files / "diagnosis.json")]
    assert main([*given, "--forces", "-o", str(files / "page.html")]) == 0
    page = (files / "page.html").read_text()
    assert "Joint 2 loses" in page and "Written" in capsys.readouterr().out


def test_view_command_refuses_what_is_no_diagnosis(files, capsys):
    """A file that is no diagnosis is one line on standard error and status 2."""
    (files / "x.json").write_text("{}")
    assert main(["view", str(files / "arm.yaml"), "--diagnosis", str(files / "x.json")]) == 2
    assert "is not a diagnosis" in capsys.readouterr().err


def _hear_interrupts() -> None:
    """Shells ignore Ctrl-C for what they run in the background, and so would a command started from there."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_view_command_ends_on_ctrl_c(files):
    """Ctrl-C ends `view` with status 130, one line and no server left."""
    command = [sys.executable, "-m", "cdm_pin.cli", "view", str(files / "arm.yaml"), "--json"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_hear_interrupts,
    )
    assert process.stdout is not None
    text = ""
    while not text.rstrip().endswith("}"):
        text += process.stdout.readline()
    url = json.loads(text)["url"]
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and errors.strip() == "cdm-pin: interrupted"
    with pytest.raises(OSError):  # refused or reset
        urllib.request.urlopen(url, timeout=5)


def test_watch_without_view_starts_nothing(model):
    """Without --view the callback of a command is the terminal's alone."""
    args = argparse.Namespace(quiet=True, json=False, view=False)
    with watch(args, model, []) as watching, watching.progress() as progress:
        progress("step", 0.5, residual=[1.0])
        assert watching.viewer is None


def test_watch_serves_while_computing(model, capsys):
    """With --view the address is said, and the callback reaches both."""
    args = argparse.Namespace(quiet=False, json=False, view=True, host="127.0.0.1", port=None)
    with watch(args, model, [view_cases.recording(model)]) as watching:
        with watching.progress() as progress:
            progress("step", 0.5, residual=[0.1, 0.1])
            assert getattr(progress, "wants_news", False)
        watching.tell(view_cases.diagnosis())
        assert "watch at http://127.0.0.1:" in capsys.readouterr().err and watching.viewer.alive


class Audience:
    """Stands in for a viewer and keeps what it is told."""

    url, alive = "http://127.0.0.1:0/", True

    def __init__(self):
        self.told = []

    def __call__(self, show, **where):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        pass

    def tell(self, **news):
        self.told.append(news)

    def ask(self, news):
        self.told.append(news())


def test_diagnose_shows_suspects_then_what_it_accepts(files, monkeypatch, capsys):
    """`diagnose --view`: suspects light up, what is accepted stays, the error falls; ghosts stand beside the report."""
    audience = Audience()
    monkeypatch.setattr("cdm_pin.viewer.Viewer", audience)
    out = files / "out"
    assert main(["diagnose", str(files / "arm.yaml"), str(files / "run.csv"), "-o", str(out), "--view"]) == 0
    assert "watch at http://127.0.0.1" in capsys.readouterr().err
    joint2 = {"kind": "joint", "index": 2}
    suspected = [news for news in audience.told if joint2 in news.get("suspects_at", [])]
    assert suspected and joint2 not in suspected[0]["accepted_at"]
    assert audience.told[-1]["accepted_at"] == [joint2]
    assert audience.told[-1]["residual"][1] < 0.3 * suspected[0]["residual"][1]
    content = json.loads((out / "diagnosis.json").read_text())
    simulated = content["fit"]["simulated_position"]
    assert simulated["rmse_augmented"][1] < 0.2 * simulated["rmse_rigid"][1]
    assert 'href="ghosts.html"' in (out / "report.html").read_text()
    assert (out / "ghosts.html").stat().st_size < 5e6


def test_ghosts_of_other_shapes_are_refused(model, tmp_path):
    """Motions that do not fit the robot are an error that names which."""
    q = np.zeros((10, 2))
    with pytest.raises(ShapeError, match="rigid has shape"):
        write_ghosts(tmp_path / "x.html", model, np.arange(10.0), q, q[:5], q)


def test_ghosts_stand_still_where_a_simulation_ended(model, tmp_path):
    """A simulation that diverged holds its last state instead of breaking the page."""
    t, q, _, _ = view_cases.motion(2, seconds=1.0)
    lost = q.copy()
    lost[50:] = np.nan
    write_ghosts(tmp_path / "x.html", model, t, q, lost, q)
    assert "NaN" not in (tmp_path / "x.html").read_text().split('id="saved"')[1][:2000]


def test_a_robot_at_rest_has_no_clock(model):
    """A robot without a recording has a motion of no length."""
    assert show_model(model).duration == 0.0
