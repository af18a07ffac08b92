"""Rough poses of a recording in the formats of other tools."""

import logging

import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.priors import read_priors
from miniloop_cli.errors import InputError

COUNT = 5


@pytest.fixture
def sequence(tiny):
    for k in range(COUNT):
        tiny.color(f"color/{k}.png", 640, 480)
        tiny.depth(f"depth/{k}.png", 640, 480)
    return open_sequence(tiny.root)


def test_matrices_serve_the_frames_by_number(tiny, sequence, caplog):
    text = "".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(COUNT))
    with caplog.at_level(logging.INFO, "miniloop"):
        priors = read_priors(sequence, poses=tiny.text("poses.txt", text))
    assert priors.T_world_cam[:, 0, 3].tolist() == list(range(COUNT))
    assert f"pose prior: KITTI (3 x 4), by frame number ({COUNT}: frames of the recording)" in caplog.messages


def test_another_number_of_matrices_is_refused(tiny, sequence):
    with pytest.raises(InputError, match=r"its 3 poses are not one a frame \(5 frames of the recording\)"):
        read_priors(sequence, poses=tiny.text("poses.txt", 3 * "1 0 0 0 0 1 0 0 0 0 1 0\n"))


def test_milliseconds_are_laid_on_the_frames(tiny, sequence):
    text = "".join(f"{20 * k} {k} 0 0 0 0 0 1\n" for k in range(20))
    priors = read_priors(sequence, poses=tiny.text("poses.txt", text))
    np.testing.assert_allclose(priors.T_world_cam[:, 0, 3], np.arange(COUNT) / 30 / 0.02)
