"""thumbnails.npz: what tracking reads is kept small, comes back, and is what a page shows."""

import base64

import cv2
import numpy as np
import pytest

from miniloop_cli.datasets.thumbnails import thumbnail
from miniloop_cli.errors import InputError
from miniloop_cli.report.viewer.frame_pictures import FramePictures
from miniloop_cli.results.thumbnails import read_thumbnails, write_thumbnails


def gradient(height, width):
    v, u = np.mgrid[0:height, 0:width]
    return np.stack([255 * u / width, 255 * v / height, np.full(u.shape, 90)], axis=2).astype(np.uint8)


@pytest.mark.parametrize(("shape", "expected"), [((480, 640), (120, 160)), ((90, 120), (90, 120))])
def test_a_thumbnail_looks_like_its_image(shape, expected):
    image = gradient(*shape)
    small = cv2.imdecode(thumbnail(image), cv2.IMREAD_COLOR)[..., ::-1]
    assert small.shape[:2] == expected
    assert np.abs(small.astype(int) - gradient(*expected)).mean() < 4


def test_files_come_back_and_damage_is_told(tmp_path):
    files = {7: thumbnail(gradient(60, 80)), 3: thumbnail(gradient(480, 640))}
    path = tmp_path / "thumbnails.npz"
    assert read_thumbnails(path) == {}
    write_thumbnails(path, files)
    back = read_thumbnails(path)
    assert sorted(back) == [3, 7]
    for k, file in files.items():
        np.testing.assert_array_equal(back[k], file)
    good = dict(np.load(path))
    for change in ({"offsets": np.array([0, 5])}, {"frames": np.array([-1, 2])}, {"jpeg": np.zeros(3, np.uint8)}):
        np.savez(path, **(good | change))
        with pytest.raises(InputError, match="register"):
            read_thumbnails(path)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"thumbnails\.npz"):
        read_thumbnails(path)


def test_joined_beginnings_give_the_files_again():
    files = {k: thumbnail(np.roll(gradient(120, 160), 30 * k, axis=1)) for k in range(3)}
    large, small = FramePictures(files, {5: files[1]}).values()
    assert len(base64.b64decode(large["head"])) > 500  # the tables of JPEG, once
    for shown, k, file in [(large, "2", files[2]), (small, "5", files[1])]:
        # As the page does it: texts put together.
        assert base64.b64decode(shown["head"] + shown["files"][k]) == file.tobytes()
    assert FramePictures({}, {}).values() == [{"head": "", "files": {}}] * 2
