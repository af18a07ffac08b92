"""TUM folders: tables, association, what is refused and with which words."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from miniloop_cli.datasets import open_sequence, read_ground_truth, read_scan
from miniloop_cli.datasets.association import associate
from miniloop_cli.errors import InputError

REAL = os.environ.get("MINILOOP_TUM")


def test_opens_and_decodes(tiny):
    color = tiny.color("rgb/1.0.png")
    depth = tiny.depth("depth/1.01.png")
    depth[:, :10] = 0
    tiny.put("depth/1.01.png", depth)
    tiny.text("camera.yaml", "fx: 52\nfy: 52\ncx: 31\ncy: 23\nwidth: 64\nheight: 48\ndepth_scale: 1000\n")
    sequence = open_sequence(tiny.root)
    scan = read_scan(sequence, 0)
    assert sequence.name == "recording" and sequence.layout == "tum"
    assert sequence.frames[0].timestamp_s == 1.0 and sequence.frames[0].depth_timestamp_s == 1.01
    np.testing.assert_array_equal(scan.color, color)
    np.testing.assert_allclose(scan.depth_m, depth / 1000, rtol=1e-6)
    assert scan.depth_m.dtype == np.float32 and scan.mask is None
    assert read_ground_truth(sequence) is None


def test_tables_may_be_messy(tum):
    rows = (tum.root / "rgb.txt").read_text().splitlines()[1:]
    messy = "\ufeff# comment\r\n\r\n" + "\r\n".join(
        [*rows[::-1], "  # more", rows[2], f"{rows[1].split()[0]} rgb/none.png"]
    )
    tum.text("rgb.txt", messy)
    sequence = open_sequence(tum.root)
    assert [f.timestamp_s for f in sequence.frames] == pytest.approx([10, 10.1, 10.2, 10.3, 10.4])
    assert all(f.color.path.exists() for f in sequence.frames if f.timestamp_s != 10.1)
    assert read_scan(sequence, 4).color.shape == (48, 64, 3)


def test_names_are_stamps_without_tables(tum):
    with_tables = open_sequence(tum.root).frames
    (tum.root / "rgb.txt").unlink()
    (tum.root / "depth.txt").unlink()
    tum.color("rgb/thumbnail.png")
    assert open_sequence(tum.root).frames == with_tables


def test_frames_without_partner_are_dropped_and_noted(tum):
    names = [f"{10.005 + k / 10:.6f}" for k in range(5)]
    tum.text("depth.txt", "\n".join(f"{10 + k / 10 + 0.03 * (k == 2):.3f} depth/{names[k]}.png" for k in range(5)))
    sequence = open_sequence(tum.root)
    assert [round(f.timestamp_s, 1) for f in sequence.frames] == [10.0, 10.1, 10.3, 10.4]
    assert [str(note) for note in sequence.notes if note.doubtful] == [
        "4 pairs from 5 colour and 5 depth images, within 20 ms; the others have no partner"
    ]


@pytest.mark.parametrize(
    ("count", "kept"), [(1, [0]), (2, [0, 4]), (3, [0, 2, 4]), (4, [0, 1, 3, 4]), (9, [0, 1, 2, 3, 4])]
)
def test_max_frames_is_evenly_spaced(tum, count, kept):
    all_frames = open_sequence(tum.root).frames
    assert open_sequence(tum.root, max_frames=count).frames == tuple(all_frames[k] for k in kept)


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd", "rgb/../../secret.png"])
def test_rows_that_lead_outside_are_refused(tum, name):
    tum.text("rgb.txt", f"# c\n10.0 {name}\n")
    with pytest.raises(InputError, match=r"rgb\.txt:2 points outside the sequence"):
        open_sequence(tum.root)


def test_links_are_followed_only_inside(tum):
    target = tum.root / "rgb" / "10.000000.png"
    outside = tum.root.parent / "outside.png"
    target.rename(tum.root / "rgb" / "real.png")
    target.symlink_to("real.png")
    assert read_scan(open_sequence(tum.root), 0).color.shape == (48, 64, 3)
    (tum.root / "rgb" / "real.png").rename(outside)
    target.unlink()
    target.symlink_to(outside)
    with pytest.raises(InputError, match=r"points outside the sequence, to .*--follow-links"):
        open_sequence(tum.root)
    assert read_scan(open_sequence(tum.root, follow_links=True), 0).color.shape == (48, 64, 3)


def test_folders_that_are_links_into_a_store(tum):
    (tum.root / "depth").rename(tum.root.parent / "store")
    (tum.root / "depth").symlink_to(tum.root.parent / "store")
    with pytest.raises(InputError, match=r"depth/10\.005000\.png points outside .*--follow-links"):
        open_sequence(tum.root)
    assert len(open_sequence(tum.root, follow_links=True).frames) == 5


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("10.0\n", r"rgb\.txt:1: expected 'timestamp filename'"),
        ("abc rgb/1.png\n", r"rgb\.txt:1: expected a timestamp in seconds, found 'abc'"),
        ("# c\nnan rgb/1.png\n", r"rgb\.txt:2: the timestamp is nan"),
        ("1403636579763555584 rgb/10.000000.png\n", "nanoseconds"),
        ("10.0 rgb/\0.png\n", "impossible file"),
        ("# nothing\n", r"rgb\.txt names no images"),
        ("99.0 rgb/10.000000.png\n", r"no colour image has a depth image within 20 ms; .* 88\.595 s apart"),
    ],
)
def test_bad_tables_are_named(tum, table, words):
    tum.text("rgb.txt", table)
    with pytest.raises(InputError, match=words):
        open_sequence(tum.root)


def test_bad_folders_are_named(tmp_path, tum):
    with pytest.raises(InputError, match="does not exist"):
        open_sequence(tmp_path / "none")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is not a folder"):
        open_sequence(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is empty"):
        open_sequence(tmp_path / "empty")
    with pytest.raises(InputError, match=r"did you mean .*recording\?"):
        open_sequence(tmp_path)
    with pytest.raises(InputError, match="no supported layout"):
        open_sequence(tum.root / "rgb")
    with pytest.raises(InputError, match="did you mean 'tum'"):
        open_sequence(tum.root, layout="tun")
    with pytest.raises(InputError, match="does not exist"):
        open_sequence("a\0b")


def test_unusual_names_work(tmp_path, make_tum):
    tum = make_tum(tmp_path / os.fsdecode(b"sp ace \xff \xc3\xa9"))
    odd = os.fsdecode(b"rgb/odd \xfe name.png")
    (tum.root / "rgb/10.000000.png").rename(tum.root / odd)
    tum.text("rgb.txt", f"10.0 {odd}\n")
    assert read_scan(open_sequence(tum.root), 0).color.shape == (48, 64, 3)
    (tum.root / odd).write_bytes(b"")
    with pytest.raises(InputError) as error:
        read_scan(open_sequence(tum.root), 0)
    assert r"odd \udcfe name.png): empty file" in str(error.value).encode().decode()


def test_a_pipe_does_not_block(tum):
    (tum.root / "rgb.txt").unlink()
    os.mkfifo(tum.root / "rgb.txt")
    with pytest.raises(InputError, match="not an ordinary file"):
        open_sequence(tum.root)


def test_masks_remove_depth(tum):
    mask = np.zeros((48, 64), np.uint8)
    mask[10:20, 5:9] = 255
    tum.put("mask/10.100000.png", mask)
    sequence = open_sequence(tum.root)
    scan = read_scan(sequence, 1)
    assert read_scan(sequence, 0).mask is None and "masks for 1 of 5 frames" in str(sequence.notes[0])
    np.testing.assert_array_equal(scan.mask, mask > 0)
    assert (scan.depth_m[mask > 0] == 0).all() and (scan.depth_m[mask == 0] > 0).all()
    tum.put("mask/10.100000.png", mask[:20])
    with pytest.raises(InputError, match=r"frame 1 \(mask/10\.100000\.png\): the mask is 64 x 20, colour 64 x 48"):
        read_scan(sequence, 1)


def oracle(a: list[float], b: list[float], limit: float) -> list[tuple[int, int]]:
    """Smallest difference first, each stamp once, as the benchmark's own tool defines it."""
    candidates = sorted((abs(x - y), i, j) for i, x in enumerate(a) for j, y in enumerate(b) if abs(x - y) <= limit)
    pairs, left, right = [], set(range(len(a))), set(range(len(b)))
    for _, i, j in candidates:
        if i in left and j in right:
            left.remove(i)
            right.remove(j)
            pairs.append((i, j))
    return sorted(pairs)


stamps = st.lists(st.integers(0, 300), max_size=25, unique=True).map(lambda v: [x / 64 for x in sorted(v)])


@given(stamps, stamps, st.sampled_from([0.0, 1 / 64, 0.1]))
def test_association_equals_brute_force(a, b, limit):
    assert [tuple(p) for p in associate(a, b, limit).tolist()] == oracle(a, b, limit)


def test_association_is_bounded_where_stamps_crowd():
    crowd = np.linspace(0, 1e-3, 20_000)
    pairs = associate(crowd, crowd)
    np.testing.assert_array_equal(pairs, np.stack([np.arange(20_000)] * 2, 1))


@pytest.mark.real
@pytest.mark.skipif(not REAL, reason="MINILOOP_TUM is not set")
@pytest.mark.parametrize("name", ["freiburg1_xyz_100", "freiburg1_desk_100"])
def test_real_sequences_open(name):
    sequence = open_sequence(Path(REAL) / name)
    assert len(sequence.frames) == 100 and not sequence.notes
    assert sequence.camera.fx == 517.306408 and sequence.camera.lens.named["k3"] == 1.163314
    assert "freiburg1" in sequence.camera.source
    scan = read_scan(sequence, 50)
    assert 0.3 < np.median(scan.depth_m[scan.depth_m > 0]) < 3
    truth = read_ground_truth(sequence)
    assert truth.timestamps_s[0] < sequence.frames[0].timestamp_s < truth.timestamps_s[-1]
