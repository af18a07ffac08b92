"""Inputs of an evaluation: from files and folders to trajectories and edges."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from miniloop_cli.datasets import open_sequence, read_ground_truth
from miniloop_cli.datasets.archive_path import is_archive
from miniloop_cli.datasets.open import recognise
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError, MiniloopError
from miniloop_cli.evaluation.evaluate import Protocol
from miniloop_cli.results.folder import Results, edge_stamps, read_edge_list, read_table
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

Inputs = tuple[Trajectory, Trajectory, Floats | None, Protocol | None, str]


def read_inputs(
    source: Path, truth: Path, edges_path: Path | None, protocol: Protocol | None, follow_links: bool = False
) -> Inputs:
    """The arguments of `evaluate`: trajectory, ground truth, (e, 2) edge stamps, protocol, name of the edges.

    `source`: a results folder or a trajectory; `truth`: a trajectory or a recording that has one; `edges_path`: an
    edges.csv or a list of lines "i j". Raises InputError for missing and malformed files.
    """
    folder = run_of(source)
    trajectory = read_poses(source)
    if folder:
        folder.check_camera()
    if edges_path is None:
        edges = folder.edge_stamps_s if folder else None
    elif edges_path.suffix == ".csv":
        edges = edge_stamps(read_table(edges_path), edges_path)
    else:
        edges = read_edge_list(edges_path, frame_stamps(folder, truth, follow_links))
    edges_are = f"edges of {edges_path.name}" if edges_path else "verified edges"
    return trajectory, ground_truth(truth, trajectory.timestamps_s, folder, follow_links), edges, protocol, edges_are


def run_of(source: Path) -> Results | None:
    """The run of a results folder or of its trajectory.txt."""
    file = source / "trajectory.txt" if source.is_dir() else source
    # A trajectory with another name does not belong to the run in the same folder.
    return Results(file.parent) if file.name == "trajectory.txt" else None


def read_poses(source: Path) -> Trajectory:
    """The trajectory of a results folder, or of a file."""
    folder = run_of(source)
    return folder.trajectory if folder else read_trajectory(source)


def ground_truth(path: Path, frames_s: Floats, folder: Results | None, follow_links: bool = False) -> Trajectory:
    """The trajectory at `path`: a file, a folder's groundtruth.txt, or the ground truth of a recording.

    `frames_s`: (n,) stamps of the poses to be measured; `folder`: their run, which has the frames by number. Raises
    InputError.
    """
    file = path if path.is_file() else path / "groundtruth.txt"
    recording = path.is_file() and (is_archive(path) or recognise(path) is not None)
    if file.is_file() and not recording:
        return read_trajectory(file, frames_s, lambda: _numbered(path, frames_s, folder, follow_links))
    sequence = open_sequence(path, follow_links=follow_links)
    truth = read_ground_truth(sequence)
    if truth is None:
        raise InputError(f"{path} has no ground truth (groundtruth.txt): give a trajectory file to --gt")
    return truth if truth.source else replace(truth, source=f"poses of the recording ({sequence.layout})")


def _numbered(path: Path, frames_s: Floats, folder: Results | None, follow_links: bool) -> dict[str, Floats]:
    """(n,) stamps by frame number: of the recording, of the run's frames.csv, else of the poses themselves."""
    numbered = {}
    recording = path if path.is_dir() else _recording_of(folder)
    if recording is not None:
        try:
            frames = open_sequence(recording, follow_links=follow_links).frames
            numbered["frames of the recording"] = np.array([frame.timestamp_s for frame in frames])
        except MiniloopError:
            pass  # moved, or a folder with only a ground truth: use the run's own table
    if folder and len(folder.frame_stamps_s):
        numbered["frames of frames.csv"] = folder.frame_stamps_s
    return numbered or {"poses of the result": frames_s}


def _recording_of(folder: Results | None) -> Path | None:
    recording = folder.summary.get("recording") if folder else None
    return Path(recording) if isinstance(recording, str) else None


def frame_stamps(folder: Results | None, truth: Path, follow_links: bool = False) -> Floats:
    """(n,) time stamps of the recording's frames by number: from the result's frames.csv, else from the recording.

    Raises InputError if neither is available.
    """
    if folder and len(folder.frame_stamps_s):
        return folder.frame_stamps_s
    if truth.is_dir():
        sequence = open_sequence(truth, follow_links=follow_links)
        return np.array([frame.timestamp_s for frame in sequence.frames])
    raise InputError("frame numbers need the recording's time stamps: give its folder to --gt")
