"""What names say, and which images belong together: every file is used, or a note or an error says why not."""

from datetime import UTC, datetime

import numpy as np
import pytest

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.file_names import keys_of
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import NoteKind

COUNT = 10
TIMES_S = 1305031102.175304 + np.cumsum(np.random.default_rng(0).uniform(0.03, 0.04, COUNT))


def record(tiny, color_name, depth_name=None, color="color", depth="depth", count=COUNT):
    depth_name = depth_name or color_name
    for k in range(count):
        tiny.color(f"{color}/{color_name(k)}.png")
        tiny.depth(f"{depth}/{depth_name(k)}.png")
    tiny.text("camera.yaml", "fx: 52\nfy: 52\ncx: 31\ncy: 23\nwidth: 64\nheight: 48\ndepth_scale: 5000\n")
    return tiny


def said(sequence, *kinds):
    return [str(note) for note in sequence.notes if note.kind in kinds]


NUMBERED = {
    "camera and number": lambda k: f"cam0_{k:06d}",
    "sensor": lambda k: f"d435i_color_{k:06d}",
    "date and number": lambda k: f"2024-05-01_{k:06d}",
    "resolution after": lambda k: f"{k}_640x480",
    "not padded": lambda k: f"frame{k}",
    "compact date and number": lambda k: f"20240501_{k:06d}",
}


@pytest.mark.parametrize("name", NUMBERED.values(), ids=NUMBERED)
@pytest.mark.parametrize("folder", ["color", "image", "images", "colour", "cam0", "rgb"])
def test_the_number_that_varies_is_the_frame(tiny, name, folder):
    sequence = open_sequence(record(tiny, name, color=folder).root)
    assert [frame.timestamp_s for frame in sequence.frames] == pytest.approx(np.arange(COUNT) / 30)
    assert [frame.color.path.stem for frame in sequence.frames] == [name(k) for k in range(COUNT)]
    assert said(sequence, NoteKind.DROPPED) == []
    assert said(sequence, NoteKind.ASSUMED) == ["the frames have no time stamps: 30 frames a second are assumed"]


TIMED = {
    "decimal seconds": lambda t: f"{t:.6f}",
    "after a constant": lambda t: f"cam1_{t:.6f}",
    "microseconds": lambda t: f"{round(t * 1e6)}",
    "nanoseconds": lambda t: f"rgb-{round(t * 1e6)}000",
    "milliseconds": lambda t: f"{round(t * 1e3)}",
    "seconds and nanoseconds": lambda t: f"{int(t)}_{round(t % 1 * 1e6):06d}000",
    "date": lambda t: datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%d_%H-%M-%S.%f"),
    "compact date": lambda t: datetime.fromtimestamp(t, UTC).strftime("%Y%m%dT%H%M%S%f"),
}


@pytest.mark.parametrize("name", TIMED.values(), ids=TIMED)
@pytest.mark.parametrize("folder", ["color", "rgb"])
def test_times_in_names_are_stamps(tiny, name, folder):
    tiny = record(tiny, lambda k: name(TIMES_S[k]), lambda k: name(TIMES_S[k] + 0.003), color=folder)
    (tiny.root / "depth" / f"{name(TIMES_S[4] + 0.003)}.png").unlink()
    sequence = open_sequence(tiny.root)
    assert [frame.timestamp_s for frame in sequence.frames] == pytest.approx(np.delete(TIMES_S, 4), abs=6e-4)
    delays = [frame.depth_timestamp_s - frame.timestamp_s for frame in sequence.frames]
    assert delays == pytest.approx([0.003] * 9, abs=1.1e-3)
    assert said(sequence, NoteKind.DROPPED, NoteKind.ASSUMED) == [
        "9 pairs from 10 colour and 9 depth images, within 20 ms; the others have no partner"
    ]


def test_a_date_to_the_second_is_a_time(tiny):
    sequence = open_sequence(record(tiny, lambda k: f"2024-05-01_12-00-{3 * k:02d}").root)
    start = datetime(2024, 5, 1, 12, tzinfo=UTC).timestamp()
    assert [frame.timestamp_s - start for frame in sequence.frames] == list(range(0, 30, 3))


def test_two_files_of_one_number_are_refused_by_name(tiny):
    record(tiny, lambda k: f"take{k // 5}_{k % 5:04d}")
    with pytest.raises(
        InputError, match=r"color has 10 files, .*take0_0000\.png and take1_0000\.png have the same number"
    ):
        open_sequence(tiny.root)


def test_files_named_otherwise_are_counted(tiny):
    record(tiny, lambda k: f"{k:04d}")
    tiny.color("color/preview.png")
    tiny.text("depth/list.txt", "")
    sequence = open_sequence(tiny.root)
    assert len(sequence.frames) == COUNT
    assert said(sequence, NoteKind.DROPPED) == [
        "1 of 11 files in color/ are not named like the others and not used: preview.png"
    ]
    assert said(sequence, NoteKind.UNUSED) == [
        "1 files in depth/ are not used, such as list.txt: their suffixes are not supported"
    ]


@pytest.mark.parametrize("folder", ["color", "rgb"])
def test_a_folder_without_usable_files_names_one(tiny, folder):
    record(tiny, lambda k: f"{k:04d}", color=folder, count=2)
    for path in (tiny.root / folder).iterdir():
        path.rename(path.with_suffix(".heic"))
    with pytest.raises(InputError, match=rf"{folder} has 2 files, none usable: 0000\.heic is none of \.png"):
        open_sequence(tiny.root)
    for path in (tiny.root / folder).iterdir():
        path.rename(path.with_name(path.stem.replace("000", "abc").replace("0", "a").replace("1", "b") + ".png"))
    with pytest.raises(InputError, match=r"none usable: abca\.png is neither a number nor a time"):
        open_sequence(tiny.root)


def redwood(tiny, times_name, lost, offset_us=2000):
    kept = [k for k in range(COUNT) if k not in lost]
    for n, k in enumerate(kept):
        tiny.color(f"image/{times_name(n + 1, 33333 * k)}.png")
    for k in range(COUNT):
        tiny.depth(f"depth/{times_name(k + 1, 33333 * k + offset_us)}.png")
    tiny.text("camera.yaml", "fx: 52\nfy: 52\ncx: 31\ncy: 23\nwidth: 64\nheight: 48\ndepth_scale: 5000\n")
    return kept


@pytest.mark.parametrize("start_us", [0, 1_000_000_000])
def test_counters_of_their_own_are_paired_by_microseconds(tiny, start_us):
    kept = redwood(tiny, lambda n, us: f"{n:07d}-{start_us + us:012d}", lost={2, 3, 7})
    sequence = open_sequence(tiny.root)
    assert [f.timestamp_s for f in sequence.frames] == pytest.approx([(start_us + 33333 * k) / 1e6 for k in kept])
    assert [f.depth_timestamp_s - f.timestamp_s for f in sequence.frames] == pytest.approx([0.002] * len(kept))
    assert any("7 pairs from 7 colour and 10 depth images, within 20 ms" in str(note) for note in sequence.notes)


@pytest.mark.parametrize("color", ["image", "rgb"])
def test_counters_of_their_own_without_times_are_refused(tiny, color):
    redwood(tiny, lambda n, us: f"{n:07d}", lost={2, 3})
    (tiny.root / "image").rename(tiny.root / color)
    with pytest.raises(
        InputError, match=rf"{color}/ has 8 images from 1 to 8 and depth/ 10 from 1 to 10, both without"
    ):
        open_sequence(tiny.root)


@pytest.mark.parametrize("first", [0, 1, 2])
def test_counters_that_begin_differently_are_refused_unless_it_is_plain_why(tiny, first):
    record(tiny, lambda k: f"{k:04d}", lambda k: f"{k + first:04d}")
    if first == 1:
        with pytest.raises(InputError, match="color/ has 10 images from 0 to 9 and depth/ 10 from 1 to 10"):
            open_sequence(tiny.root)
    else:
        assert len(open_sequence(tiny.root).frames) == COUNT - first


def test_a_preview_beside_each_depth_image_is_refused_by_name(tiny):
    record(tiny, lambda k: f"{k:04d}", count=3)
    for path in list((tiny.root / "depth").iterdir()):
        np.save(path.with_suffix(".npy"), np.ones((48, 64), np.float32))
    with pytest.raises(
        InputError, match=r"depth has 6 files, none usable: 0000\.npy and 0000\.png have the same number"
    ):
        open_sequence(tiny.root)


@pytest.mark.parametrize("name", [lambda k: f"{k:04d}", lambda k: f"{TIMES_S[k]:.6f}"], ids=["numbers", "times"])
@pytest.mark.parametrize(("removed", "kind"), [(6, NoteKind.DROPPED), (7, NoteKind.MOST_DROPPED)])
def test_a_recording_that_is_used_for_its_smaller_part_is_told_apart(tiny, name, removed, kind):
    """Of ten colour images so many have no depth: of 14 images in all, 6 are not used; of 13, it is 7."""
    record(tiny, name)
    for k in range(1, 1 + removed):
        (tiny.root / f"depth/{name(k)}.png").unlink()
    text = f"{10 - removed} pairs from 10 colour and {10 - removed} depth images"
    for frames in (None, 2):
        notes = open_sequence(tiny.root, max_frames=frames).notes
        assert [note.kind for note in notes if note.text.startswith(text)] == [kind]


def test_gaps_in_the_numbers_show_what_is_missing(tiny):
    record(tiny, lambda k: f"{k:04d}")
    for k in (3, 9):
        (tiny.root / f"depth/{k:04d}.png").unlink()
    sequence = open_sequence(tiny.root)
    assert [f.color.path.stem for f in sequence.frames] == [f.depth.path.stem for f in sequence.frames]
    assert said(sequence, NoteKind.DROPPED) == [
        "8 pairs from 10 colour and 8 depth images, by their numbers; the others have no partner"
    ]


def test_milliseconds_that_do_not_agree_are_paired_as_times(tiny):
    sequence = open_sequence(record(tiny, lambda k: f"{33 * k + k % 2}", lambda k: f"{33 * k + 5}").root)
    assert [f.timestamp_s for f in sequence.frames] == pytest.approx([(33 * k + k % 2) / 1e3 for k in range(COUNT)])


def test_times_beside_numbers_are_refused(tiny):
    record(tiny, lambda k: f"{TIMES_S[k]:.6f}", lambda k: f"{k:04d}")
    with pytest.raises(InputError, match="color/ is named by times, depth/ by numbers"):
        open_sequence(tiny.root)


def test_a_counter_tells_that_the_clock_started_again(tiny):
    times_us = [*range(0, 200_000, 33_333), *range(11_000, 150_000, 33_333)]
    record(tiny, lambda k: f"{k:05d}-{times_us[k]:09d}", count=len(times_us))
    sequence = open_sequence(tiny.root)
    assert [f.color.path.stem[:5] for f in sequence.frames] == [f"{k:05d}" for k in range(len(times_us))]
    stamps = [f.timestamp_s for f in sequence.frames]
    assert np.diff(stamps)[6] == pytest.approx(10) and np.diff(stamps).min() > 0
    assert any("the clock restarts at color/00007-" in note for note in said(sequence, NoteKind.ASSUMED))


def test_names_alone():
    keys = keys_of(["b_2", "b_10", "b_9"])
    assert keys.numbers.tolist() == [2, 10, 9] and keys.times is None and keys.odd == ()
    assert keys_of(["only_7"]).numbers.tolist() == [7]
    assert keys_of(["1.0"]).times.tolist() == [1.0]
    assert keys_of([f"{k}-{33333 * k}" for k in range(5)]).unit.name == "microseconds"
    with pytest.raises(InputError, match="a1 and b1 are not named alike"):
        keys_of(["a1", "b1"])
