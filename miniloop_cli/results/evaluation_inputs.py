"""What an evaluation is given: files and folders in, trajectories and edges out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from miniloop_cli.datasets import open_sequence, read_ground_truth
from miniloop_cli.datasets.open import recognise
from miniloop_cli.datasets.trajectory import read_trajectory
from miniloop_cli.errors import InputError
from miniloop_cli.evaluation.evaluate import Protocol
from miniloop_cli.results.folder import Results, edge_stamps, read_edge_list, read_table
from miniloop_cli.scene.sequence import Trajectory
from miniloop_cli.typing import Floats

Inputs = tuple[Trajectory, Trajectory, Floats | None, Protocol | None, str]


def read_inputs(
    source: Path, truth: Path, edges_path: Path | None, protocol: Protocol | None, follow_links: bool = False
) -> Inputs:
    """The arguments of `evaluate`: trajectory, ground truth, (e, 2) edge stamps, protocol, what the edges are called.

    `source`: a results folder or a trajectory; `truth`: a trajectory or a recording that has one; `edges_path`: an
    edges.csv or a list of lines "i j". Raises InputError for what is missing or malformed.
    """
    file = source / "trajectory.txt" if source.is_dir() else source
    # A trajectory of another name does not belong to the run whose folder it may lie in.
    folder = Results(file.parent) if file.name == "trajectory.txt" else None
    trajectory = folder.trajectory if folder else read_trajectory(file)
    if folder:
        folder.check_camera()
    if edges_path is None:
        edges = folder.edge_stamps_s if folder else None
    elif edges_path.suffix == ".csv":
        edges = edge_stamps(read_table(edges_path), edges_path)
    else:
        edges = read_edge_list(edges_path, frame_stamps(folder, truth, follow_links))
    edges_are = f"edges of {edges_path.name}" if edges_path else "verified edges"
    return trajectory, ground_truth(truth, follow_links), edges, protocol, edges_are


def ground_truth(path: Path, follow_links: bool = False) -> Trajectory:
    """The trajectory at `path`: a file, a TUM folder's groundtruth.txt, or what a recording of another layout has."""
    if path.is_file() and recognise(path) is None:
        return read_trajectory(path)
    if (path / "groundtruth.txt").is_file():
        return read_trajectory(path / "groundtruth.txt")
    truth = read_ground_truth(open_sequence(path, follow_links=follow_links))
    if truth is None:
        raise InputError(f"{path} comes without ground truth (no groundtruth.txt): give a trajectory file to --gt")
    return truth


def frame_stamps(folder: Results | None, truth: Path, follow_links: bool = False) -> Floats:
    """(n,) time stamps of the recording's frames by number: from the result's frames.csv, else from the recording."""
    if folder and len(folder.frame_stamps_s):
        return folder.frame_stamps_s
    if truth.is_dir():
        sequence = open_sequence(truth, follow_links=follow_links)
        return np.array([frame.timestamp_s for frame in sequence.frames])
    raise InputError("frame numbers need the recording's time stamps: give its folder to --gt")
