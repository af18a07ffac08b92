"""Tables of images as other tools write them: every row is used, or a note or an error says why not."""

import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny_recordings import CAMERA

from miniloop_cli.datasets import open_sequence
from miniloop_cli.datasets.tables import read_table
from miniloop_cli.errors import InputError
from miniloop_cli.scene.sequence import NoteKind

STAMPS = {kind: [start + k / 10 for k in range(5)] for kind, start in (("rgb", 10), ("depth", 10.005))}


def rewrite(tum, row, encoding="utf-8", end="\n", first=""):
    for kind, stamps in STAMPS.items():
        text = first + end.join(row(f"{t:.6f}", f"{kind}/{t:.6f}.png") for t in stamps) + end
        (tum.root / f"{kind}.txt").write_bytes(text.encode(encoding))


def said(sequence, *kinds):
    return [str(note) for note in sequence.notes if note.kind in kinds]


WRITTEN = {
    "backslashes": {"row": lambda t, n: f"{t} " + n.replace("/", "\\")},
    "bare names": {"row": lambda t, n: f"{t} " + n.split("/")[1]},
    "quotes": {"row": lambda t, n: f'{t} "{n}"'},
    "quoted stamps": {"row": lambda t, n: f'"{t}", "{n}"'},
    "third column": {"row": lambda t, n: f"{t}\t{n}\t0.01"},
    "commas": {"row": lambda t, n: f"{t},{n}"},
    "commas and a header": {"row": lambda t, n: f"{t}, {n}, 3", "first": "timestamp,filename,exposure\n"},
    "semicolons and decimal commas": {"row": lambda t, n: f"{t.replace('.', ',')};{n}"},
    "another machine": {"row": lambda t, n: f"{t} /home/someone/data/seq/{n}"},
    "another machine's bare folder": {"row": lambda t, n: f"{t} /data/{n.split('/')[1]}"},
    "Windows": {"row": lambda t, n: f"{t} C:\\Users\\me\\seq\\" + n.replace("/", "\\"), "end": "\r\n"},
    "old Mac": {"row": lambda t, n: f"{t} {n}", "end": "\r"},
    "dots": {"row": lambda t, n: f"{t} ./{n}"},
    "UTF-16": {"row": lambda t, n: f"{t} {n}", "encoding": "utf-16", "end": "\r\n"},
    "UTF-8 with a mark": {"row": lambda t, n: f"{t} {n}", "encoding": "utf-8-sig", "first": "# images\n"},
    "four columns": {"row": lambda t, n: f"{t} {n} {t} depth/x.png"},
}


@pytest.mark.parametrize("written", WRITTEN.values(), ids=WRITTEN)
def test_files_are_found_however_they_are_written(tum, written):
    expected = open_sequence(tum.root).frames
    rewrite(tum, **written)
    assert open_sequence(tum.root).frames == expected


@pytest.mark.parametrize("depth_first", [False, True])
@pytest.mark.parametrize("color", ["rgb", "color"])
@pytest.mark.parametrize("name", ["associations.txt", "assoc.txt", "my_association.txt"])
def test_an_association_file_pairs_row_by_row(tum, color, depth_first, name):
    expected = open_sequence(tum.root).frames
    rows = [
        [f"{t:.6f} rgb/{t:.6f}.png", f"{u:.6f} depth/{u:.6f}.png"]
        for t, u in zip(STAMPS["rgb"], STAMPS["depth"], strict=False)
    ]
    tum.text(name, "\n".join(" ".join(row[::-1] if depth_first else row) for row in rows))
    (tum.root / "rgb.txt").unlink()
    (tum.root / "rgb").rename(tum.root / color)
    sequence = open_sequence(tum.root)
    assert [frame.color.path.name for frame in sequence.frames] == [frame.color.path.name for frame in expected]
    assert [frame.depth for frame in sequence.frames] == [frame.depth for frame in expected]
    assert said(sequence, NoteKind.PAIRED) == [f"5 pairs are read from {name}; differences of their stamps are ignored"]


@pytest.mark.parametrize("color", ["color", "rgb"])
def test_tables_are_named_after_the_folder(tum, color):
    expected = open_sequence(tum.root).frames
    (tum.root / "rgb").rename(tum.root / color)
    table = (tum.root / "rgb.txt").read_text().replace("rgb/", f"{color}/frame-")
    (tum.root / "rgb.txt").unlink()
    for path in (tum.root / color).iterdir():
        path.rename(path.with_name(f"frame-{path.name}"))
    tum.text(f"{color}.txt", table)
    frames = open_sequence(tum.root).frames
    assert [f.timestamp_s for f in frames] == [f.timestamp_s for f in expected]
    assert [f.color.path.name for f in frames] == [f"frame-{f.color.path.name}" for f in expected]


@pytest.mark.parametrize(("row", "count"), [("{t} {n} 0.01 3", 5), ("{t} {n}", 0), ('{t} "{n}" 0.01', 5)])
def test_further_columns_are_named(tum, row, count):
    rewrite(tum, lambda t, n: row.format(t=t, n=n))
    expected = (
        [f"5 of 5 rows of {kind}.txt have further columns, which are not used" for kind in STAMPS] if count else []
    )
    assert said(open_sequence(tum.root), NoteKind.UNUSED) == expected


@pytest.mark.parametrize(("rows", "kind"), [(3, NoteKind.DROPPED), (2, NoteKind.MOST_DROPPED)])
def test_a_table_of_fewer_images_than_the_folder_holds(tum, rows, kind):
    for name in ("rgb", "depth"):
        lines = (tum.root / f"{name}.txt").read_text().splitlines()
        tum.text(f"{name}.txt", "\n".join([line for line in lines if not line.startswith("#")][:rows]))
    assert [note.kind for note in open_sequence(tum.root).notes] == [kind, kind]


def test_an_association_may_use_a_depth_image_twice(tum):
    rows = [
        f"{t:.6f} rgb/{t:.6f}.png 10.{2 * (k // 2)}05 depth/10.{2 * (k // 2)}05000.png"
        for k, t in enumerate(STAMPS["rgb"])
    ]
    tum.text("associations.txt", "\n".join([*rows, rows[1]]))
    (tum.root / "depth.txt").unlink()
    sequence = open_sequence(tum.root)
    assert [f.depth.path.stem[:4] for f in sequence.frames] == ["10.0", "10.0", "10.2", "10.2", "10.4"]
    assert [f.color.path.stem[:4] for f in sequence.frames] == ["10.0", "10.1", "10.2", "10.3", "10.4"]
    assert said(sequence, NoteKind.DROPPED) == [
        f"1 of 6 rows of associations.txt repeat a stamp and are not used, the first: {tum.root}/associations.txt:6",
        "2 of 5 images in depth/ are not used, such as 10.105000.png: associations.txt has no usable row for them",
    ]


def test_a_folder_may_be_given_by_way_of_another(tum):
    there = tum.root / "rgb" / ".." / ".." / tum.root.name
    tum.text("rgb.txt", "".join((tum.root / "rgb.txt").read_text().splitlines(keepends=True)[:4]))
    (expected, found) = (open_sequence(root) for root in (tum.root, there))
    assert [str(note).replace(str(there), str(tum.root)) for note in found.notes] == [str(n) for n in expected.notes]
    assert all(frame.color.path.is_relative_to(there) for frame in found.frames)


def test_images_that_no_row_names_are_counted(tum):
    tum.text("rgb.txt", "".join((tum.root / "rgb.txt").read_text().splitlines(keepends=True)[:4]))
    assert said(open_sequence(tum.root), NoteKind.DROPPED) == [
        "3 pairs from 3 colour and 5 depth images, within 20 ms; the others have no partner",
        "2 of 5 images in rgb/ are not used, such as 10.300000.png: rgb.txt has no usable row for them",
    ]


def test_a_table_that_leads_to_no_file_is_at_fault(tum):
    rewrite(tum, lambda t, n: f"{t} images/{n}.bmp", first="# c\n")
    with pytest.raises(
        InputError, match=r"rgb\.txt:2: no such file: images/rgb/10\.0.*rgb/ holds 5 files, such as 10\.000"
    ):
        open_sequence(tum.root)


def test_single_rows_without_file_are_named(tum):
    (tum.root / "rgb/10.200000.png").unlink()
    sequence = open_sequence(tum.root)
    assert said(sequence, NoteKind.DROPPED) == [
        f"1 of 5 rows of rgb.txt name a missing file, the first: {tum.root}/rgb.txt:4 (rgb/10.200000.png)"
    ]


def test_repeated_stamps_are_counted(tum):
    rows = (tum.root / "rgb.txt").read_text() + "10.200000 rgb/10.300000.png\n"
    tum.text("rgb.txt", rows)
    sequence = open_sequence(tum.root)
    assert len(sequence.frames) == 5
    assert said(sequence, NoteKind.DROPPED) == [
        f"1 of 6 rows of rgb.txt repeat a stamp and are not used, the first: {tum.root}/rgb.txt:7"
    ]


def many(tiny, color_s, depth_s=None, scale=1.0, form="{:.6f}"):
    """A recording of as many frames as there are stamps (in s), written in units of 1 / scale s."""
    for kind, stamps in (("rgb", color_s), ("depth", color_s if depth_s is None else depth_s)):
        rows = []
        for k, t in enumerate(stamps):
            name = f"{kind}/{k:04d}.png"
            (tiny.color if kind == "rgb" else tiny.depth)(name)
            rows.append(f"{form.format(t * scale)} {name}\n")
        tiny.text(f"{kind}.txt", "".join(rows))
    tiny.text("camera.yaml", CAMERA)
    return tiny


@pytest.mark.parametrize(("scale", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
@pytest.mark.parametrize("start_s", [0, 1305031102.25])
@pytest.mark.parametrize("interval_s", [1 / 30, 0.3])
def test_units_are_converted_and_said(tiny, scale, name, start_s, interval_s):
    stamps_s = start_s + interval_s * np.arange(12)
    many(tiny, stamps_s, stamps_s + 0.004, scale, "{:.0f}")
    sequence = open_sequence(tiny.root)
    assert [f.timestamp_s for f in sequence.frames] == pytest.approx(stamps_s, abs=6e-4)
    assert [f.depth_timestamp_s for f in sequence.frames] == pytest.approx(stamps_s + 0.004, abs=6e-4)
    kind = NoteKind.CONVERTED if start_s else NoteKind.ASSUMED
    assert [f"apart: read as {name} and converted" in note for note in said(sequence, kind)] == [True]


def test_frame_numbers_in_tables(tiny):
    sequence = open_sequence(many(tiny, range(8), form="{:d}", scale=1).root)
    assert [f.timestamp_s for f in sequence.frames] == pytest.approx(np.arange(8) / 30)
    assert said(sequence, NoteKind.ASSUMED) == [
        "the stamps of rgb.txt are frame numbers: 30 frames a second are assumed"
    ]


def test_units_that_differ_or_cannot_be_told_are_refused(tiny):
    many(tiny, np.arange(0, 50, 5), form="{:d}", scale=1)
    with pytest.raises(InputError, match=r"rgb\.txt:1: the stamps are 5 apart: seconds, milliseconds or"):
        open_sequence(tiny.root)
    many(tiny, 0.3 * np.arange(10), form="{:.0f}", scale=1000)
    text = (tiny.root / "depth.txt").read_text().splitlines()
    tiny.text("depth.txt", "".join(f"{float(row.split()[0]) / 1000:.3f} {row.split()[1]}\n" for row in text))
    with pytest.raises(InputError, match=r"rgb\.txt is in milliseconds, depth\.txt in seconds"):
        open_sequence(tiny.root)


def test_lost_digits_are_refused_with_the_line(tiny):
    many(tiny, 1305031102.1 + np.arange(12) / 30, form="{:.0f}", scale=1)
    with pytest.raises(
        InputError, match=r"rgb\.txt:2: the stamp 1305031102 is repeated, as many are: digits were lost"
    ):
        open_sequence(tiny.root)
    many(tiny, 1305031102.1 + np.arange(12) / 30, form="{:.6g}", scale=1)
    with pytest.raises(InputError, match=r"rgb\.txt:2: the stamp 1\.30503e\+09 .*digits were lost"):
        open_sequence(tiny.root)


@pytest.mark.parametrize("phase_s", [0.0, 0.013])
def test_a_clock_that_starts_again_starts_a_new_part(tiny, phase_s):
    stamps_s = np.concatenate([np.arange(6) / 10, phase_s + np.arange(8) / 10])
    sequence = open_sequence(many(tiny, stamps_s, stamps_s + 0.002).root)
    assert [f.color.path.stem for f in sequence.frames] == [f"{k:04d}" for k in range(14)]
    assert [f.depth.path.stem for f in sequence.frames] == [f"{k:04d}" for k in range(14)]
    found_s = np.array([f.timestamp_s for f in sequence.frames])
    np.testing.assert_allclose(np.diff(found_s), [*[0.1] * 5, 10.002, *[0.1] * 7], atol=1e-9)
    assert [
        f"{tiny.root}/rgb.txt:7: the stamps from there on are shifted" in note
        for note in said(sequence, NoteKind.ASSUMED)
    ] == [True]


def test_a_clock_that_starts_again_in_one_table_only_is_refused(tiny):
    again_s = np.concatenate([np.arange(6), 0.13 + np.arange(6)]) / 10
    many(tiny, again_s, np.arange(12) / 10)
    with pytest.raises(InputError, match=r"rgb\.txt:7: the clock restarts here, but not as often in depth\.txt"):
        open_sequence(tiny.root)


@pytest.mark.slow
@settings(
    max_examples=int(os.environ.get("MINILOOP_FUZZ", "100")),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    deadline=None,
)
@given(st.data())
def test_made_up_tables_are_read_as_they_were_meant_or_refused(tmp_path, data):
    """Rows of known stamps and files, written in a drawn style: the style is the oracle, no parser is."""
    count = data.draw(st.integers(4, 12))
    start_s = data.draw(st.sampled_from([0.0, 12.5, 1305031102.25, 1714564803.5]))
    steps = data.draw(st.lists(st.floats(0.02, 1.5), min_size=count, max_size=count))
    times_s = np.round(start_s + np.cumsum(steps), 3)
    scale, form = data.draw(
        st.sampled_from([(1, "{:.3f}"), (1, "{:.6f}"), (1e3, "{:.0f}"), (1e6, "{:.0f}"), (1e9, "{:.0f}")])
    )
    between = data.draw(st.sampled_from([" ", "\t", ",", ", ", ";", "   "]))
    prefix = data.draw(st.sampled_from(["rgb/", "rgb\\", "", "./rgb/", "/data/me/rgb/", "C:\\me\\rgb\\", "seq/rgb/"]))
    blank = data.draw(st.booleans())
    quote = data.draw(st.sampled_from(['"', "'"] if blank and between != "\t" else ["", '"', "'"]))
    more = data.draw(st.sampled_from(["", "0.5", "0.5 x/y.png"]))
    names = [f"im{' ' * blank}{k}.png" for k in range(count)]
    (tmp_path / "rgb").mkdir(exist_ok=True)
    for name in names:
        (tmp_path / "rgb" / name).touch()
    stamps = [form.format(t * scale) for t in times_s]
    if scale == 1 and data.draw(st.booleans()) and not between.startswith(","):
        stamps = [stamp.replace(".", ",") for stamp in stamps]
    order = data.draw(st.permutations(range(count))) if data.draw(st.booleans()) else range(count)
    rows = [stamps[k] + between + quote + prefix + names[k] + quote + (between + more if more else "") for k in order]
    head = data.draw(st.sampled_from(["", "# made up", "timestamp filename", "\n"]))
    end = data.draw(st.sampled_from(["\n", "\r\n", "\r"]))
    encoding = data.draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))
    (tmp_path / "rgb.txt").write_bytes(end.join([head, *rows, ""]).encode(encoding))
    try:
        stream = read_table(tmp_path, "rgb.txt", ("rgb",))
    except InputError as error:
        raise AssertionError(f"refused: {error}") from error
    found = {source.path.name: stamp for source, stamp in zip(stream.sources, stream.times, strict=True)}
    assert found.keys() == set(names)
    if stream.unit is not None:  # else the recording is refused where nothing else tells
        read_s = [found[name] / stream.unit.per_s for name in names]
        np.testing.assert_allclose(read_s, times_s, atol=1e-5)
