"""Pose graphs in g2o's text format, as g2o, gtsam and Ceres read it.

VERTEX_SE3:QUAT id x y z qx qy qz qw: camera to world. EDGE_SE3:QUAT i j x y z qx qy qz qw I11 I12 ... I66: the pose
of camera j in camera i, T_i_j, and the upper triangle of its information, translation before rotation. The
information refers to the translation (m) and the rotation vector (rad) of the residual T_i_j(measured)^-1 T_i_j,
as in gtsam and Ceres; g2o itself uses half the rotation vector (the imaginary part of a quaternion).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miniloop_cli.errors import InputError
from miniloop_cli.geometry import se3
from miniloop_cli.runtime.atomic_files import atomic_write
from miniloop_cli.typing import Floats, Ints

UPPER = np.triu_indices(6)
SWAP = np.array([3, 4, 5, 0, 1, 2])  # rotation first <-> translation first
HEADER = (
    "# poses camera to world (m); edges i j: pose of camera j in camera i,",
    "# information of (translation m, rotation vector rad), translation first",
)


@dataclass(frozen=True)
class PoseGraph:
    """(n,) ids, (n, 4, 4) T_world_cam, (m, 2) pairs of ids (i, j), (m, 4, 4) T_j_i, (m, 6, 6) rotation first."""

    ids: Ints
    T_world_cam: Floats
    pairs: Ints
    T_j_i: Floats
    information: Floats


def write_g2o(
    path: Path,
    ids: Ints,
    T_world_cam: Floats,
    pairs: Ints,
    T_j_i: Floats,
    information: Floats,
) -> None:
    """Write a pose graph: ids (n,), T_world_cam (n, 4, 4), pairs (m, 2), T_j_i (m, 4, 4), information (m, 6, 6).

    The noise Exp(xi) on T_j_i, xi in frame j, is Exp(xi)^-1 on the right of T_i_j: to first order the same
    information matrix, only the order of its blocks changes.
    """
    order = information[:, SWAP][:, :, SWAP].reshape(-1, 6, 6)
    with atomic_write(Path(path)) as file:
        file.write("\n".join(HEADER) + "\n")
        for number, row in zip(np.asarray(ids).tolist(), pose_rows(T_world_cam), strict=True):
            file.write(f"VERTEX_SE3:QUAT {number} {row}\n")
        T_i_j = se3.inverse(np.asarray(T_j_i).reshape(-1, 4, 4))
        upper = _lines(order[:, *UPPER], 9)
        for (i, j), row, info in zip(np.asarray(pairs).tolist(), pose_rows(T_i_j), upper, strict=True):
            file.write(f"EDGE_SE3:QUAT {i} {j} {row} {info}\n")


def pose_rows(T: Floats) -> list[str]:
    """(n, 4, 4) poses as "x y z qx qy qz qw", to a nanometre and a nanoradian, the same on all machines."""
    return _lines(np.round(se3.to_rows(T), 9) + 0.0, 12)  # and zero has one sign


def _lines(numbers: Floats, digits: int) -> list[str]:
    """(n, k) numbers as n lines, spaces between."""
    form = " ".join([f"%.{digits}g"] * numbers.shape[1])
    return [form % tuple(row) for row in numbers.tolist()]


def read_g2o(path: Path) -> PoseGraph:
    """Read a 3D pose graph; other kinds of lines are ignored.

    Raises InputError naming the line for malformed numbers, a zero quaternion, and edges to unknown vertices.
    """
    vertices: dict[int, list[float]] = {}
    pairs: list[tuple[int, int]] = []
    edges: list[list[float]] = []
    for number, line in enumerate(Path(path).read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        tag, *fields = line.split() or [""]
        n_ids, n_values = {"VERTEX_SE3:QUAT": (1, 7), "EDGE_SE3:QUAT": (2, 28)}.get(tag, (0, 0))
        if not n_ids:
            continue
        try:
            ids, values = [int(v) for v in fields[:n_ids]], [float(v) for v in fields[n_ids:]]
        except ValueError as error:
            raise InputError(f"{path}, line {number}: {error}") from None
        if not all(0 <= k < 2**31 for k in ids):
            raise InputError(f"{path}, line {number}: vertices are numbered from 0 to 2^31 - 1")
        if len(values) != n_values or not np.isfinite(values).all() or not np.linalg.norm(values[3:7]) > 1e-6:
            raise InputError(f"{path}, line {number}: a {tag} needs {n_values} finite numbers and a unit quaternion")
        if n_ids == 1:
            vertices[ids[0]] = values
        else:
            pairs.append((ids[0], ids[1]))
            edges.append(values)
    unknown = {k for pair in pairs for k in pair} - vertices.keys()
    if unknown:
        raise InputError(f"{path}: edges name vertices that are not there: {sorted(unknown)[:5]}")
    data = np.array(edges, float).reshape(-1, 28)
    upper = np.zeros((len(data), 6, 6))
    upper[:, UPPER[0], UPPER[1]] = data[:, 7:]
    information = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
    return PoseGraph(
        np.array(list(vertices), np.int64),
        se3.from_rows(np.array(list(vertices.values()), float).reshape(-1, 7)),
        np.array(pairs, np.int64).reshape(-1, 2),
        se3.inverse(se3.from_rows(data[:, :7])),
        information[:, SWAP][:, :, SWAP],
    )
