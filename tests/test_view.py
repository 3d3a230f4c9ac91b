"""The page of `touchnet view`, in a real browser, and the command and server behind it."""

import functools
import gzip
import json
import queue
import signal
import subprocess
import sys
import threading
import tomllib
import urllib.error
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import touchnet
from tests.browser import open_page
from touchnet.data.files import Points, write_mesh
from touchnet.view import main
from touchnet.viewer.page import render_page
from touchnet.viewer.scene import MAX_SHOWN, Scene, Step, Suggestion, confidence_of, pick_counts
from touchnet.viewer.server import Server

READY = "document.documentElement.dataset.state === 'ready' || !document.getElementById('failure').hidden"
WIDTH, HEIGHT = 680, 480  # drawing without a graphics card takes its time
MIDDLE = (slice(60, 390), slice(310, 660))  # of a picture, where nothing but the canvas is


class Ball(torch.nn.Module):
    """Stands in for a trained network: the ball around the mean of the contacts."""

    def encode(self, touches, normals=None):
        centre = touches[0].mean(dim=0)
        return centre, (touches[0] - centre).norm(dim=1).mean()

    def decode(self, features, queries):
        centre, radius = features
        return torch.sigmoid(20 * (radius - (queries - centre).norm(dim=2)))


@pytest.fixture
def ball(monkeypatch):
    monkeypatch.setattr("touchnet.weights.load_model", lambda name, device: Ball())


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def strokes_on_a_sphere(count=128, strokes=8, radius=48.0, centre=(100.0, -20.0, 400.0)):
    """Meridians, each from pole to pole."""
    down = np.tile(np.linspace(0.1, np.pi - 0.1, count // strokes), strokes)
    numbers = np.repeat(np.arange(strokes), count // strokes)
    around = numbers * 2 * np.pi / strokes
    normals = np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)], axis=1)
    return Points(np.asarray(centre) + radius * normals, normals, numbers, 0)


def sphere(radius=48.0, centre=(100.0, -20.0, 400.0), confidence=False):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    mesh.apply_translation(centre)
    if confidence:
        mesh.vertex_attributes["confidence"] = (mesh.vertices[:, 0] > centre[0]).astype(np.float32)
        mesh.metadata["tolerance"] = 0.5
    return mesh


def small_scene(**options):
    contacts = strokes_on_a_sphere()
    centre = contacts.points.mean(axis=0)
    towards_viewer = np.array([0.5, 0.4, 0.77]) / np.linalg.norm([0.5, 0.4, 0.77])
    suggestions = [
        Suggestion(centre + 48 * towards_viewer, -towards_viewer, 0.25, 2.0, 30.0),
        Suggestion(centre + np.array([0, 48, 0]), np.array([0, -1.0, 0]), 0.125, 1.5, 20.0),
    ]
    steps = [
        Step(32, sphere(40.0)),
        Step(64, None, (), ["no surface was found"]),
        Step(128, sphere(confidence=True), suggestions),
    ]
    return Scene(contacts, "strokes.csv", steps=steps, **options)


@contextmanager
def shown(scene, folder, **options):
    file = folder / "page.html"
    file.write_text(render_page(scene), encoding="utf-8")
    with open_page(file, **{"width": WIDTH, "height": HEIGHT} | options) as page:
        page.wait_for(READY)
        page.check()
        yield page
        page.check()


def facts(page):
    return page.evaluate("$('facts').innerText")


def count_pixels(picture, red, green, blue):
    """Of a colour where each argument is a range."""
    parts = [(picture[..., k] >= low) & (picture[..., k] <= high) for k, (low, high) in enumerate((red, green, blue))]
    return int(np.logical_and.reduce(parts)[MIDDLE].sum())


def changed(before, after):
    """The share of pixels in the middle that changed visibly."""
    return (np.abs(before.astype(int) - after).max(axis=2) > 12)[MIDDLE].mean()


def test_the_page_draws_what_its_controls_say(tmp_path):
    with shown(small_scene(), tmp_path) as page:
        assert page.evaluate("document.title") == "strokes.csv"
        everything = page.screenshot()
        hues = {tuple(colour // 32) for colour in everything[MIDDLE].reshape(-1, 3)}
        assert len(hues) > 100, f"the canvas is blank: {len(hues)} colours"

        page.click("#mesh")
        no_mesh = page.screenshot()
        assert changed(everything, no_mesh) > 0.15
        page.click("#contacts")
        arrows = page.screenshot()
        assert changed(no_mesh, arrows) > 0.005
        page.click("#suggestions")
        floor = page.screenshot()
        assert 0.001 < changed(arrows, floor) < 0.05
        assert page.evaluate("[...document.querySelectorAll('#labels span')].every(label => label.hidden)")
        for box in ("#mesh", "#contacts", "#suggestions"):
            page.click(box)
        assert changed(everything, page.screenshot()) == 0

        page.click("label:has(> input[value=order])")
        assert 0.001 < changed(everything, page.screenshot()) < 0.1
        page.drag("#view", 120, 20)
        assert changed(everything, page.screenshot()) > 0.02
        page.click("#reset")
        page.click("label:has(> input[value=stroke])")
        assert changed(everything, page.screenshot()) < 1e-3


def test_every_stroke_has_its_colour(tmp_path):
    scene = Scene(strokes_on_a_sphere(), "strokes", steps=[Step(128, None)])
    with shown(scene, tmp_path) as page:
        colours = np.array(page.evaluate("[...page.renderer.colours]")).reshape(-1, 3)
        of_stroke = [np.unique(colours[scene.strokes == k], axis=0) for k in range(8)]
        assert all(len(colour) == 1 for colour in of_stroke)
        apart = np.linalg.norm(np.concatenate(of_stroke)[:, None] - np.concatenate(of_stroke), axis=2)
        assert apart[~np.eye(8, dtype=bool)].min() > 0.1
        assert page.evaluate("page.linesBefore.at(-1)") == 128 - 8  # no path from one stroke to the next
        assert page.evaluate("$('mesh-set').hidden && $('suggestions-set').hidden")


def test_coordinates_arrive_in_the_frame_of_the_file(tmp_path):
    scene = small_scene()
    with shown(scene, tmp_path) as page:
        positions = np.array(page.evaluate("[...page.renderer.positions]")).reshape(-1, 3)
        back = scene.centre + scene.side * positions
        np.testing.assert_allclose(back, scene.contacts.points, atol=1e-5)
        vertices = np.array(page.evaluate("[...meshPositions(page.step)]")).reshape(-1, 3)
        mesh = scene.steps[-1].mesh
        np.testing.assert_allclose(scene.centre + scene.side * vertices, mesh.vertices, atol=96 / 65535)
        assert page.evaluate("[...page.step.face]") == mesh.faces.ravel().tolist()
        assert page.evaluate("coordinates(page.arrows[1].tip)") == ["100.00", "28.00", "400.00"]
        # The contact next to the pole is what the mouse finds there.
        x, y, _ = page.evaluate("onScreen(currentView(), contact(page.scene.count - 128))")
        page.evaluate("['mesh', 'suggestions'].forEach(id => $(id).click())")
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        page.wait_for("!$('tip').hidden")
        said = page.evaluate("$('tip').textContent")
        assert said == "contact 1, stroke 0\n104.79  27.76  400.00"


def test_the_slider_walks_through_contacts_and_meshes(tmp_path):
    with shown(small_scene(), tmp_path) as page:
        assert page.evaluate("[...$('marks').children].map(mark => Number(mark.dataset.count))") == [32, 64, 128]
        whole = page.screenshot()
        assert "128 contacts" in facts(page)
        page.evaluate("$('count').focus()")
        page.press("Home")
        assert page.evaluate("$('counted').innerText.replace(/\\s+/g, ' ')") == "1 of 128 contacts stroke 1 of 8"
        assert "32 contacts" in facts(page)
        first = page.screenshot()
        assert changed(whole, first) > 0.05
        page.evaluate("setCount(100)")
        assert page.evaluate("$('notes').textContent") == "no surface was found"
        assert "Faces" not in facts(page)
        page.press("End")
        assert changed(whole, page.screenshot()) < 1e-3
        page.evaluate("setCount(120)")
        page.click("#play")
        page.wait_for("page.count === 128 && !page.playing")


def test_confidence_colours_the_mesh_where_there_is_one(tmp_path):
    with shown(small_scene(), tmp_path) as page:
        page.click("#contacts")
        page.click("#suggestions")
        orange = (((150, 255), (60, 150), (0, 110)),)
        with_colour = page.screenshot()
        assert count_pixels(with_colour, *orange[0]) > 2000
        assert page.evaluate("$('tolerance').textContent") == "that the surface is within 0.5"
        page.click("#confidence")
        assert count_pixels(page.screenshot(), *orange[0]) < 100
        assert page.evaluate("$('confidence-ramp').hidden")
        page.evaluate("setCount(32)")
        assert page.evaluate("$('confidence-row').hidden")


def test_suggestions_are_listed_and_turned_to(tmp_path):
    with shown(small_scene(), tmp_path) as page:
        rows = page.evaluate("[...$('next').rows].map(row => [...row.cells].map(cell => cell.innerText))")
        assert [row[0] for row in rows] == ["1", "2"]
        assert rows[1][1:] == ["100.00", "28.00", "400.00", "13 %"]
        assert page.evaluate("csv().split('\\n')[2]") == "100,28,400,0,-1,0,0.125,1.5,20"
        page.click("#next tr:nth-child(2)")
        page.wait_for("page.camera.elevation > 1.19")
        page.evaluate("setCount(32)")
        assert page.evaluate("$('labels').childElementCount") == 0


@pytest.mark.parametrize(("width", "height", "dark"), [(1280, 800, True), (390, 780, False)])
def test_nothing_overlaps_in_wide_and_narrow_windows(tmp_path, width, height, dark):
    with shown(small_scene(), tmp_path, width=width, height=height, dark=dark) as page:
        boxes = [page.evaluate(f"$('{name}').getBoundingClientRect().toJSON()") for name in ("panel", "tools", "bar")]
        for k, a in enumerate(boxes):
            assert a["left"] >= 0 and a["right"] <= width and a["top"] >= 0 and a["bottom"] <= height
            for b in boxes[k + 1 :]:
                assert (
                    a["right"] <= b["left"]
                    or b["right"] <= a["left"]
                    or a["bottom"] <= b["top"]
                    or b["bottom"] <= a["top"]
                )
        assert page.evaluate("document.documentElement.dataset.theme") == ("dark" if dark else "light")
        ink = page.evaluate("getComputedStyle($('title')).color")
        assert (ink == "rgb(232, 236, 242)") == dark


def test_titles_are_text_and_the_page_may_connect_to_nothing(tmp_path):
    name = "</title></script><script>document.title = 'run'</script><img src=x onerror=\"document.title='run'\">.csv"
    scene = small_scene()
    scene.title = scene.mesh_name = name
    with shown(scene, tmp_path) as page:
        assert page.evaluate("document.title") == name
        assert page.evaluate("$('title').textContent") == name
        policy = page.evaluate("document.querySelector('meta[http-equiv]').content")
        assert "default-src 'none'" in policy and "connect-src 'none'" in policy and "unsafe" not in policy
        # Even if something in the page wanted to.
        assert page.evaluate("fetch('https://example.com/').then(() => 'sent', () => 'refused')") == "refused"
        assert page.requests == [page.evaluate("location.href")]
        page.errors.clear()  # the browser says that it refused


def test_a_browser_without_webgl_is_told(tmp_path):
    file = tmp_path / "page.html"
    file.write_text(render_page(small_scene()))
    with open_page(file) as page:
        page.call("Page.addScriptToEvaluateOnNewDocument", source="HTMLCanvasElement.prototype.getContext = () => null")
        page.open(file.as_uri())
        page.wait_for("!document.getElementById('failure').hidden")
        assert "needs WebGL 2" in page.evaluate("document.getElementById('failure').textContent")


def test_a_page_comes_back_after_the_graphics_card_forgot(tmp_path):
    with shown(small_scene(), tmp_path) as page:
        before = page.screenshot()
        page.evaluate("(window.lose = page.renderer.gl.getExtension('WEBGL_lose_context')).loseContext()")
        page.wait_for("page.renderer.gl.isContextLost()")
        page.evaluate("window.old = page.renderer; lose.restoreContext()")
        page.wait_for("page.renderer !== window.old")
        page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert changed(before, page.screenshot()) < 1e-3
        page.errors.clear()


def unpacked(data):
    data = gzip.decompress(data)
    length = int.from_bytes(data[:4], "little")
    return json.loads(data[4 : 4 + length])


@pytest.mark.parametrize("points", [[[1, 2, 3]], [[0, 0, 0], [1e-9, 0, 0]], [[1e30, 0, 0], [-1e30, 0, 1e29]]])
def test_a_single_place_and_any_unit_can_be_looked_at(tmp_path, points):
    scene = Scene(Points(np.array(points, dtype=np.float64), None, None, 0), "few", steps=[Step(len(points), None)])
    with shown(scene, tmp_path) as page:
        seen = page.screenshot()
        page.click("#contacts")
        assert 1e-4 < changed(seen, page.screenshot()) < 0.05
        assert "NaN" not in facts(page)


def test_many_contacts_are_thinned_and_outliers_marked():
    points = np.random.default_rng(0).normal(size=(2 * MAX_SHOWN + 1, 3))
    head = unpacked(Scene(Points(points, None, None, 0), "many").pack_contacts())
    assert head["every"] == 3 and head["count"] == len(points)
    assert head["arrays"][0] == ["position", "f4", [3, -(-len(points) // 3)]]
    assert head["guessed"]
    few = np.vstack([strokes_on_a_sphere().points, [[9000, 0, 0]]])
    scene = Scene(Points(few, None, None, 0), "few")
    assert unpacked(scene.pack_contacts())["outliers"] == 1
    assert scene.side == pytest.approx(96, rel=0.01)


def test_strokes_are_counted_in_the_order_they_were_made():
    contacts = strokes_on_a_sphere()._replace(strokes=np.repeat([7, 7, 3, 9, 3, 1, 1, 1], 16))
    assert unpacked(Scene(contacts, "").pack_contacts())["strokes"] == [7, 3, 9, 1]


def test_confidence_is_cleaned_and_checked():
    mesh = sphere()
    assert confidence_of(mesh) is None
    values = np.full(len(mesh.vertices), 0.5)
    values[:3] = [np.nan, -1, 7]
    mesh.vertex_attributes["confidence"] = values
    assert confidence_of(mesh)[:4].tolist() == [0, 0, 1, 0.5]
    mesh.vertex_attributes["confidence"] = values[:5]
    with pytest.warns(UserWarning, match="5 values of confidence for 642 vertices"):
        assert confidence_of(mesh) is None


@pytest.mark.parametrize(
    ("total", "steps", "counts"),
    [
        (2048, 6, [64, 128, 256, 512, 1024, 2048]),
        (100, 6, [25, 50, 100]),
        (31, 6, [31]),
        (4, 6, [4]),
        (1000, 1, [1000]),
    ],
)
def test_meshes_are_made_from_halves(total, steps, counts):
    assert pick_counts(total, steps) == counts


def test_the_files_of_the_page_are_installed_with_the_package():
    root = Path(__file__).resolve().parents[1]
    patterns = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["touchnet"]
    folder = root / "touchnet"
    parts = [path for path in (folder / "viewer").iterdir() if path.suffix not in (".py", "") and path.is_file()]
    assert len(parts) == 6
    assert set(parts) <= {path for pattern in patterns for path in folder.glob(pattern)}


def table(path, points):
    np.savetxt(path, np.column_stack([points.points, points.strokes]), header="x y z stroke", comments="")
    return str(path)


SAVE = ["--resolution", "32", "--save", "page.html"]


def test_save_makes_one_page_and_keeps_what_is_there(here, ball, capsys):
    touches = table("t.csv", strokes_on_a_sphere())
    assert main([touches, *SAVE]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.startswith("page.html: 128 contacts in 8 strokes, 4 meshes, ")
    page = Path("page.html").read_bytes()
    assert b"http" not in page.replace(b'<meta http-equiv="Content-Security-Policy"', b"").replace(
        b"http://www.w3.org/2000/svg", b""
    )
    assert main([touches, *SAVE]) == 2
    assert capsys.readouterr().err == "touchnet view: error: page.html exists; --force overwrites it\n"
    assert main([touches, *SAVE, "--force"]) == 0
    assert Path("page.html").read_bytes() == page  # nothing in it depends on when it is made
    assert sorted(path.name for path in here.iterdir()) == ["page.html", "t.csv"]
    with open_page("page.html") as opened:
        opened.wait_for(READY)
        opened.check()
        assert opened.evaluate("page.steps.map(step => step.count)") == [16, 32, 64, 128]
        assert "128 contacts" in facts(opened)


def test_the_page_suggests_what_the_explorer_does(here, ball):
    contacts = strokes_on_a_sphere()
    touches = table("t.csv", contacts)
    assert main([touches, *SAVE, "--steps", "1", "--suggestions", "3"]) == 0
    expected = touchnet.Explorer(contacts.points, weights=Ball(), resolution=32).next(3)
    with open_page("page.html", width=WIDTH, height=HEIGHT) as page:
        page.wait_for(READY)
        page.check()
        found = np.array([row.split(",") for row in page.evaluate("csv()").splitlines()[1:]], dtype=float)
        np.testing.assert_allclose(found, np.column_stack(expected), rtol=1e-9, atol=1e-9)
        assert not page.evaluate("$('confidence-row').hidden")
        assert page.evaluate("page.step.tolerance") == pytest.approx(0.01 * np.ptp(contacts.points, axis=0).max())


def test_a_save_that_fails_leaves_nothing(here, ball, monkeypatch):
    touches = table("t.csv", strokes_on_a_sphere())

    def broken(scene):
        raise OSError("disk full")

    monkeypatch.setattr("touchnet.viewer.page.render_page", broken)
    assert main([touches, *SAVE]) == 2
    assert [path.name for path in here.iterdir()] == ["t.csv"]


def test_a_given_mesh_is_shown_as_it_is(here, monkeypatch, capsys):
    def refuse(name, device):
        raise AssertionError("no network is needed")

    monkeypatch.setattr("touchnet.weights.load_model", refuse)
    touches = table("t.csv", strokes_on_a_sphere())
    write_mesh("truth.ply", sphere(confidence=True))
    assert main([touches, "truth.ply", *SAVE]) == 0
    assert capsys.readouterr().err == ""
    with open_page("page.html") as page:
        page.wait_for(READY)
        page.check()
        assert "truth.ply" in facts(page) and "1280, closed" in facts(page)
        assert set(page.evaluate("[...page.step.confidence]")) == {0, 255}
        page.evaluate("setCount(3)")
        assert "truth.ply" in facts(page)
    write_mesh("far.ply", sphere(centre=(0, 0, 0)))
    assert main([touches, "far.ply", *SAVE, "-f"]) == 0
    assert "far.ply: the mesh lies beside the contacts: is it in another frame?" in capsys.readouterr().err
    write_mesh("large.ply", sphere(radius=4800.0))
    assert main([touches, "large.ply", *SAVE, "-f"]) == 0
    assert "large.ply: the mesh is 100 times as large as the contacts: another unit?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["absent.csv"], "absent.csv: No such file or directory"),
        (["t.csv", "absent.ply"], "absent.ply: No such file or directory"),
        (["t.csv", "--save", "page.png"], "page.png: expected a name that ends in .html"),
        (["t.csv", "--save", "absent/page.html"], "the folder absent does not exist"),
        (["t.csv", "--resolution", "4"], "--resolution should lie between 8 and 1024, got 4"),
        (["t.csv", "--steps", "0"], "--steps should be at least 1, got 0"),
        (["t.csv", "--suggestions", "-1"], "--suggestions should lie between 0 and 100, got -1"),
        (["t.csv", "--port", "70000"], "--port should lie between 0 and 65535, got 70000"),
        (["line.csv", *SAVE], "line.csv: expected contacts around a solid, got 20 distinct contacts on one line"),
    ],
)
def test_bad_input_is_one_line(here, ball, capsys, arguments, said):
    table("t.csv", strokes_on_a_sphere())
    Path("line.csv").write_text("".join(f"{k} {k} {k}\n" for k in range(20)))
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith("touchnet view: error: ") and err.count("\n") == 1 and said in err
    assert sorted(path.name for path in here.iterdir()) == ["line.csv", "t.csv"]


@contextmanager
def served(scene, make_step, **options):
    with Server(scene, make_step, **options) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def answer(address, host=None):
    request = urllib.request.Request(address, headers={} if host is None else {"Host": host})
    try:
        with urllib.request.urlopen(request, timeout=20) as response:
            return response.status, response.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def test_the_server_answers_this_machine_and_nothing_else():
    made = []

    def make_step(count):
        made.append(count)
        return Step(count, sphere())

    with served(small_scene(live=True), make_step) as server:
        assert server.socket.getsockname()[0] == "127.0.0.1"
        assert answer(server.address)[0] == 200
        assert unpacked(answer(f"{server.address}step?count=77")[1])["count"] == 77
        assert unpacked(answer(f"{server.address}step?count=77")[1])["faces"] == 1280
        assert made == [77]
        for wrong in ("", "count=0", "count=129", "count=-1", "count=x", "count=²", "count=" + "9" * 5000):
            assert answer(f"{server.address}step?{wrong.replace('²', '%C2%B2')}")[0] == 400, wrong
        for path in ("page.js", "../view.py", "%2e%2e/view.py", "favicon.ico"):
            assert answer(server.address + path)[0] == 404, path
        assert answer(server.address, host=f"127.0.0.1:{server.server_port}")[0] == 200
        assert answer(server.address, host="localhost")[0] == 200
        # A name of a page elsewhere that resolves to this machine.
        assert answer(server.address, host="evil.example:80")[0] == 403
        assert answer(f"{server.address}step?count=5", host="evil.example")[0] == 403
        assert made == [77]


def test_closing_waits_for_the_step_at_work_and_starts_no_other():
    made, go_on, asked = [], threading.Event(), queue.Queue()

    def make_step(count):
        assert go_on.wait(20)
        made.append(count)
        return Step(count, None)

    with served(small_scene(live=True), make_step) as server:
        step = server.step
        server.step = lambda count: (asked.put(count), step(count))[1]
        asking = [threading.Thread(target=answer, args=[f"{server.address}step?count={n}"]) for n in (5, 6)]
        for thread, count in zip(asking, (5, 6), strict=True):
            thread.start()
            assert asked.get(timeout=20) == count
        closing = threading.Thread(target=server.server_close)
        closing.start()
        closing.join(0.2)
        assert closing.is_alive()
        go_on.set()
        for thread in (closing, *asking):
            thread.join(20)
            assert not thread.is_alive()
        assert made == [5]


def test_a_live_page_asks_for_the_mesh_at_the_slider():
    def make_step(count):
        return Step(count, None, (), ["too few"]) if count == 16 else Step(count, sphere(float(count)))

    scene = small_scene(live=True, ahead=[16])
    with served(scene, make_step) as server, open_page(server.address, width=WIDTH, height=HEIGHT) as page:
        page.wait_for(READY)
        page.wait_for("page.steps.length === 4")
        assert "connect-src 'self'" in page.evaluate("document.querySelector('meta[http-equiv]').content")
        page.evaluate("$('count').focus()")
        page.press("End")
        page.press("ArrowLeft")
        page.wait_for("page.step.count === 127")
        assert page.wait_for("page.step.corners && page.step.size[0] * page.scene.side") == pytest.approx(254)
        assert "127 contacts" in facts(page)
        page.press("Home")
        page.wait_for("page.steps[0].count === 1")
        page.check()


def test_a_port_that_is_taken_is_told(here, capsys):
    touches = table("t.csv", strokes_on_a_sphere())
    write_mesh("mesh.ply", sphere())
    with served(small_scene(), None) as server:
        assert main([touches, "mesh.ply", "--no-open", "--port", str(server.server_port)]) == 2
        said = f"touchnet view: error: cannot serve at localhost, port {server.server_port}: Address already in use\n"
        assert capsys.readouterr().err == said


def test_the_command_serves_until_it_is_interrupted(here):
    touches = table("t.csv", strokes_on_a_sphere())
    write_mesh("mesh.ply", sphere())
    command = [sys.executable, "-m", "touchnet.view", touches, "mesh.ply", "--no-open"]
    # Tests started in the background ignore SIGINT, and so would the command.
    listening = functools.partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, preexec_fn=listening, **pipes)
    try:
        address = process.stdout.readline().split()[0]
        assert address.startswith("http://localhost:")
        with open_page(address) as page:
            page.wait_for(READY)
            page.check()
            assert "mesh.ply" in facts(page)
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30) == ("", "")
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()
