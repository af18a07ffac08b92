"""`miniloop view`: what the server hands out and to whom, and the page in a browser."""

import http.client
import json
import struct
import threading
from contextlib import contextmanager
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from browser import CHROMIUM, Browser
from click.testing import CliRunner

from miniloop_cli.cli.main import cli
from miniloop_cli.errors import InputError
from miniloop_cli.export.glb import glb
from miniloop_cli.export.mesh_model import Mesh
from miniloop_cli.report.viewer.models import Glb, read_glb, read_model
from miniloop_cli.report.viewer.packing import unpack_points
from miniloop_cli.report.viewer.server import ViewServer
from miniloop_cli.report.viewer.shown import show_model, show_result
from miniloop_cli.results.columns import load
from miniloop_cli.results.ply import read_ply, write_ply


@contextmanager
def serving(shown):
    server = ViewServer(shown)
    thread = threading.Thread(
        target=server.serve_forever, args=(0.01,), daemon=True
    )  # seconds until it sees that it is to end
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()


def get(server, path, token=None, host=None, method="GET"):
    """(status, headers, body) of a path below the token."""
    port = server.server_address[1]
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    headers = {"Host": host or f"127.0.0.1:{port}"}
    connection.request(method, f"/{server.token if token is None else token}/{path}", headers=headers)
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()


def test_all_of_a_result_is_served(run):
    with serving(show_result(load(run.results, run.sequence))) as server:
        assert server.server_address[0] == "127.0.0.1"
        status, headers, page = get(server, "")
        assert status == 200 and headers["Content-Type"] == "text/html; charset=utf-8"
        assert b"<script>document" not in page and b"a room &lt;b&gt;bold" in page
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        scene = json.loads(get(server, "scene.json")[2])
        assert len(scene["frames"]["pose"]) == 8 and scene["images"]
        model = json.loads(get(server, "model.json")[2])
        points, colors = read_ply(run.results / "cloud.ply")
        found = []
        for *_, begin, end in model["tiles"]:
            steps, shades = unpack_points(get(server, f"points/{begin}-{end}")[2])
            back = np.array(model["corner"]) + model["side"] / 65535 * steps
            found.append(np.concatenate([np.round(back, 3), shades], axis=1))
        found, expected = np.concatenate(found), np.concatenate([points, colors], axis=1)
        order = [np.lexsort(rows[:, ::-1].round(2).T) for rows in (found, expected)]
        assert np.abs(found[order[0]][:, :3].mean(axis=0) - points.mean(axis=0)).max() < 1e-3
        assert sorted(map(tuple, found[:, 3:].astype(int))) == sorted(map(tuple, colors.tolist()))
        image = cv2.imdecode(np.frombuffer(get(server, "frame/3.jpg")[2], np.uint8), cv2.IMREAD_COLOR)
        assert image.shape[1] == 640


@pytest.mark.parametrize(
    "path",
    [
        *("nothing", "../secret", "%2e%2e/%2e%2e/etc/passwd", "frame/99.jpg", "frame/-1.jpg", "frame/x.jpg"),
        *("points/5-2", "points/0-999999999", "points/a-b", "points/", "model.glb", "viewer/assets/viewer.js"),
    ],
)
def test_what_there_is_not_is_not_found(run, path):
    with serving(show_result(load(run.results, run.sequence))) as server:
        assert get(server, path)[0] == 404


def test_nobody_else_is_answered(run):
    with serving(show_result(load(run.results))) as server:
        assert get(server, "scene.json")[0] == 200
        for token in ("", "x", server.token[:-1], server.token + "x", "%ff"):
            assert get(server, "scene.json", token=token)[0] == 404
        # A site whose name was made to lead to this machine.
        assert get(server, "scene.json", host=f"evil.example:{server.server_address[1]}")[0] == 404
        assert get(server, "scene.json", method="POST")[0] == 501
        other = ViewServer(server.shown)
        assert other.token != server.token
        other.server_close()


def ball(path):
    """A coloured tetrahedron."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_ply(path, corners, np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]], np.uint8), faces)
    return corners, faces


def test_a_mesh_becomes_a_glb_file_that_others_read(tmp_path):
    o3d = pytest.importorskip("open3d")
    corners, faces = ball(tmp_path / "ball.ply")
    model = read_model(tmp_path / "ball.ply")
    assert isinstance(model, Glb)
    (tmp_path / "ball.glb").write_bytes(model.file)
    read = o3d.io.read_triangle_mesh(str(tmp_path / "ball.glb"))
    # Readers may number the vertices anew: triangles are compared by what their corners are.
    at, shades = np.asarray(read.vertices), np.asarray(read.vertex_colors)

    def as_written(triangle):
        return tuple(next(k for k in range(4) if np.allclose(corners[k], at[v])) for v in triangle)

    assert {frozenset(as_written(t)) for t in np.asarray(read.triangles)} == {frozenset(t) for t in faces.tolist()}
    first = next(v for v in range(len(at)) if np.allclose(at[v], corners[0]))
    np.testing.assert_allclose(shades[first], [1, 0, 0], atol=0.01)
    assert read_glb(tmp_path / "ball.glb").file == model.file


def test_what_is_no_model_is_refused(tmp_path):
    mesh = Mesh(np.eye(3, dtype=np.float32), np.zeros((3, 3), np.uint8), np.array([[0, 1, 2]], np.int32))
    whole = glb(mesh, np.eye(4))
    head = json.dumps({"buffers": [{"uri": "beside.bin"}]}).encode()
    beside = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(head), len(head), b"JSON") + head
    damaged = whole[:20] + b"\xff" * 40 + whole[60:]
    for name, content, said in (
        ("a.glb", b"no", "not a GLB file"),
        ("a.glb", beside, "needs other files"),
        ("a.glb", damaged, "damaged GLB file"),
        ("a.ply", b"no", "not a PLY file"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", "no points"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=said):
            read_model(tmp_path / name)
    (tmp_path / "a.txt").write_text("x")
    done = CliRunner().invoke(cli, ["view", str(tmp_path / "a.txt"), "--no-open"])
    assert isinstance(done.exception, InputError)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_tiles_and_meshes_in_a_browser(run, tmp_path):
    pytest.importorskip("open3d")
    ball(tmp_path / "ball.ply")
    room = np.random.default_rng(0).uniform([-4, -3, 0], [4, 3, 0.01], (60_000, 3))
    write_ply(tmp_path / "room.ply", room, np.full((60_000, 3), 90, np.uint8))
    with Browser(800, 600) as browser:
        view = "document.getElementById('viewer').view"
        for shown, points, has_frames in (
            (show_result(load(run.results, run.sequence)), 2000, True),
            (show_model(tmp_path / "room.ply", None), 60_000, False),
            (show_model(tmp_path / "ball.ply", "z"), 4, False),
        ):
            with serving(shown) as server:
                browser.open(urlsplit(server.address).geturl())
                browser.settle()
                assert browser.run("document.getElementById('viewer').dataset.ready") == "true"
                layers = browser.run("document.getElementById('v-layers').innerText")
                assert "model" in layers and ("cameras" in layers) == ("path" in layers) == has_frames
                assert browser.run("document.getElementById('v-nothing').innerText") == ""
                # Coming closer fetches what is finer, until all is there.
                browser.run(f"{view}.stage.canvas.focus()")
                browser.until(
                    f"(() => {{ const v = {view}; if (!v.pace.moving && v.model.all) v.stage.invalidate();"
                    "if (v.model.all && v.model.held.length < v.model.all.length && Math.random() < 0.3)"
                    "v.navigation.key({ key: '+' });"
                    f"let n = 0; v.model.forEach(() => n++); return n >= {points}; }})()"
                )
                seen = browser.pixels()[..., :3].astype(int)
                assert (np.abs(seen - seen[0, 0]) > 24).any()
        assert browser.problems == []
