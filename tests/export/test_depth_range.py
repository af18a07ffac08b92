"""No depth that the run did not use is written as measured: marks of no reading, and what is out of its range."""

import json

import cv2
import numpy as np
import pytest

from miniloop_cli.config import Settings
from miniloop_cli.datasets import open_sequence
from miniloop_cli.export.colmap import write_colmap
from miniloop_cli.export.model import Model
from miniloop_cli.export.nerfstudio import write_nerfstudio
from miniloop_cli.results.folder import Results


def colmap_depth(folder):
    data = sorted((folder / "stereo" / "depth_maps").iterdir())[0].read_bytes().split(b"&", 3)[3]
    return np.frombuffer(data, "<f4").reshape(120, 160)


def nerfstudio_depth(folder):
    data = json.loads((folder / "transforms.json").read_text())
    image = cv2.imread(str(folder / data["frames"][0]["depth_file_path"]), cv2.IMREAD_UNCHANGED)
    return image * data["depth_unit_scale_factor"]


WRITERS = [(write_colmap, colmap_depth), (write_nerfstudio, nerfstudio_depth)]


def redrawn(run, suffix, values):
    """The model with other depth images: columns of the given stored values."""
    for path in (run.sequence / "depth").iterdir():
        stored = np.repeat(values, 160 // len(values))[None].repeat(120, 0)
        stored[:, 40:120] += np.arange(120).astype(stored.dtype)[:, None] * stored.dtype.type(stored[0, 40] / 2000)
        path.unlink()
        if suffix == ".npy":
            np.save(path.with_suffix(suffix), stored)
        else:
            cv2.imwrite(str(path.with_suffix(suffix)), stored)
    return Model(Results(run.results), open_sequence(run.sequence))


@pytest.mark.parametrize(("write", "depth_of"), WRITERS)
@pytest.mark.parametrize("no_reading", [65535, 39990])
def test_no_reading_is_none_in_every_export(run, tmp_path, write, depth_of, no_reading):
    model = redrawn(run, ".png", np.array([7500, 7500, 8000, no_reading], np.uint16))
    write(model, tmp_path / "out")
    depth = depth_of(tmp_path / "out")
    assert depth.max() < 1.7 and depth[60, 60] == pytest.approx(1.5, abs=0.1)
    assert (depth[20:100, 130:150] == 0).all()


@pytest.mark.parametrize(("write", "depth_of"), WRITERS)
def test_floating_point_depth_is_written_in_the_range_of_the_run(run, tmp_path, write, depth_of):
    settings = Settings()
    depth = settings.depth.model_copy(update={"min_m": 1.0, "max_m": 2.0})
    data = settings.model_copy(update={"depth": depth}).model_dump(mode="json")
    (run.results / "config.yaml").write_text(json.dumps(data))
    (run.results / "summary.json").write_text(json.dumps({"frames": 9}))
    model = redrawn(run, ".npy", np.array([0.6, 1.5, 1.75, 3.2], np.float32))
    write(model, tmp_path / "out")
    columns = depth_of(tmp_path / "out")[60, [20, 60, 100, 140]]
    np.testing.assert_allclose(columns, [0, 1.55, 1.8, 0], atol=0.06)
