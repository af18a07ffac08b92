"""Colour images that no depth image belongs to: counted, told, and put among the frames where points are followed."""

from pathlib import Path

import numpy as np
import pytest
from tiny_recordings import Tiny

from miniloop_cli.datasets import ImageFile, open_sequence, read_scan
from miniloop_cli.datasets.pairing import pair
from miniloop_cli.datasets.stream import Stream
from miniloop_cli.errors import InputError
from miniloop_cli.scene.no_depth import NoDepth
from miniloop_cli.scene.sequence import NoteKind

COLOR_MS = (0, 33, 67, 100, 133, 167, 200)
DEPTH_MS = (70, 103, 170, 260)


@pytest.fixture
def folder(tmp_path):
    """Colour from 0 s on, depth from 0.07 s on; one depth image lost, and one after the end of colour."""
    tiny = Tiny(tmp_path)
    for kind, make, times_ms in (("rgb", tiny.color, COLOR_MS), ("depth", tiny.depth, DEPTH_MS)):
        for ms in times_ms:
            make(f"{kind}/{10 + ms / 1000:.6f}.png")
        tiny.text(f"{kind}.txt", table(kind, times_ms))
    tiny.text("camera.yaml", "{fx: 60, fy: 60, cx: 31.5, cy: 23.5, width: 64, height: 48, depth_scale: 1000}\n")
    return tmp_path


def table(kind, times_ms):
    return "".join(f"{10 + ms / 1000:.6f} {kind}/{10 + ms / 1000:.6f}.png\n" for ms in times_ms)


def stamps_ms(sequence):
    return np.round(1000 * (sequence.stamps_s - 10)).astype(int).tolist()


def test_they_are_left_out_and_told(folder):
    sequence = open_sequence(folder)
    assert stamps_ms(sequence) == [67, 100, 167] and sequence.available == (7, 4)
    said = [note.text for note in sequence.notes if note.kind == NoteKind.MOST_DROPPED or note.kind == NoteKind.DROPPED]
    assert said == ["3 pairs from 7 colour and 4 depth images, within 20 ms; the others have no partner"]


def test_they_stand_among_the_frames_where_points_are_followed(folder):
    sequence = open_sequence(folder)
    whole, rows = sequence.with_color_only()
    assert stamps_ms(whole) == list(COLOR_MS) and whole.color_only is None
    assert [whole.frames[k] for k in rows] == list(sequence.frames)
    alone = [k for k, frame in enumerate(whole.frames) if isinstance(frame.depth, NoDepth)]
    assert sorted([*alone, *rows.tolist()]) == list(range(7))
    for k in alone:
        scan = read_scan(whole, k)
        assert scan.color.shape == (48, 64, 3) and not scan.depth_m.any() and scan.depth_m.shape == (48, 64)
    told = [note.text for note in whole.notes if "images" in note.text]
    assert told == [
        "4 colour images have no depth image within 20 ms: their poses come from tracked points alone",
        "1 of 4 depth images have no colour image within 20 ms",
    ]


def test_of_equal_stamps_one_image_is_used():
    """The clocks of some recorders stand still: their bags hold two images of one stamp."""

    def stream(where, times_s):
        sources = tuple(ImageFile(Path(f"{where}/{k}.png")) for k in range(len(times_s)))
        return Stream(where, sources, tuple(map(str, range(len(times_s)))), times=np.array(times_s))

    color, depth = stream("color", [10.0, 10.1, 10.1, 10.2, 10.3, 10.3]), stream("depth", [10.0, 10.1, 10.4])
    found = pair(Path("bag"), color, depth)
    assert [frame.timestamp_s for frame in found.frames] == [10.0, 10.1]
    assert [frame.color for frame in found.color_only.frames] == [color.sources[3], color.sources[4]]
    assert [note.text for note in found.color_only.taken_in] == [
        "2 colour images have no depth image within 20 ms: their poses come from tracked points alone",
        "2 colour images repeat a stamp",
        "1 of 3 depth images have no colour image within 20 ms",
    ]


def test_masks_concern_them_too(folder):
    Tiny(folder).put("mask/10.133000.png", np.full((48, 64), 255, np.uint8))
    whole, _ = open_sequence(folder).with_color_only()
    assert [k for k, frame in enumerate(whole.frames) if frame.mask] == [4]
    assert read_scan(whole, 4).mask.all()


def test_a_recording_without_such_images_is_as_it_was(folder):
    (folder / "rgb.txt").write_text(table("rgb", (67, 100, 167)))
    sequence = open_sequence(folder)
    assert sequence.color_only is None
    whole, rows = sequence.with_color_only()
    assert whole is sequence and rows.tolist() == [0, 1, 2]


def test_a_link_that_leads_out_is_refused_for_them_too(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    Tiny(elsewhere).color("secret.png")
    inside = folder / "rgb" / "10.133000.png"
    inside.unlink()
    inside.symlink_to(elsewhere / "secret.png")
    with pytest.raises(InputError, match="points outside the sequence"):
        open_sequence(folder)
