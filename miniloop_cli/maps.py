"""Maps of several recordings: register many together, add one, remove one. Each keeps the folder consistent.

The map itself changes in one step (results/map_folder.py). The files beside it are derived from it; if a process is
killed before it has written them, the next change of the map writes them first.
"""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Iterator, Mapping
from collections.abc import Sequence as Many
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from miniloop_cli.errors import InputError, MiniloopError

if TYPE_CHECKING:
    from miniloop_cli.config import Settings
    from miniloop_cli.runtime.artifact_store import Store
    from miniloop_cli.runtime.parallel import Workers
    from miniloop_cli.scene.registration import Registration
    from miniloop_cli.scene.scene_map import MapPart, SceneMap
    from miniloop_cli.scene.sequence import Sequence
    from miniloop_cli.stages.run import Run

LOG = logging.getLogger("miniloop")


def register_many(
    folders: Many[Path | str],
    output: Path | str,
    *,
    settings: Settings | Path | str = "default",
    overrides: Many[str] = (),
    layout: str | None = None,
    topics: str = "",
    follow_links: bool = False,
    camera: Path | str | None = None,
    max_frames: int | None = None,
    jobs: int = -1,
    seed: int = 0,
    fresh: bool = False,
    quiet: bool = True,
) -> dict[str, Any]:
    """Register recordings together: one map in `output`, each recording's files in a folder of its name there.

    The arguments are those of `register`, and hold for each recording. Returns the content of summary.json. A recording
    that cannot be registered is listed in "failed" and left out. Raises MiniloopError if none can be registered.
    """
    from miniloop_cli.api import open_recording
    from miniloop_cli.mapping.same_recording import refuse_known
    from miniloop_cli.presets import load_settings
    from miniloop_cli.runtime.folder_lock import exclusive
    from miniloop_cli.scene.registration import RegistrationError

    if not isinstance(settings, (str, Path)):
        chosen = settings
    else:
        chosen = load_settings(settings, tuple(overrides))
    target = Path(output)
    store, workers = _tools(jobs, fresh, quiet)
    with exclusive(target):
        runs: list[Registration] = []
        parts: list[MapPart] = []
        failed: dict[str, str] = {}
        for folder in folders:
            sequence = open_recording(folder, chosen, layout, camera, max_frames, follow_links, topics)
            sequence = replace(sequence, name=_free_name(sequence.name, [part.name for part in parts]))
            try:
                run, part = _registered(sequence, chosen, store, workers, seed)
            except RegistrationError as error:
                failed[sequence.name] = str(error)
                LOG.warning("%s is left out: %s", folder, error)
                continue
            refuse_known(part, parts)
            runs.append(run)
            parts.append(part)
        if not parts:
            raise MiniloopError(f"no recording could be registered: {'; '.join(failed.values())}")
        joined = _joined(parts, chosen, store, workers, seed, {})
        return _write(target, joined, runs, store, workers, {"failed": failed})


def add(
    result: Path | str,
    folder: Path | str,
    *,
    layout: str | None = None,
    topics: str = "",
    follow_links: bool = False,
    camera: Path | str | None = None,
    max_frames: int | None = None,
    jobs: int = -1,
    fresh: bool = False,
    quiet: bool = True,
) -> dict[str, Any]:
    """Add a recording to the map of a result, with the settings and the seed of the map.

    The result is that of registering all of its recordings together. Returns the content of summary.json. Raises
    MiniloopError if the recording is in the map already, or cannot be registered; the map is then unchanged.
    """
    from miniloop_cli.api import open_recording
    from miniloop_cli.mapping.same_recording import refuse_images, refuse_known
    from miniloop_cli.results.map_folder import map_settings

    target = Path(result)
    store, workers = _tools(jobs, fresh, quiet)
    with _changing(target) as before:
        settings = map_settings(target, before)
        sequence = open_recording(folder, settings, layout, camera, max_frames, follow_links, topics)
        sequence = replace(sequence, name=_free_name(sequence.name, [part.name for part in before.parts]))
        refuse_images(sequence, before.parts)
        run, part = _registered(sequence, settings, store, workers, before.seed)
        refuse_known(part, before.parts)
        after = _extended(before, part, settings, store, workers)
        return _write(target, after, [run], store, workers, {}, before)


def remove(result: Path | str, name: str, *, jobs: int = -1, quiet: bool = True) -> dict[str, Any]:
    """Remove a recording from the map of a result; the others are as if registered without it.

    Returns the content of summary.json. Raises MiniloopError for an unknown name, and for the only recording.
    """
    from miniloop_cli.results.map_folder import map_settings

    target = Path(result)
    store, workers = _tools(jobs, False, quiet)
    with _changing(target) as before:
        names = [part.name for part in before.parts]
        if name not in names:
            raise InputError(f"{target} has no recording '{name}'; it has {', '.join(names)}")
        if len(names) == 1:
            raise InputError(f"'{name}' is the only recording of {target}: remove the folder instead")
        gone = names.index(name)
        number = {old: new for new, old in enumerate(k for k in range(len(names)) if k != gone)}
        solved = {(number[a], number[b]): t for (a, b), t in before.joined.solved.items() if gone not in (a, b)}
        parts = [part for k, part in enumerate(before.parts) if k != gone]
        settings = map_settings(target, before)
        after = _joined(parts, settings, store, workers, before.seed, solved)
        return _write(target, after, [], store, workers, {}, before)


@contextmanager
def _changing(target: Path) -> Iterator[SceneMap]:
    """The map of a folder, locked against other processes, with all files beside it up to date."""
    from miniloop_cli.results.map_files import up_to_date, write_map_files
    from miniloop_cli.results.map_folder import read_manifest, read_map
    from miniloop_cli.runtime.folder_lock import exclusive

    read_manifest(target)  # raises before a folder without a map is locked
    with exclusive(target):
        before = read_map(target)
        if len(before.parts) > 1 and not up_to_date(target):
            LOG.warning(
                "%s: an earlier run was interrupted after it had changed the map; its files are written now", target
            )
            write_map_files(target, before, {})
        yield before


def _registered(
    sequence: Sequence, settings: Settings, store: Store, workers: Workers, seed: int
) -> tuple[Registration, MapPart]:
    """A recording registered by itself, and its part of the map, exactly as it would be read back."""
    from miniloop_cli.mapping.part import part_of
    from miniloop_cli.pipeline import register
    from miniloop_cli.results.map_arrays import part_arrays, part_from, part_header

    run = register(sequence, settings, store, workers, seed)
    part = part_of(run, settings.features.type)
    return run, part_from(part_header(part), part_arrays(part))


def _joined(
    parts: Many[MapPart], settings: Settings, store: Store, workers: Workers, seed: int, solved: Mapping[Any, Any]
) -> SceneMap:
    from miniloop_cli.mapping.alone import map_of
    from miniloop_cli.stages.join import join
    from miniloop_cli.stages.run import Run

    if len(parts) == 1:
        return map_of(parts[0], settings.model_dump(), seed)
    return _examined(lambda run: join(parts, settings, run, solved), settings, Run(store, workers, seed))


def _extended(before: SceneMap, part: MapPart, settings: Settings, store: Store, workers: Workers) -> SceneMap:
    from miniloop_cli.stages.extend import extend
    from miniloop_cli.stages.run import Run

    run = Run(store, workers, before.seed)
    return _examined(lambda run: extend(before, part, settings, run), settings, run)


def _examined(make: Callable[[Run], SceneMap], settings: Settings, run: Run) -> SceneMap:
    from miniloop_cli.runtime.parallel import single_inner_threads
    from miniloop_cli.stages.joints import examined

    with single_inner_threads():
        return examined(make(run), settings, run)


def _write(
    target: Path,
    scene_map: SceneMap,
    runs: Many[Registration],
    store: Store,
    workers: Workers,
    extra: dict[str, Any],
    old: SceneMap | None = None,
) -> dict[str, Any]:
    """Write the map, then the files of the runs in its world, then the common files; `old`: the map before."""
    from miniloop_cli.api import write_run
    from miniloop_cli.mapping.carry import map_trajectories
    from miniloop_cli.report.map_page import write_map_page
    from miniloop_cli.results.map_files import write_map_files
    from miniloop_cli.results.map_folder import has_map, read_manifest, write_map

    before = [str(entry["name"]) for entry in read_manifest(target)["recordings"]] if has_map(target) else []
    write_map(target, scene_map, old)
    _make_room(target, before)
    for name in set(before) - {part.name for part in scene_map.parts}:
        shutil.rmtree(target / name, ignore_errors=True)
    for part, T in zip(scene_map.parts, map_trajectories(scene_map), strict=True):
        for run in runs:
            if run.sequence.name == part.name:
                poses = run.poses.T_world_cam.copy()
                poses[part.frame] = T
                write_run(replace(run, poses=replace(run.poses, T_world_cam=poses)), target / part.name, workers, store)
    numbers = write_map_files(target, scene_map, extra)
    write_map_page(target, scene_map, numbers, store)
    return numbers


def _make_room(target: Path, before: Many[str]) -> None:
    """Move the files of a run of one recording from the top into the folder of the recording."""
    from miniloop_cli.results.write import FILES

    if not (target / "trajectory.txt").is_file():
        return
    folder = target / before[0] if before else None
    for path in (target / name for name in FILES):
        if folder and path.is_file():
            folder.mkdir(exist_ok=True)
            path.replace(folder / path.name)
        path.unlink(missing_ok=True)


def _tools(jobs: int, fresh: bool, quiet: bool) -> tuple[Store, Workers]:
    from miniloop_cli.runtime.artifact_store import Store, default_folder
    from miniloop_cli.runtime.parallel import Workers

    return Store(default_folder(), fresh), Workers(jobs, quiet)


def _free_name(name: str, taken: Many[str]) -> str:
    """The name, followed by a number if another recording has it."""
    names = (name if k == 1 else f"{name}-{k}" for k in range(1, len(taken) + 2))
    return next(free for free in names if free not in (*taken, "map"))
