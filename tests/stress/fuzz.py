"""Damaged and made-up files for everything that reads: `python tests/stress/fuzz.py [INPUTS] [SEED]`.

Sound files are mutated (bytes and ranges changed, doubled, removed; words that break parsers put in; of PNG files half
with their checksums set right again) and given to the readers, and results folders with one damaged file to what eval,
export and report do with them. Each input must end in a MiniloopError of one line or in success: no other exception,
within 10 s, within 1 GB. Inputs that do not are kept. `--atheris TARGET` lets atheris choose the bytes instead, where
it is installed (INPUTS runs, guided by coverage of miniloop_cli).
"""

import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "cli"))
from command_line import ROOT, command, environment

sys.path.append(str(ROOT))

SECONDS, MEGABYTES = 10, 1024
PARSERS = [  # what atheris watches: not compiled kernels, whose bytecode must stay as it is
    *(
        f"miniloop_cli.datasets.{name}"
        for name in ("association", "camera_files", "images", "intrinsics", "paths", "trajectory", "tum")
    ),
    *(f"miniloop_cli.{name}" for name in ("config", "runtime.safe_yaml", "evaluation", "results.g2o", "results.ply")),
]
WORDS = [
    *(
        b"nan",
        b"-inf",
        b"1e400",
        b"-1",
        b"0",
        b"99999999999999999999",
        b"1_0",
        b"0x10",
        b"",
        b"\0",
        b"\xff",
        b"\n",
        b" ",
    ),
    *(
        b"\xff",
        b" ",
        b"\r\n",
        b"\xef\xbb\xbf",
        "é١".encode(),
        b",",
        b'"',
        b"#",
        b":",
        b"[",
        b"{",
        b"}",
        b"null",
        b"true",
        b"'",
        b"-",
    ),
    *(
        b"../",
        b"/etc/passwd",
        b"~",
        b"rgb/",
        b"a" * 3000,
        b"[" * 3000,
        b"&a [*a, *a]",
        b"<<: *a",
        b"!!python/name:os.system",
    ),
    *(
        b"!!python/name:os.system",
        b"? [a]",
        b"|",
        b">",
        b"VERTEX_SE3:QUAT",
        b"EDGE_SE3:QUAT",
        b"element vertex 4294967295\n",
        b"(1000000000,)",
    ),
]


@dataclass
class Target:
    """Sound contents and what is done with a file; what came of it, so far."""

    seeds: list[bytes]
    use: Callable[[bytes], None]
    ends: Counter = field(default_factory=Counter)
    slowest_s: float = 0.0
    total_s: float = 0.0


def mutated(content: bytes, rng: np.random.Generator, other: bytes) -> bytes:
    """A few random changes to `content`; `other`: a sound file of the same kind, to be cut in."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at, length = int(rng.integers(len(data) + 1)), int(rng.integers(1, 9) ** 2)
        kind = rng.integers(8)
        if kind == 0:
            data[at : at + 1] = bytes([rng.integers(256)])
        elif kind == 1:
            del data[at : at + length]
        elif kind == 2:
            data[at:at] = data[at : at + length]
        elif kind == 3:
            data[at : at + length] = rng.bytes(length)
        elif kind == 4 and rng.random() < 0.3:
            del data[at:]
        elif kind == 5:
            start = int(rng.integers(len(other) + 1))
            data[at : at + length] = other[start : start + length]
        else:
            begin, end = data.rfind(b" ", 0, at) + 1, data.find(b" ", at)
            begin, end = (begin, end) if kind == 6 and end >= 0 else (at, at + int(rng.integers(9)))
            data[begin:end] = WORDS[rng.integers(len(WORDS))]
    return bytes(data)


def with_checksums(data: bytes) -> bytes:
    """A PNG file whose chunks have the checksums that a decoder expects."""
    out, position = bytearray(data), 8
    while position + 12 <= len(out):
        end = position + 8 + struct.unpack_from(">I", out, position)[0]
        if end + 4 > len(out):
            break
        out[end : end + 4] = struct.pack(">I", zlib.crc32(out[position + 4 : end]))
        position = end + 4
    return bytes(out)


def recording_and_result(folder: Path) -> tuple[Path, Path]:
    """A small recording and its results, made by processes of their own."""
    room, result = folder / "room", folder / "result"
    simulated = command("simulate", room, "--frames", 5, "--width", 320, "--height", 240, "--path", "xyz", "-q")
    for line in (simulated, command("register", room, "-o", result, "-q", "-j", 1)):
        subprocess.run(line, check=True, env=environment(MINILOOP_CACHE=folder / "cache"))
    return room, result


def readers(folder: Path, room: Path) -> dict[str, Target]:
    """Everything that reads a recording, a camera, settings or a trajectory."""
    from miniloop_cli.config import Matching
    from miniloop_cli.datasets import ImageFile, open_sequence, read_color, read_depth, read_ground_truth
    from miniloop_cli.datasets.camera_files import read_camera_file
    from miniloop_cli.datasets.priors import read_priors
    from miniloop_cli.datasets.read import read_mask
    from miniloop_cli.datasets.trajectory import read_trajectory
    from miniloop_cli.presets import load_settings
    from miniloop_cli.results.folder import read_edge_list
    from miniloop_cli.stages.match import listed_pairs

    configs = [path.read_bytes() for path in sorted((ROOT / "configs").glob("*.yaml"))]
    tables = [(room / name).read_bytes() for name in ("rgb.txt", "depth.txt")]
    images = [next((room / kind).glob("*.png")).read_bytes() for kind in ("rgb", "depth")]
    images += [small_image(suffix, kind) for suffix in (".png", ".jpg") for kind in (np.uint8, np.uint16)]

    def sequence_with(name: str) -> Callable[[bytes], None]:
        def use(data: bytes) -> None:
            sound = (room / name).read_bytes()
            try:
                (room / name).write_bytes(data)
                sequence = open_sequence(room)
                base = os.path.realpath(room)
                assert all(os.path.realpath(frame.color.path).startswith(base) for frame in sequence.frames)
                read_ground_truth(sequence)
            finally:
                (room / name).write_bytes(sound)

        return use

    def file(action: Callable[[Path], object], name: str = "input") -> Callable[[bytes], None]:
        def use(data: bytes) -> None:
            (folder / name).write_bytes(data)
            action(folder / name)

        return use

    lists = [b"# pairs\n0 1\n1,2\n\n0 4 17.0  # far\n", b"0 1 31 5\n1 3 12 0\n"]
    sequence, poses = open_sequence(room), (room / "groundtruth.txt").read_bytes()[:900].rpartition(b"\n")[0]
    stamps = [f"{frame.timestamp_s:.6f}" for frame in sequence.frames]
    gravity = "\n".join(["# timestamp ax ay az", *(f"{stamp} 0.1 -9.8 0.3" for stamp in stamps)]).encode()
    return {
        "gravity": Target([gravity], file(lambda path: read_priors(sequence, gravity=path))),
        "pose_prior": Target([poses], file(lambda path: read_priors(sequence, poses=path))),
        "pairs": Target(lists, file(lambda path: listed_pairs(5, str(path), Matching()))),
        "edge list": Target(lists, file(lambda path: read_edge_list(path, np.arange(5.0)))),
        "mask": Target(images, file(lambda path: read_mask(ImageFile(path)))),
        "rgb.txt": Target(tables, sequence_with("rgb.txt")),
        "depth.txt": Target(tables, sequence_with("depth.txt")),
        "groundtruth.txt": Target([poses], file(read_trajectory)),
        "camera.yaml": Target([(room / "camera.yaml").read_bytes()], file(read_camera_file)),
        "settings": Target(configs, file(load_settings, "input.yaml")),
        "colour": Target(images, file(lambda path: read_color(ImageFile(path)))),
        "depth": Target(images, file(lambda path: read_depth(ImageFile(path)))),
        "header": Target(images, file(lambda path: ImageFile(path).header())),
    }


def small_image(suffix: str, kind: type) -> bytes:
    import cv2

    image = np.arange(24 * 32).reshape(24, 32).astype(kind)
    return cv2.imencode(suffix, image if suffix == ".png" else image.astype(np.uint8))[1].tobytes()


def results(folder: Path, room: Path, result: Path) -> dict[str, Target]:
    """Each file of a results folder, given back to eval, export and report."""
    from miniloop_cli.api import evaluate
    from miniloop_cli.cli.export import open_model
    from miniloop_cli.export import open3d_json, plain
    from miniloop_cli.results.assessment import judge
    from miniloop_cli.results.columns import load

    writers = [plain.write_tum, plain.write_kitti, plain.write_graph, plain.write_numpy, plain.write_clouds]
    writers.append(open3d_json.write_open3d)

    def with_file(name: str) -> Callable[[bytes], None]:
        sound = (result / name).read_bytes()

        def use(data: bytes) -> None:
            try:
                (result / name).write_bytes(data)
                turn = zlib.crc32(data) % (len(writers) + 2)
                if turn == 0:
                    evaluate(result, room / "groundtruth.txt")
                elif turn == 1:
                    judge(load(result).columns)
                else:
                    writers[turn - 2](open_model(result, None, None, None), folder / "exported")
            finally:
                (result / name).write_bytes(sound)

        return use

    names = ("trajectory.txt", "edges.csv", "frames.csv", "summary.json", "graph.g2o", "cloud.ply", "inliers.npz",
             "camera.yaml")  # fmt: skip
    return {f"result {name}": Target([(result / name).read_bytes()], with_file(name)) for name in names}


def attempt(target: Target, data: bytes) -> str | None:
    """None, or what was wrong with the way it ended."""
    from miniloop_cli.errors import MiniloopError

    begin = time.perf_counter()
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        target.use(data)
        end = "accepted"
    except MiniloopError as error:
        end = "refused"
        text = str(error)
        if not text or "\n" in text or len(text) > 2000 or not text.isprintable():
            return f"not one printable line: {text[:300]!r}"
    except TimeoutError:
        return f"longer than {SECONDS} s"
    except Exception:
        return traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        took_s = time.perf_counter() - begin
        target.total_s += took_s
        target.slowest_s = max(target.slowest_s, took_s)
    target.ends[end] += 1
    return None


def stop(*_: object) -> None:
    raise TimeoutError


def targets(folder: Path) -> dict[str, Target]:
    room, result = recording_and_result(folder)
    return readers(folder, room) | results(folder, room, result)


def campaign(folder: Path, inputs: int, seed: int = 0) -> tuple[dict[str, Target], list[tuple[str, bytes, str]]]:
    """Mutated inputs, one target after another; the targets with their counts, and what failed."""
    found, rng, failures = targets(folder), np.random.default_rng(seed), []
    signal.signal(signal.SIGALRM, stop)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEGABYTES * 2**20, limits[1]))
    try:
        for k in range(inputs):
            # every other input goes in turn, the rest where least time went
            name = list(found)[k // 2 % len(found)] if k % 2 else min(found, key=lambda n: found[n].total_s)
            target = found[name]
            sound, other = (target.seeds[rng.integers(len(target.seeds))] for _ in range(2))
            data = mutated(sound, rng, other)
            if data[:4] == b"\x89PNG" and rng.random() < 0.5:
                data = with_checksums(data)
            if problem := attempt(target, data):
                failures.append((name, data, problem))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
    return found, failures


def guided(folder: Path, name: str, inputs: int) -> None:
    """One target under atheris."""
    import atheris

    with atheris.instrument_imports(include=PARSERS):
        target = targets(folder)[name]
    corpus = folder / "corpus"
    corpus.mkdir()
    for k, content in enumerate(target.seeds):
        (corpus / str(k)).write_bytes(content)

    def one(data: bytes) -> None:
        if problem := attempt(target, data):
            raise AssertionError(problem)

    signal.signal(signal.SIGALRM, stop)
    atheris.Setup([sys.argv[0], f"-runs={inputs}", "-timeout=20", "-rss_limit_mb=3000", str(corpus)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        if "--atheris" in sys.argv:
            guided(place, sys.argv[sys.argv.index("--atheris") + 1], int(sys.argv[1]))
        inputs, seed = (int(value) for value in (*sys.argv[1:], *("100000", "0")[len(sys.argv) - 1 :]))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        tried, failures = campaign(place, inputs, seed)
        for name, target in tried.items():
            counts = f"{target.ends['refused']:7d} refused {target.ends['accepted']:7d} accepted"
            print(f"{name:<24}{counts}   slowest {1000 * target.slowest_s:.0f} ms")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{inputs} inputs, {len(failures)} failures; at most {peak:.0f} MB, libraries included")
        for k, (name, data, problem) in enumerate(failures[:20]):
            Path(f"fuzz-failure-{k}.bin").write_bytes(data)
            print(f"--- {name}, kept as fuzz-failure-{k}.bin\n{problem}")
        sys.exit(bool(failures))
    finally:
        shutil.rmtree(place, ignore_errors=True)
