"""Made-up and damaged trajectories: `python tests/stress/fuzz_trajectories.py [INPUTS] [SEED]`.

Each input is a random trajectory in a random format (columns, separators, decimal commas, encoding, units, header),
most of them damaged afterwards. It must be read as a parser of this script's own reads it, which is told the format and
takes numbers as decimals, or be refused in one line: by the reader, or beside a result by the check of conventions.
Inputs that are read otherwise are kept and shown; the counts by format and damage are printed.
"""

import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.append(str(Path(__file__).parents[2]))

from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.evaluation.evaluate import evaluate
from miniloop_cli.geometry import se3
from miniloop_cli.scene.sequence import Trajectory

PER_S = {"s": 0, "ms": 3, "us": 6, "ns": 9}
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
NAMES = {
    "tum": {"stamp": "timestamp", **{a: f"t{a}" for a in "xyz"}, **{f"q{a}": f"q{a}" for a in "xyzw"}},
    "euroc": {"stamp": "#timestamp", **{a: f"p_RS_R_{a}" for a in "xyz"}, **{f"q{a}": f"q_RS_{a}" for a in "xyzw"}},
    "bag": {
        "stamp": "field.header.stamp",
        **{a: f"field.pose.position.{a}" for a in "xyz"},
        **{f"q{a}": f"field.pose.orientation.{a}" for a in "xyzw"},
    },
}
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Format:
    """How a file was written, which the script's own parser is told."""

    kind: str  # tum, header, kitti, matrix, lines, log
    separator: str = " "
    comma: bool = False
    encoding: str = "utf-8"
    end: str = "\n"
    time_unit: str = "s"
    mm: bool = False
    columns: tuple[str, ...] = ("stamp", *POSE)
    header: str = ""


def random_format(rng: np.random.Generator) -> Format:
    kind = str(rng.choice(["tum", "tum", "header", "header", "header", "kitti", "matrix", "lines", "log"]))
    comma = rng.random() < 0.15
    separators = [" ", "\t", ";", "  "] if comma else [" ", "\t", ",", ", ", ";", "  "]
    made = Format(
        kind,
        str(rng.choice(separators)) if kind in ("tum", "header") else " ",
        comma and kind in ("tum", "header"),
        str(rng.choice(["utf-8"] * 6 + ["utf-8-sig", "utf-16"])),
        str(rng.choice(["\n", "\n", "\r\n"])),
        str(rng.choice(list(PER_S))) if kind in ("tum", "header") else "s",
    )
    if kind != "header":
        return made
    names = NAMES[str(rng.choice(list(NAMES)))]
    order = ["stamp", "x", "y", "z", *(("qw", "qx", "qy", "qz") if rng.random() < 0.6 else POSE[3:])]
    if rng.random() < 0.3:
        order = [order[0], *order[4:], *order[1:4]]
    extra = [f"v_{k}" for k in range(rng.integers(1, 4))] if rng.random() < 0.3 else []
    mm = bool(rng.random() < 0.2)
    stamp_unit = f" [{made.time_unit}]" if rng.random() < 0.5 else ""
    cells = [names.get(role, role) + (stamp_unit if role == "stamp" else " [mm]" if mm and role in POSE[:3] else "")
             for role in (*order, *extra)]  # fmt: skip
    header = (made.separator if made.separator.strip() else ",").join(cells)
    return replace(made, mm=mm, columns=(*order, *extra), header=header)


def write(made: Format, stamps: list[Decimal], T: np.ndarray, rng: np.random.Generator) -> str:
    rows = [made.header] if made.header else []
    for k, (stamp, pose) in enumerate(zip(stamps, T, strict=True)):
        if made.kind in ("kitti", "matrix"):
            rows.append(made.separator.join(f"{v:.9f}" for v in pose[: 3 if made.kind == "kitti" else 4].ravel()))
        elif made.kind in ("lines", "log"):
            rows += [f"{k} {k} {k + 1}"] if made.kind == "log" else []
            rows += [made.separator.join(f"{v:.9f}" for v in row) for row in pose]
        else:
            q = Rotation.from_matrix(pose[:3, :3]).as_quat()
            values = dict(zip(POSE, (*(pose[:3, 3] * (1000 if made.mm else 1)), *q), strict=True))
            shifted = stamp.scaleb(PER_S[made.time_unit])
            cells = [
                (f"{shifted:f}" if role == "stamp" else f"{values.get(role, rng.normal()):.9f}")
                for role in made.columns
            ]
            cells = [cell.replace(".", ",") for cell in cells] if made.comma else cells
            rows.append(made.separator.join(cells))
    return made.end.join(rows) + made.end


def own_reading(made: Format, text: str, frames: list[Decimal]) -> dict[Decimal, np.ndarray] | None:
    """Poses by stamp, as the format says; None where a row is not of it."""
    rows = []
    body = text.replace("\r\n", "\n").split("\n")
    for line in body[1:] if made.header else body:
        if line.strip() and not line.strip().startswith("#"):
            cells = line.replace(";", " ").replace(";" if made.comma else ",", " ").split()
            try:
                rows.append([number(cell, made.comma) for cell in cells])
            except (InvalidOperation, ValueError):
                return None
    if made.kind in ("tum", "header"):
        poses: dict[Decimal, np.ndarray] = {}
        for row in rows:
            if len(row) != len(made.columns):
                return None
            value = dict(zip(made.columns, row, strict=True))
            q = np.array([float(value[f"q{a}"]) for a in "xyzw"])
            if not np.linalg.norm(q):
                return None
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat(q).as_matrix()
            pose[:3, 3] = [float(value[a]) / (1000 if made.mm else 1) for a in "xyz"]
            poses.setdefault(value["stamp"].scaleb(-PER_S[made.time_unit]), pose)
        return poses
    flat = [v for row in rows for v in (row[3:] if made.kind == "log" and len(row) == 3 else row)]
    size = 12 if made.kind == "kitti" else 16
    if len(flat) != size * len(frames):
        return None
    M = np.tile(np.eye(4), (len(frames), 1, 1))
    M[:, : size // 4] = np.array(flat, float).reshape(len(frames), -1, 4)
    U, _, Vt = np.linalg.svd(M[:, :3, :3])  # rows of a rounded rotation
    M[:, :3, :3] = U @ Vt
    return dict(zip(frames, M, strict=True))


def number(cell: str, comma: bool) -> Decimal:
    if (comma and "." in cell) or "_" in cell or not cell.isascii():
        raise ValueError
    value = Decimal(cell.strip().replace(",", ".") if comma else cell.strip())
    if not value.is_finite() or value.adjusted() > 100:
        raise ValueError
    return value


def damaged(made: Format, text: str, rng: np.random.Generator) -> tuple[str, str]:
    """A name for what was done, and the text after it."""
    lines = text.split(made.end)
    k = int(rng.integers(len(lines)))
    cells = lines[k].split(made.separator)
    c = int(rng.integers(len(cells)))
    kind = str(rng.choice(["cell", "word", "digit", "drop cell", "double row", "drop row", "swap rows", "swap columns",
                           "no header", "cut", "byte", "sign", "round stamps", "separator", "repeat all"]))  # fmt: skip
    if kind == "cell":
        cells[c] = str(rng.choice(["0", "1", "-1", "1e3", "7.5", "1e-3", "123456"]))
    elif kind == "word":
        cells[c] = str(rng.choice(["nan", "inf", "-inf", "", "x", "1_0", "0x10", "1e400", "١", "#", '"', "1.2.3"]))
    elif kind == "digit":
        at = int(rng.integers(len(cells[c]) + 1))
        cells[c] = cells[c][:at] + str(rng.integers(10)) + cells[c][at:]
    elif kind == "drop cell":
        del cells[c]
    elif kind == "sign":
        cells[c] = cells[c][1:] if cells[c].startswith("-") else "-" + cells[c]
    lines[k] = made.separator.join(cells)
    if kind == "double row":
        lines.insert(k, lines[k])
    elif kind == "drop row":
        del lines[k]
    elif kind == "swap rows":
        j = int(rng.integers(len(lines)))
        lines[k], lines[j] = lines[j], lines[k]
    elif kind == "swap columns":
        a, b = rng.integers(0, 8, 2)
        for n, line in enumerate(lines):
            row = line.split(made.separator)
            if len(row) > max(a, b) and not (n == 0 and made.header):
                row[a], row[b] = row[b], row[a]
            lines[n] = made.separator.join(row)
    elif kind == "no header" and made.header:
        del lines[0]
    elif kind == "round stamps":
        lines = [line.replace(line.split(made.separator)[0], line.split(made.separator)[0][:8], 1) for line in lines]
    elif kind == "separator":
        lines[k] = lines[k].replace(made.separator, str(rng.choice([" ", ",", ";", ", ", ",,"])))
    elif kind == "repeat all":
        lines += lines[1:] if made.header else lines
    text = made.end.join(lines)
    if kind == "cut":
        text = text[: int(rng.integers(len(text) + 1))]
    elif kind == "byte":
        at = int(rng.integers(len(text) + 1))
        text = text[:at] + str(rng.choice(list("0123456789.,;-+eE \t\n#x\"'\0é"))) + text[at + 1 :]
    return kind, text


def judge(path: Path, made: Format, text: str, T: np.ndarray, frames: list[Decimal]) -> str:
    """How an input ended: "read", "refused", "refused beside a result", or "WRONG: " and why."""
    frames_s = np.array([float(t) for t in frames])
    expected = own_reading(made, text, frames)
    try:
        found = read_trajectory(path, frames_s, lambda: {"frames of the recording": frames_s})
    except MiniloopError as error:
        return "refused" if "\n" not in str(error) else "WRONG: more than one line"
    if same(found, expected):
        return "read"
    try:
        if evaluate(Trajectory(frames_s, T), found).numbers["ate_max_m"] < TOLERANCE:
            return "read"  # a unit that only the lost header stated was found by the result
    except MiniloopError as error:
        return "refused beside a result" if "\n" not in str(error) else "WRONG: more than one line"
    return f"WRONG: read as {found.source}, " + ("not of its format" if expected is None else "other values")


def same(found: Trajectory, expected: dict[Decimal, np.ndarray] | None) -> bool:
    if expected is None or len(expected) != len(found.timestamps_s):
        return False
    stamps = sorted(expected)
    poses = np.array([expected[t] for t in stamps])
    return bool(
        np.abs(found.timestamps_s - [float(t) for t in stamps]).max() < TOLERANCE
        and np.abs(found.T_world_cam - poses).max() < 100 * TOLERANCE * max(1.0, float(np.abs(poses).max()))
    )


def walk(rng: np.random.Generator) -> tuple[list[Decimal], np.ndarray]:
    n = int(rng.integers(8, 40))
    w = np.cumsum(rng.normal(scale=0.15, size=(n, 3)), axis=0)
    T = se3.pose(se3.exp_so3(w), np.cumsum(rng.normal(scale=0.1, size=(n, 3)), axis=0))
    start = Decimal(str(rng.choice([0, 3, 1305031102, 1700000000])))
    steps = np.cumsum(rng.integers(20_000, 110_000, n))
    return [start + Decimal(int(step)).scaleb(-6) for step in steps], T


def main(count: int, seed: int) -> int:
    rng, ends, examples = np.random.default_rng(seed), Counter(), []
    by_damage: dict[str, Counter] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.txt"
        for k in range(count):
            frames, T = walk(rng)
            made = random_format(rng)
            text = write(made, frames, T, rng)
            kind = "none"
            if rng.random() < 0.75:
                kind, text = damaged(made, text, rng)
            told = replace(made, header="") if kind == "no header" else made
            path.write_bytes(text.encode(made.encoding, "replace"))
            end = judge(path, told, text, T, frames)
            if kind == "none" and end != "read":
                end = f"WRONG: sound, but {end}"
            ends[end.split(":")[0]] += 1
            by_damage.setdefault(kind, Counter())[end.split(":")[0]] += 1
            if end.startswith("WRONG"):
                examples.append((k, kind, made, end, text))
                if len(examples) <= 20:
                    kept = Path(tempfile.gettempdir()) / f"poses-{seed}-{k}.txt"
                    kept.write_bytes(path.read_bytes())
                    print(f"{kept}: {kind}, {made}: {end}")
    for kind, counts in sorted(by_damage.items()):
        print(f"{kind:<14}" + "  ".join(f"{end} {number}" for end, number in sorted(counts.items())))
    print(f"{count} inputs: " + ", ".join(f"{end} {number}" for end, number in sorted(ends.items())))
    return 1 if examples else 0


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[1:]]
    sys.exit(main(*(given + [20_000, 0][len(given) :])))
