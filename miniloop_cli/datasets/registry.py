"""The layouts by name: those built in, and plug-ins of other packages (entry points of the group GROUP)."""

from __future__ import annotations

import difflib
import logging
import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from miniloop_cli.datasets.layout import Layout
from miniloop_cli.errors import InputError

LOG = logging.getLogger("miniloop")
GROUP = "miniloop.layouts"
_PACKAGE = "miniloop_cli.datasets.layouts"
BUILT_IN = {  # in the order in which layouts are tried: specific ones first
    name: EntryPoint(name, f"{_PACKAGE}.{where}", GROUP)
    for name, where in {
        "realsense": "realsense_bag:RealSenseBag",
        "ros": "ros_bag:RosBag",
        "azure-kinect": "azure_kinect:AzureKinect",
        "elastic-fusion": "elastic_fusion:ElasticFusion",
        "7-scenes": "seven_scenes:SevenScenes",
        "polycam": "polycam:Polycam",
        "record3d": "record3d:Record3D",
        "record3d-file": "record3d_file:Record3DFile",
        "stray-scanner": "stray_scanner:StrayScanner",
        "arkitscenes": "arkitscenes:ARKitScenes",
        "scannet-sens": "scannet_sens:ScanNetSens",
        "scannetpp": "scannetpp:ScanNetPP",
        "replica": "replica:Replica",
        "bop": "bop:Bop",
        "openloris": "openloris:OpenLoris",
        "nerfstudio": "nerfstudio:Nerfstudio",
        "eth3d": "eth3d:Eth3d",
        "bonn": "bonn:Bonn",
        "icl-nuim": "icl_nuim:IclNuim",
        "scannet": "scannet:ScanNet",
        "open3d": "redwood:Redwood",
        "tum": "tum:Tum",
    }.items()
}


def known_layouts() -> dict[str, EntryPoint]:
    """Every layout by name, in the order in which they are tried; nothing is imported.

    Plug-ins come first, by name, as some of the built-in layouts match any folder with rgb/ and depth/. A plug-in
    cannot have the name of another layout.
    """
    plugins: dict[str, EntryPoint] = {}
    for entry in _installed(tuple((folder, _changed_ns(folder)) for folder in sys.path)):
        if entry.name in plugins or entry.name in BUILT_IN:
            LOG.warning("%s is left out: there is another layout of this name", _called(entry))
        else:
            plugins[entry.name] = entry
    return plugins | BUILT_IN


@cache
def _installed(folders: tuple[tuple[str, int], ...]) -> list[EntryPoint]:
    """The plug-ins of all installed packages, by name.

    `folders`: those of sys.path, and when a package was last installed or removed there; only a key of the cache.
    """
    return sorted(entry_points(group=GROUP), key=lambda entry: entry.name)


def _changed_ns(folder: str) -> int:
    """When the content of a folder of sys.path last changed; 0 if it cannot be told."""
    try:
        return Path(folder).stat().st_mtime_ns
    except (OSError, ValueError):
        return 0


def find_layout(name: str) -> Layout:
    """The layout of this name. Raises InputError if there is none, or if it cannot be loaded."""
    known = BUILT_IN if name in BUILT_IN else known_layouts()
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise InputError(f"unknown layout '{name}'; {hint}known: {', '.join(known)}")
    return _load(known[name])


def load_layouts() -> dict[str, Layout]:
    """Every layout in the order of `known_layouts`; a plug-in that cannot be loaded is left out with a warning.

    Raises InputError if a built-in one cannot be loaded.
    """
    loaded = {}
    for name, entry in known_layouts().items():
        try:
            loaded[name] = _load(entry)
        except InputError as error:
            if name in BUILT_IN:
                raise
            LOG.warning("%s; it is left out", error)
    return loaded


def _load(entry: EntryPoint) -> Layout:
    try:
        layout = entry.load()()
    except Exception as error:  # a plug-in may raise anything
        raise InputError(f"{_called(entry)} cannot be loaded ({type(error).__name__}: {error})") from error
    if not isinstance(layout, Layout):
        raise InputError(f"{_called(entry)} is not a layout: {entry.value} lacks matches, open or ground_truth")
    return layout


def _called(entry: EntryPoint) -> str:
    return f"layout '{entry.name}'" + (f" of the package {entry.dist.name}" if entry.dist else "")
