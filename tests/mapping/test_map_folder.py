"""Maps on disk: whole, compact, checked, and never half of one and half of another."""

import json
import os
import signal
import time
from dataclasses import fields, replace

import numpy as np
import pytest
from map_scenes import small_map, small_part

from miniloop_cli.results import map_folder
from miniloop_cli.results.map_folder import MapError, manifest_hash, read_map, write_map

KILLS = 30


@pytest.fixture
def written(tmp_path):
    write_map(tmp_path, small_map())
    return tmp_path


def same(a, b):
    """Whether two values of a map are the same, arrays to the precision of what is kept."""
    if isinstance(a, np.ndarray):
        return a.dtype.kind in "US" or np.allclose(
            a.astype(float), b.astype(float), rtol=2e-3, atol=2e-3, equal_nan=True
        )
    if isinstance(a, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return a == b


def test_a_map_is_read_back_as_it_was_written(written):
    before, after = small_map(), read_map(written)
    assert same(before.parts, after.parts)
    assert same(before.joined, after.joined)
    assert (before.settings, before.seed) == (after.settings, after.seed)
    assert np.array_equal(before.parts[0].T_world_cam, after.parts[0].T_world_cam)
    write_map(written, after)
    assert same(read_map(written).parts, after.parts)


def test_pairs_are_packed_by_columns_and_read_by_rows(tmp_path):
    """Kernels are compiled for rows; packed by rows, matches take 40 % more."""
    scene_map = small_map()
    write_map(tmp_path, scene_map)
    path = max((tmp_path / "map").glob("*.npz"), key=lambda file: file.stat().st_size)
    with np.load(path) as stored:
        assert stored["edge_matches"].flags["F_CONTIGUOUS"] and len(stored["edge_matches"]) > 1
    matches = [part.edges.matches for part in read_map(tmp_path).parts]
    assert all(one.flags["C_CONTIGUOUS"] for one in matches)
    assert all(np.array_equal(a, b.edges.matches) for a, b in zip(matches, scene_map.parts, strict=True))


def test_writing_what_was_read_changes_no_file(written):
    write_map(written, read_map(written))
    before = {path.name: path.read_bytes() for path in (written / "map").iterdir()}
    write_map(written, read_map(written))
    assert {path.name: path.read_bytes() for path in (written / "map").iterdir()} == before


def test_every_damage_is_noticed(written, rng):
    for path in sorted((written / "map").iterdir()):
        content = path.read_bytes()
        for place in rng.integers(0, len(content), 20):
            changed = bytearray(content)
            changed[place] ^= 1 << int(rng.integers(8))
            path.write_bytes(changed)
            with pytest.raises(MapError, match=r"damaged|version|no manifest|holds"):
                read_map(written)
        path.write_bytes(content[: len(content) // 2])
        with pytest.raises(MapError):
            read_map(written)
        path.unlink()
        with pytest.raises(MapError, match=r"cannot be read|holds no map"):
            read_map(written)
        path.write_bytes(content)
    assert len(read_map(written).parts) == 1


def test_an_unknown_version_is_refused_by_name(written):
    path = written / "map" / "map.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"version": 7, "miniloop": "9.9"}))
    with pytest.raises(MapError, match=r"is of version 7 of maps, and miniloop .* reads version 2: .*'9\.9'"):
        read_map(written)


def test_nothing_is_ever_unpickled(written):
    import pickle

    path = next((written / "map").glob("*.npz"))
    path.write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(MapError, match="damaged"):
        read_map(written)


def test_a_write_that_ends_half_way_leaves_the_map_as_it_was(written, monkeypatch):
    before = manifest_hash(written)
    other = small_map("kitchen", 1)

    def killed(*arguments, **more):
        raise KeyboardInterrupt

    for name in ("part_arrays", "joined_arrays"):
        with monkeypatch.context() as patch:
            patch.setattr(map_folder, name, killed)
            with pytest.raises(KeyboardInterrupt):
                write_map(written, other)
        assert manifest_hash(written) == before
        assert read_map(written).parts[0].name == "hall"
    with monkeypatch.context() as patch:
        patch.setattr(map_folder.json, "dump", killed)
        with pytest.raises(KeyboardInterrupt):
            write_map(written, other)
    assert read_map(written).parts[0].name == "hall"
    write_map(written, other)
    assert read_map(written).parts[0].name == "kitchen"
    assert len(list((written / "map").iterdir())) == 3, "what no manifest names is removed"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_no_moment_to_be_killed_at_harms_the_map(written):
    """SIGKILL at random moments of a write: the old map or the new one is there, whole.

    On a busy machine a write takes long: moments are drawn until some came too early and some too late.
    """
    rng, maps = np.random.default_rng(0), {name: small_map(name, seed) for seed, name in enumerate(("hall", "kitchen"))}
    seen, longest_s = list[bool](), 0.03
    while len(seen) < KILLS or len(set(seen)) < 2:
        before = read_map(written).parts[0].name
        after = "kitchen" if before == "hall" else "hall"
        child = os.fork()
        if child == 0:
            write_map(written, maps[after])
            os._exit(0)
        time.sleep(rng.uniform(0, longest_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        now = read_map(written).parts[0].name
        assert now in (before, after)
        seen.append(now == after)
        longest_s *= 0.8 if all(seen) else 1.2 if not any(seen) else 1.0
    write_map(written, maps["hall"])
    assert len(list((written / "map").glob("*.npz"))) == 2


def test_a_crafted_map_leads_nowhere_else(written):
    path = written / "map" / "map.json"
    content = json.loads(path.read_text())
    del content["sha256"]
    for change in ({"name": "../.."}, {"file": "../../x.npz"}):
        crafted = content | {"recordings": [content["recordings"][0] | change]}
        path.write_text(json.dumps(crafted | {"sha256": map_folder._hash(crafted)}))
        with pytest.raises(MapError, match=r"names no folder|outside of the map"):
            read_map(written)


def test_a_reader_never_sees_half_of_two_maps(written, monkeypatch):
    """The map changes after the reader has read the manifest: it reads again, and gets all of the new one."""
    manifest = map_folder.read_manifest
    asked = []

    def overtaken(result):
        content = manifest(result)
        if not asked:
            asked.append(True)
            write_map(written, small_map("kitchen", 1))
        return content

    monkeypatch.setattr(map_folder, "read_manifest", overtaken)
    assert read_map(written).parts[0].name == "kitchen"


def test_a_keyframe_takes_no_more_than_it_may(tmp_path):
    """1200 features with descriptors that no compression makes smaller."""
    rng, part = np.random.default_rng(0), small_part(keyframes=1)
    n = 1200
    full = replace(
        part.features[0],
        px=rng.uniform(0, 640, (n, 2)), px_ideal=rng.uniform(0, 640, (n, 2)), z_m=rng.uniform(1, 4, n),
        slope=np.zeros((n, 2)), outline=rng.random(n) < 0.2, descriptors=rng.integers(0, 256, (n, 128), dtype=np.uint8),
    )  # fmt: skip
    from miniloop_cli.mapping.alone import map_of

    write_map(tmp_path, map_of(replace(part, features=(full,)), {}, 0))
    assert sum(path.stat().st_size for path in (tmp_path / "map").iterdir()) < 200_000 + 32 * 128 * 4 + 5_000
