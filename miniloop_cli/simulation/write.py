"""A simulated recording as a folder in TUM's layout, written completely or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from miniloop_cli.datasets.intrinsics import save_camera
from miniloop_cli.datasets.paths import shown
from miniloop_cli.datasets.trajectory import write_trajectory
from miniloop_cli.errors import MiniloopError
from miniloop_cli.runtime.atomic_files import remove_leftovers, temporary_name
from miniloop_cli.simulation.settings import SimulationSettings
from miniloop_cli.simulation.simulate import (
    START_S,
    SimulatedFrame,
    accelerations,
    frame_times_s,
    simulate,
    true_trajectory,
)
from miniloop_cli.simulation.stretches import missing

MARKER = "simulation.yaml"  # marks a simulated folder, which may be replaced
STRETCHES = "stretches.csv"  # the frames of hard stretches

Progress = Callable[[Iterable[SimulatedFrame]], Iterator[SimulatedFrame]]


def write_sequence(
    folder: Path | str,
    settings: SimulationSettings,
    seed: int = 0,
    progress: Progress = iter,
    overwrite: bool = False,
) -> Path:
    """Simulate a recording into `folder` (rgb/, depth/, tables, groundtruth.txt, camera.yaml, simulation.yaml).

    The same settings and seed give the same bytes. Everything is written under a temporary name beside `folder`
    and renamed at the end. `overwrite` replaces a folder that was simulated before, never another one.
    With hard stretches, stretches.csv names their frames: stamp, stretch, and time of the image. A frame in two
    stretches has two rows; missing frames have one.

    Raises MiniloopError if the folder is in use or cannot be written.
    """
    folder = Path(folder).absolute()
    _check_free(folder, overwrite)
    temporary = temporary_name(folder)
    try:
        remove_leftovers(folder.parent)
        temporary.mkdir(parents=True)
        _write(temporary, settings, seed, progress)
        if folder.exists():
            old = temporary_name(folder.with_name(f"{folder.name}.old"))
            folder.rename(old)
            temporary.rename(folder)
            shutil.rmtree(old, ignore_errors=True)
        else:
            temporary.rename(folder)
    except OSError as error:
        raise MiniloopError(f"cannot write {shown(folder)}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def _check_free(folder: Path, overwrite: bool) -> None:
    try:
        if not folder.exists():
            return
        if not folder.is_dir():
            raise MiniloopError(f"{shown(folder)} is a file; choose another name for the folder")
        if not any(folder.iterdir()):
            return
        if not (folder / MARKER).exists():
            raise MiniloopError(f"{shown(folder)} holds other files; choose a new folder")
        if not overwrite:
            raise MiniloopError(f"{shown(folder)} is already there; --overwrite replaces it")
    except OSError as error:
        raise MiniloopError(f"cannot use {shown(folder)}: {error.strerror or error}") from error


def _write(folder: Path, settings: SimulationSettings, seed: int, progress: Progress) -> None:
    import yaml

    kinds = ("rgb", "depth", "mask") if settings.masks and settings.moving_object else ("rgb", "depth")
    for kind in kinds:
        (folder / kind).mkdir()
    stamps, unsorted, hard, writes = list[str](), list[str](), list[tuple[str, str, str]](), list[Future[None]]()
    frames = simulate(settings, np.random.default_rng(seed))
    with ThreadPoolExecutor(2) as pool:
        for frame in progress(frames):
            name = f"{frame.timestamp_s:.6f}"
            if "unsorted" in frame.stretches:
                unsorted.append(name)
            else:
                stamps += [*reversed(unsorted), name]
                unsorted.clear()
            hard += [(name, stretch, f"{frame.taken_s:.6f}") for stretch in frame.stretches]
            part = 0.5 if "broken" in frame.stretches else 1.0
            writes.append(pool.submit(_write_png, folder / "rgb" / f"{name}.png", frame.color[..., ::-1], part))
            writes.append(pool.submit(_write_png, folder / "depth" / f"{name}.png", frame.depth))
            if "mask" in kinds and frame.moving is not None:
                mask = frame.moving.astype(np.uint8) * 255
                writes.append(pool.submit(_write_png, folder / "mask" / f"{name}.png", mask))
            while len(writes) > 16:  # reports a full disk at once, and limits images in memory
                writes.pop(0).result()
        for write in writes:
            write.result()
    stamps += reversed(unsorted)
    for kind, what in (("rgb", "color images"), ("depth", "depth maps")):
        rows = "".join(f"{name} {kind}/{name}.png\n" for name in stamps)
        text = f"# {what}\n# file: simulated by miniloop\n# timestamp filename\n{rows}"
        (folder / f"{kind}.txt").write_text(text, encoding="utf-8")
    write_trajectory(folder / "groundtruth.txt", true_trajectory(settings, np.random.default_rng(seed)))
    if settings.hard:
        hard += [(f"{START_S + frame_times_s(settings)[k]:.6f}", "missing", "") for k in missing(settings)]
        text = "".join(f"{','.join(row)}\n" for row in [("timestamp", "stretch", "taken"), *sorted(hard)])
        (folder / STRETCHES).write_text(text, encoding="utf-8")
    if settings.accelerometer:
        readings = zip(*accelerations(settings, np.random.default_rng(seed)), strict=True)
        rows = "".join(f"{stamp:.6f} {x:.6f} {y:.6f} {z:.6f}\n" for stamp, (x, y, z) in readings)
        text = f"# accelerometer data, camera axes\n# file: simulated by miniloop\n# timestamp ax ay az\n{rows}"
        (folder / "accelerometer.txt").write_text(text, encoding="utf-8")
    save_camera(folder / "camera.yaml", settings.camera, depth_camera=settings.depth_camera)
    record = asdict(settings) | {"distortion": list(settings.distortion), "hard": list(settings.hard), "seed": seed}
    (folder / MARKER).write_text(yaml.safe_dump(record, sort_keys=False), encoding="utf-8")


def _write_png(path: Path, image: NDArray, part: float = 1.0) -> None:
    import cv2

    done, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise MiniloopError(f"cannot encode {shown(path)}")
    path.write_bytes(data[: int(part * len(data))].tobytes())
