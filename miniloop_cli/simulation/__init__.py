"""Synthetic RGB-D recordings with exact ground truth: `simulate` yields frames, `write_sequence` makes a folder."""

from miniloop_cli.simulation.settings import PATHS, SCENES, SimulationSettings
from miniloop_cli.simulation.simulate import SimulatedFrame, simulate, true_trajectory
from miniloop_cli.simulation.write import write_sequence

__all__ = [
    "PATHS",
    "SCENES",
    "SimulatedFrame",
    "SimulationSettings",
    "simulate",
    "true_trajectory",
    "write_sequence",
]
