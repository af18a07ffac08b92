"""A small recording with lens distortion, and the results folder of a run over seven of its nine frames."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.export.model import Model
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.geometry.lens import radial_tangential_lens
from miniloop_cli.results.folder import Results
from miniloop_cli.results.g2o import write_g2o
from miniloop_cli.results.ply import write_ply
from miniloop_cli.scene.sequence import Trajectory

KEPT = np.array([0, 1, 2, 4, 5, 7, 8])


@pytest.fixture
def run(tmp_path):
    rng = np.random.default_rng(0)
    sequence, results = tmp_path / "a room", tmp_path / "results"
    for kind in ("rgb", "depth"):
        (sequence / kind).mkdir(parents=True)
    results.mkdir()
    save_camera(
        sequence / "camera.yaml",
        Camera(90, 95, 79.5, 59.5, 160, 120, lens=radial_tangential_lens(0.1, -0.02, 0.001, 0, 0)),
    )
    stamps = 1305031100 + np.arange(9) / 10
    for stamp in stamps:
        cv2.imwrite(str(sequence / "rgb" / f"{stamp:.6f}.png"), rng.integers(0, 256, (120, 160, 3), dtype=np.uint8))
        cv2.imwrite(str(sequence / "depth" / f"{stamp:.6f}.png"), np.full((120, 160), 7500, np.uint16))
    T = se3.pose(se3.exp_so3(rng.normal(size=(7, 3))), 3 * rng.normal(size=(7, 3)))
    write_trajectory(results / "trajectory.txt", Trajectory(stamps[KEPT], T))
    frames = "".join(f"{k},{stamp:.6f}\n" for k, stamp in enumerate(stamps))
    (results / "frames.csv").write_text("index,timestamp\n" + frames)
    rows = np.array([[0, 1], [1, 2], [2, 3], [0, 6], [4, 6]])
    T_j_i = se3.inverse(T[rows[:, 1]]) @ T[rows[:, 0]]
    A = rng.normal(size=(5, 6, 6))
    write_g2o(results / "graph.g2o", KEPT, T, KEPT[rows], T_j_i, np.swapaxes(A, 1, 2) @ A + np.eye(6))
    write_ply(results / "cloud.ply", rng.normal(size=(500, 3)), rng.integers(0, 256, (500, 3), dtype=np.uint8))
    opened = open_sequence(sequence)
    model = Model(Results(results), opened)
    # What the file holds: nine decimals.
    return SimpleNamespace(
        results=results, sequence=sequence, model=model, T=model.trajectory.T_world_cam, rows=rows, kept=KEPT
    )
