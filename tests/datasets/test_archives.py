"""Archives read as folders: the same frames as from the folder, nothing unpacked, damage named."""

import io
import pickle
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from miniloop_cli.datasets import ImageFile, open_sequence, read_scan
from miniloop_cli.datasets.archive_path import ArchivePath, inside
from miniloop_cli.datasets.paths import read_bytes
from miniloop_cli.errors import InputError
from tests.datasets.tiny_recordings import Tiny, fill_tum

QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def zipped(folder: Path, path: Path, top: str = "", compression: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for file in sorted(folder.rglob("*")):
            archive.write(file, f"{top}{file.relative_to(folder).as_posix()}")
    return path


def tarred(folder: Path, path: Path, mode: str) -> Path:
    with tarfile.open(path, mode) as archive:
        archive.add(folder, "scan")
    return path


def packed(folder: Path, path: Path) -> Path:
    if path.suffix == ".zip":
        return zipped(folder, path, "scan/")
    return tarred(folder, path, {".tar": "w", ".tgz": "w:gz", ".bz2": "w:bz2", ".xz": "w:xz"}[path.suffix])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINILOOP_CACHE", str(tmp_path / "cache"))
    return fill_tum(Tiny(tmp_path / "scan")).root


@pytest.mark.parametrize("name", ["a.zip", "a.tar", "a.tgz", "a.tar.bz2", "a.tar.xz", "A.ZIP"])
def test_frames_of_an_archive_are_those_of_the_folder(folder, tmp_path, name):
    path = tmp_path / name
    packed(folder, path) if name != "A.ZIP" else zipped(folder, path, "scan/")
    sequence, expected = open_sequence(path), open_sequence(folder)
    assert sequence.name == "scan" and sequence.camera == expected.camera
    assert [f.timestamp_s for f in sequence.frames] == [f.timestamp_s for f in expected.frames]
    for k, frame in enumerate(sequence.frames):
        a, b = read_scan(sequence, k), read_scan(expected, k)
        assert np.array_equal(a.color, b.color) and np.array_equal(a.depth_m, b.depth_m)
        assert frame.color.fingerprint() == expected.frames[k].color.fingerprint()  # finished work is shared
        assert frame.color.header() == expected.frames[k].color.header()
        assert pickle.loads(pickle.dumps(frame)) == frame
    unpacked = list((tmp_path / "cache").rglob("*.tar"))
    assert bool(unpacked) == (name not in ("a.zip", "a.tar", "A.ZIP"))
    assert any("decompressed" in str(note) for note in sequence.notes) == bool(unpacked)


def test_an_archive_without_a_top_folder_is_named_after_its_file(folder, tmp_path):
    sequence = open_sequence(zipped(folder, tmp_path / "my.scan.zip"))
    assert sequence.name == "my.scan" and len(sequence.frames) == 5


def test_masks_in_an_archive_are_used(folder, tmp_path):
    for path in sorted((folder / "rgb").iterdir()):
        Tiny(folder).color(f"mask/{path.name}")
    sequence = open_sequence(zipped(folder, tmp_path / "a.zip"))
    assert all(frame.mask is not None for frame in sequence.frames)
    assert read_scan(sequence, 0).mask.any()


def test_what_a_mac_adds_is_passed_over(folder, tmp_path):
    path = zipped(folder, tmp_path / "a.zip", "scan/")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("__MACOSX/scan/._rgb.txt", b"x")
        archive.writestr(".DS_Store", b"x")
    assert open_sequence(path).name == "scan"


@pytest.mark.parametrize("name", ["../rgb/1.png", "/etc/passwd", "..\\1.png", "C:/1.png", "scan/../../1.png"])
def test_members_that_lead_out_of_the_folder_are_refused(folder, tmp_path, name):
    path = zipped(folder, tmp_path / "a.zip", "scan/")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, b"x")
    with pytest.raises(InputError, match="points outside the folder"):
        open_sequence(path)
    with tarfile.open(tmp_path / "a.tar", "w") as archive:
        archive.addfile(tarfile.TarInfo(name), io.BytesIO())
    with pytest.raises(InputError, match="points outside the folder"):
        open_sequence(tmp_path / "a.tar")


def test_doubled_members_and_files_that_are_folders_are_refused(folder, tmp_path):
    path = zipped(folder, tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("./rgb.txt", b"x")
    with pytest.raises(InputError, match=r"two members are called rgb\.txt"):
        open_sequence(path)
    path = zipped(folder, tmp_path / "b.zip")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("rgb", b"x")
    with pytest.raises(InputError, match="both a file and a folder"):
        open_sequence(path)


def test_links_are_not_followed_and_said(folder, tmp_path):
    path = tarred(folder, tmp_path / "a.tar", "w")
    with tarfile.open(path, "a") as archive:
        link = tarfile.TarInfo("scan/secret.png")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(link)
    sequence = open_sequence(path)
    assert any("1 members of a.tar are links" in str(note) for note in sequence.notes)
    assert not ArchivePath(sequence.root / "secret.png").exists()


@pytest.mark.slow
def test_a_bomb_costs_no_memory(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("rgb/1.png", "w") as member:
        for _ in range(200):
            member.write(bytes(1 << 20))
    source = ImageFile(ArchivePath(path) / "rgb/1.png")
    with pytest.raises(InputError, match="claims 200 MB"):
        source.read()
    with pytest.raises(InputError, match="claims 200 MB"):
        source.header()
    assert source.fingerprint() == "unreadable"


def test_a_member_that_claims_less_than_it_holds_is_damaged(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.txt", bytes(100_000))
    data = (tmp_path / "a.zip").read_bytes()
    size = (100_000).to_bytes(4, "little")
    (tmp_path / "a.zip").write_bytes(data.replace(size, (10).to_bytes(4, "little")))
    with pytest.raises(InputError, match="damaged in the archive"):
        read_bytes(inside(tmp_path / "a.zip") / "a.txt")


def test_encrypted_members_are_named(folder, tmp_path):
    path = zipped(folder, tmp_path / "a.zip")
    data = bytearray(path.read_bytes())
    at = data.index(b"PK\x01\x02", 0)
    data[at + 8] |= 1
    path.write_bytes(data)
    names = zipfile.ZipFile(path).namelist()
    with pytest.raises(InputError, match="encrypted"):
        read_bytes(ArchivePath(path) / names[0])


def test_an_archive_that_is_none(tmp_path):
    for name in ("a.zip", "a.tar", "a.tgz", "a.tar.xz"):
        (tmp_path / name).write_bytes(b"this is no archive " * 100)
        with pytest.raises(InputError, match=f"{name} is damaged, incomplete or not an archive"):
            open_sequence(tmp_path / name)


@QUICK
@given(name=st.sampled_from(["a.zip", "a.tar", "a.tgz", "a.tar.xz"]), cut=st.floats(0, 1), flips=st.binary(max_size=6))
def test_damaged_archives_give_one_line_or_frames(folder, tmp_path, name, cut, flips):
    whole = tmp_path / f"whole-{name}"
    if not whole.exists():
        packed(folder, whole)
    data = bytearray(whole.read_bytes())
    for flip in flips:
        data[(flip * 7919) % len(data)] ^= flip | 1
    path = tmp_path / name
    path.write_bytes(data[: int(len(data) * (cut if cut < 0.8 else 1))])
    try:
        sequence = open_sequence(path)
    except InputError as error:
        assert "\n" not in str(error) and name in str(error)
        return
    for k in range(len(sequence.frames)):
        try:
            read_scan(sequence, k)
        except InputError as error:
            assert "frame" in str(error)
