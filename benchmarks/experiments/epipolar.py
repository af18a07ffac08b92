"""Trajectories judged by the images alone: how far matches are from the epipolar lines of the relative poses.

A ground truth that another program made from depth has errors of its own. Matches of colour images judge it and us in
the same way: no depth and no match of ours takes part. Features, and the fundamental matrix that tells false matches,
are OpenCV's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from miniloop_cli.bench import Row
from miniloop_cli.datasets import open_sequence, read_color, read_ground_truth, read_trajectory
from miniloop_cli.feature_types import opencv_function
from miniloop_cli.geometry import se3
from miniloop_cli.geometry.camera import Camera
from miniloop_cli.runtime.parallel import Workers
from miniloop_cli.scene.interpolation import associate
from miniloop_cli.scene.sequence import Sequence as Recording
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats, Pair

GAPS = (1, 3, 5, 10, 50)  # frames
FEATURES, RATIO, FALSE_PX, LEAST = 2000, 0.75, 2.0, 30  # LEAST: matches of a pair


class Judged(NamedTuple):
    """Poses (n, 4, 4) of the frames' colour camera, NaN where there is none, and that camera."""

    trajectory: str
    poses_of: str
    T_world_cam: Floats
    camera: Camera


def epipolar_rows(
    folder: Path, results: Sequence[Path], others: Sequence[Path], seed: int, workers: Workers
) -> Iterator[Row]:
    """Rows of the poses of `results`, of the ground truth and of trajectories (`others`): median distances in px.

    A row a trajectory and gap. Results have their own cameras. Ground truth and others get that of the first result:
    their poses are taken for those of its colour camera and, if it names a depth camera, for those of that as well.
    Nothing is random here: OpenCV's RANSAC has a seed of its own.
    """
    recording = open_sequence(folder, camera_path=results[0] / "camera.yaml")
    judged = [_of_result(result, recording) for result in results]
    if truth := read_ground_truth(recording):
        judged += _of_others("ground truth", truth, recording)
    for path in others:
        judged += _of_others(path.stem, read_trajectory(path, recording.stamps_s), recording)
    matches = image_matches(recording, workers)
    for gap in GAPS:
        pairs = [pair for pair in matches if pair[1] - pair[0] == gap]
        for one in judged:
            found = [px for pair in pairs if np.isfinite(px := epipolar_px(one, pair, *matches[pair]))]
            yield {
                "sequence": recording.name,
                "apart": gap,
                "trajectory": one.trajectory,
                "poses_of": one.poses_of,
                "pairs": len(found),
                "px": round(float(np.median(found)), 3) if found else None,
            }


def _of_result(result: Path, recording: Recording) -> Judged:
    own = open_sequence(recording.root, camera_path=result / "camera.yaml")
    found = read_trajectory(result / "trajectory.txt", recording.stamps_s)
    return Judged(result.name, "colour", _at_frames(found, recording), own.camera)


def _of_others(name: str, found: Trajectory, recording: Recording) -> list[Judged]:
    T = _at_frames(found, recording)
    judged = [Judged(name, "colour", T, recording.camera)]
    if recording.depth_camera:
        T = T @ se3.inverse(recording.depth_camera.T_color_depth)
        judged.append(Judged(name, "depth", T, recording.camera))
    return judged


def _at_frames(found: Trajectory, recording: Recording) -> Floats:
    T, valid = associate(recording.stamps_s, found, "nearest", 0.001)
    return np.where(valid[:, None, None], T, np.nan)


def image_matches(recording: Recording, workers: Workers) -> dict[Pair, tuple[Floats, Floats]]:
    """Matched measured pixels (m, 2) of pairs of frames GAPS apart, those that one fundamental matrix explains."""
    import cv2

    frames = range(len(recording.frames))

    def detected(k: int) -> tuple[Floats, Floats]:
        gray = cv2.cvtColor(read_color(recording.frames[k].color), cv2.COLOR_RGB2GRAY)
        points, descriptors = opencv_function("SIFT_create")(FEATURES).detectAndCompute(gray, None)
        return np.array([point.pt for point in points]).reshape(-1, 2), descriptors

    features = list(workers.map(detected, frames, "features", len(frames)))

    def matched(pair: Pair) -> tuple[Floats, Floats] | None:
        (px_i, of_i), (px_j, of_j) = (features[k] for k in pair)
        if min(len(px_i), len(px_j)) < LEAST:
            return None
        two = cv2.BFMatcher().knnMatch(of_i, of_j, 2)
        rows = np.array([(a.queryIdx, a.trainIdx) for a, b in two if a.distance < RATIO * b.distance]).reshape(-1, 2)
        if len(rows) < LEAST:
            return None
        p, q = px_i[rows[:, 0]], px_j[rows[:, 1]]
        _, true = cv2.findFundamentalMat(p, q, cv2.FM_RANSAC, FALSE_PX, 0.999)
        if true is None or true.sum() < LEAST:
            return None
        return p[true.ravel() > 0], q[true.ravel() > 0]

    pairs = [(i, i + gap) for gap in GAPS for i in frames if i + gap < len(frames)]
    found = workers.map(matched, pairs, "matching", len(pairs))
    return {pair: one for pair, one in zip(pairs, found, strict=True) if one is not None}


def epipolar_px(judged: Judged, pair: Pair, px_i: Floats, px_j: Floats) -> float:
    """Median Sampson distance (px) of matches (m, 2) of two frames from the poses' epipolar lines; NaN without poses.

    Hartley and Zisserman, Multiple View Geometry, eq. 11.9.
    """
    T_j_i = se3.inverse(judged.T_world_cam[pair[1]]) @ judged.T_world_cam[pair[0]]
    x, y = (judged.camera.backproject(judged.camera.undistort(px), np.ones(len(px))) for px in (px_i, px_j))
    E = np.cross(T_j_i[:3, 3], T_j_i[:3, :3], axisb=0).T
    lines_j, lines_i = x @ E.T, y @ E
    length = np.sqrt((lines_j[:, :2] ** 2).sum(axis=1) + (lines_i[:, :2] ** 2).sum(axis=1))
    return float(judged.camera.fx * np.median(np.abs((y * lines_j).sum(axis=1)) / length))


def draw(rows: Sequence[Row]) -> Figure:
    """Median distances against how far frames are apart, a line for each trajectory."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for name, poses_of in dict.fromkeys((row["trajectory"], row["poses_of"]) for row in rows):
        px = [row["px"] for row in rows if (row["trajectory"], row["poses_of"]) == (name, poses_of)]
        axes.plot(range(len(GAPS)), [np.nan if one is None else one for one in px], "o-", label=f"{name}, {poses_of}")
    axes.set_xticks(range(len(GAPS)), [str(gap) for gap in GAPS])
    axes.set(xlabel="frames apart", ylabel="matches from their epipolar lines [px]", ylim=(0, None))
    axes.legend(fontsize="x-small")
    return figure
