"""Four calls that do what the command line does: `register`, `calibrate`, `evaluate`, `simulate`.

They do not change the process: variables, signal handlers, numba's settings and threads of other libraries.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Sequence as Many
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from miniloop_cli.config import Settings
    from miniloop_cli.evaluation.evaluate import Evaluation, Protocol
    from miniloop_cli.runtime.artifact_store import Store
    from miniloop_cli.runtime.parallel import Workers
    from miniloop_cli.scene.calibration import Calibration
    from miniloop_cli.scene.registration import Registration
    from miniloop_cli.scene.sequence import Sequence

LOG = logging.getLogger("miniloop")


def register(
    folder: Path | str,
    output: Path | str | None = None,
    *,
    settings: Settings | Path | str = "default",
    overrides: Many[str] = (),
    layout: str | None = None,
    topics: str = "",
    follow_links: bool = False,
    camera: Path | str | None = None,
    gravity: Path | str | None = None,
    pose_prior: Path | str | None = None,
    max_frames: int | None = None,
    jobs: int = -1,
    cluster: str | None = None,
    seed: int = 0,
    fresh: bool = False,
    quiet: bool = True,
) -> Registration:
    """Register a recording and write its results, report included, to `output` (default `results/<name>`).

    `settings`: a Settings object, a preset's name or a YAML file; `overrides`: "key=value" on top of a preset or file;
    `gravity`: an accelerometer table, `pose_prior`: a file of rough poses (docs/priors.md);
    `topics`: the topics of colour, depth and cameras in a bag, as "color=/a,depth=/b";
    `follow_links`: accept images behind symbolic links that point outside the recording;
    `cluster`: the address of a Dask scheduler (docs/cluster.md).
    Raises MiniloopError if it fails; with a RegistrationError, a report that names the reason is written.
    """
    from miniloop_cli.datasets.priors import read_priors
    from miniloop_cli.mapping.alone import map_of
    from miniloop_cli.mapping.part import part_of
    from miniloop_cli.pipeline import register as run_pipeline
    from miniloop_cli.pipeline import tell
    from miniloop_cli.presets import load_settings
    from miniloop_cli.results.map_folder import write_map
    from miniloop_cli.runtime.artifact_store import Store, default_folder
    from miniloop_cli.runtime.dask_cluster import connected
    from miniloop_cli.runtime.folder_lock import exclusive
    from miniloop_cli.runtime.parallel import Workers, single_inner_threads
    from miniloop_cli.scene.registration import RegistrationError

    if isinstance(settings, (str, Path)):
        settings = load_settings(settings, tuple(overrides))
    sequence = open_recording(folder, settings, layout, camera, max_frames, follow_links, topics)
    priors = read_priors(sequence, gravity, pose_prior)
    tell(priors.notes)
    target = Path(output) if output else Path("results") / sequence.name
    store = Store(default_folder(), fresh)
    with exclusive(target), connected(cluster) if cluster else nullcontext() as connection:
        workers = Workers(jobs, quiet, connection)
        try:
            run = run_pipeline(sequence, settings, store, workers, seed, priors)
        except RegistrationError as error:
            if error.run is None:
                raise
            write_run(error.run, target, workers, store, str(error))
            raise RegistrationError(f"{error} (report: {target / 'report.html'})", error.run) from error
        write_run(run, target, workers, store)
        with single_inner_threads():
            write_map(target, map_of(part_of(run, settings.features.type), settings.model_dump(), seed))
    return run


def open_recording(
    folder: Path | str,
    settings: Settings,
    layout: str | None = None,
    camera: Path | str | None = None,
    max_frames: int | None = None,
    follow_links: bool = False,
    topics: str = "",
) -> Sequence:
    """A recording; its notes are logged. Raises InputError as `open_sequence`."""
    from miniloop_cli.datasets import open_sequence
    from miniloop_cli.pipeline import tell

    least = settings.depth.min_confidence
    sequence = open_sequence(Path(folder), layout, camera, max_frames, follow_links, topics, least)
    LOG.info("%s: layout %s, %d frames", sequence.root, sequence.layout, len(sequence.frames))
    LOG.info("camera: %s", sequence.camera.source)
    alone = sequence.color_only
    tell(note for note in sequence.notes if not alone or note != alone.left_out)
    return sequence


def write_run(run: Registration, target: Path, workers: Workers, store: Store, problem: str = "") -> None:
    """Write all files of a run; the log and the report last, as they show the other files."""
    from miniloop_cli.report.page import write_report
    from miniloop_cli.results.columns import load
    from miniloop_cli.results.log import write_log
    from miniloop_cli.results.write import write_results

    LOG.info("writing %s", target)
    write_results(run, target, workers, store)
    data = load(target, run.sequence)
    write_log(run, data, problem)
    write_report(data, store, workers)


def calibrate(
    folder: Path | str,
    *,
    overrides: Many[str] = (),
    layout: str | None = None,
    topics: str = "",
    follow_links: bool = False,
    camera: Path | str | None = None,
    max_frames: int | None = 100,
    jobs: int = -1,
    seed: int = 0,
    quiet: bool = True,
) -> Calibration:
    """The camera of a recording, estimated from it (docs/calibration.md); no files are written.

    Raises RegistrationError if no scans could be registered, MiniloopError if there are too few points.
    """
    from miniloop_cli.errors import MiniloopError
    from miniloop_cli.pipeline import register as run_pipeline
    from miniloop_cli.presets import load_settings
    from miniloop_cli.runtime.artifact_store import Store, default_folder
    from miniloop_cli.runtime.parallel import Workers

    settings = load_settings("default", (*overrides, "calibrate=on"))
    sequence = open_recording(folder, settings, layout, camera, max_frames, follow_links, topics)
    run = run_pipeline(sequence, settings, Store(default_folder()), Workers(jobs, quiet), seed)
    if run.calibration is None:
        raise MiniloopError(
            f"{sequence.root}: too few points are seen in three or more frames to estimate the camera; "
            "record a place with more texture, move slowly, or raise --max-frames"
        )
    return run.calibration


def evaluate(
    result: Path | str,
    ground_truth: Path | str,
    *,
    edges: Path | str | None = None,
    protocol: Protocol | None = None,
    follow_links: bool = False,
) -> Evaluation:
    """Errors of a results folder or a trajectory against a recording's ground truth or a trajectory file.

    `edges`: an edges.csv, or a list of lines "i j", instead of the result's own verified edges. `.numbers` of the
    result are those of `miniloop eval --json`. Raises MiniloopError for unusable inputs.
    """
    from miniloop_cli.evaluation.evaluate import evaluate as run_evaluation
    from miniloop_cli.results.evaluation_inputs import read_inputs

    edges_path = Path(edges) if edges else None
    return run_evaluation(*read_inputs(Path(result), Path(ground_truth), edges_path, protocol, follow_links))


def simulate(
    folder: Path | str,
    *,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[Iterable[Any]], Iterator[Any]] = iter,
    **settings: Any,
) -> Path:
    """Write a synthetic recording with exact ground truth, in TUM's layout, and return its folder.

    `settings` are those of SimulationSettings: frames, width, height, scene, path, noise ... Raises MiniloopError.
    """
    from miniloop_cli.simulation.settings import SimulationSettings
    from miniloop_cli.simulation.write import write_sequence

    return write_sequence(Path(folder), SimulationSettings(**settings), seed, progress, overwrite)
