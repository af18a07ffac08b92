"""A run says if depth lies beside colour; of registered depth, and of too few frames, it says nothing."""

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.runtime.artifact_store import Store
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.sequence import NoteKind
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.write import write_sequence
from miniloop_cli.stages.depth_beside_color import depth_beside_color
from miniloop_cli.stages.run import Run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    settings = SimulationSettings(frames=16, width=320, height=240)
    return write_sequence(tmp_path_factory.mktemp("beside") / "recording", settings, 5)


def notes(folder, store, most=None):
    return depth_beside_color(open_sequence(folder, max_frames=most), Run(Store(store), Workers(1, quiet=True)))


def test_registered_depth_is_no_note(folder, tmp_path):
    assert notes(folder, tmp_path) == ()


def test_shifted_depth_is_a_contradiction(folder, tmp_path):
    for path in sorted((folder / "depth").glob("*.png")):
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), np.pad(depth, ((0, 0), (9, 0)))[:, :-9])
    (note,) = notes(folder, tmp_path)
    assert note.kind == NoteKind.CONTRADICTED
    assert "depth is shifted against colour: it fits when moved by (-9, " in note.text
    assert notes(folder, tmp_path, most=4) == ()
