"""Which topics of a bag are colour and depth: by type, encoding and name, or given by the user."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from miniloop_cli.datasets.bags.bag import Bag, Topic
from miniloop_cli.datasets.bags.pixels import DEPTH_ENCODINGS, ENCODINGS, GREY_ENCODINGS, compressed_format
from miniloop_cli.datasets.bags.source import BagImage
from miniloop_cli.datasets.bags.wire import COMPRESSED, IMAGE, ImageHead
from miniloop_cli.datasets.paths import shown
from miniloop_cli.errors import InputError

ROLES = ("color", "depth", "info", "depth_info")
TRANSPORTS = ("/compressedDepth", "/compressed")
# Names of the usual drivers for depth on the pixels of colour, and for colour on those of depth.
REGISTERED = re.compile(
    r"(aligned_)?depth_?(to|2)_?(colou?r|rgb)|depth_registered|registered_depth|hw_registered", re.I
)
NOT_COLOR = re.compile(r"(rgb|colou?r)_?(to|2)_?depth|infra|(^|/)ir[_/0-9]|confidence|mask|label|debug", re.I)
NOT_DEPTH = re.compile(r"infra|(^|/)ir[_/0-9]|depth_?(to|2)_?infra|confidence", re.I)
LOOKED_AT = 5  # messages of a topic that are tried


@dataclass(frozen=True)
class ImageTopic:
    """A topic of images, and the head of one of them."""

    topic: Topic
    head: ImageHead
    kind: str  # color, grey or depth

    @property
    def name(self) -> str:
        return self.topic.name

    @property
    def base(self) -> str:
        """The topic of which this is another transport, or its own name."""
        return next((self.name[: -len(t)] for t in TRANSPORTS if self.name.endswith(t)), self.name)

    @property
    def registered(self) -> bool:
        """Whether depth is registered to colour, by the name of the topic."""
        return REGISTERED.search(self.name) is not None


def parse_topics(text: str) -> dict[str, str]:
    """`color=/a,depth=/b` as a mapping. Raises InputError for another form."""
    found = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        role, equals, name = (word.strip() for word in part.partition("="))
        role = "color" if role == "colour" else role
        if not equals or role not in ROLES or not name or role in found:
            raise InputError(f"--topics is a list such as color=/a,depth=/b,info=/c ({', '.join(ROLES)}), not '{text}'")
        found[role] = name if name.startswith("/") else f"/{name}"
    return found


def image_topics(path: Path, bag: Bag) -> tuple[list[ImageTopic], str]:
    """The topics of images of a supported kind, and why others cannot be read ("" if all can)."""
    found, problem = [], ""
    for topic in bag.topics.values():
        if topic.type not in (IMAGE, COMPRESSED):
            continue
        for place in topic.places[:LOOKED_AT]:
            try:
                head = BagImage(path, topic.name, topic.type, topic.wire, place).head()
            except InputError as error:
                problem = problem or f"{topic.name} cannot be read: {error}"
                continue
            if kind := _kind(topic, head):
                found.append(ImageTopic(topic, head, kind))
            break
    return found, problem


def _kind(topic: Topic, head: ImageHead) -> str:
    encoding = head.encoding
    if topic.type == COMPRESSED:
        encoding, how = compressed_format(head.encoding, topic.name)
        if how == "depth" or (how == "image" and encoding in DEPTH_ENCODINGS):
            return "depth"
        return "" if how != "image" else "grey" if encoding in GREY_ENCODINGS else "color"
    if encoding in DEPTH_ENCODINGS:
        return "depth" if encoding != "mono16" or "depth" in topic.name.lower() else ""
    return "grey" if encoding in GREY_ENCODINGS else "color" if encoding in ENCODINGS else ""


def choose_topics(
    path: Path, found: list[ImageTopic], topics: Mapping[str, str], bag: Bag, problem: str = ""
) -> tuple[ImageTopic, ImageTopic]:
    """Colour and depth; `problem` says why other topics were not found.

    Raises InputError if there is none, or if several fit.
    """
    color = _named(path, found, topics["color"], bag) if "color" in topics else None
    depth = _named(path, found, topics["depth"], bag) if "depth" in topics else None
    if depth is None:
        fitting = [t for t in found if t.kind == "depth" and not NOT_DEPTH.search(t.name)]
        registered = [t for t in fitting if t.registered]
        depth = _only(path, "depth", registered or fitting, color, bag, problem)
    if color is None:
        fitting = [t for t in found if t.kind == "color" and not NOT_COLOR.search(t.name)]
        fitting = fitting or [t for t in found if t.kind == "grey" and not NOT_COLOR.search(t.name)]
        raw = [t for t in fitting if "rect" not in t.base.rpartition("/")[2]]
        color = _only(path, "color", raw or fitting, depth, bag, problem)
    return color, depth


def _named(path: Path, found: list[ImageTopic], name: str, bag: Bag) -> ImageTopic:
    match = next((topic for topic in found if topic.name == name), None)
    if match is None:
        there = bag.topics.get(name)
        why = (
            "has no such topic"
            if there is None
            else f"{there.type}, {len(there.places)} messages: not images of a supported kind"
        )
        listed = ", ".join(sorted(t.name for t in found)) or "none"
        raise InputError(f"{shown(path)}: {shown(name)}: {why}; its topics of images: {shown(listed)}")
    return match


def _only(
    path: Path, role: str, fitting: list[ImageTopic], other: ImageTopic | None, bag: Bag, problem: str
) -> ImageTopic:
    """The one topic, in the best transport; of several cameras, that in the namespace of the `other` topic."""
    if not fitting:
        listed = ", ".join(f"{t.name} ({t.type}, {len(t.places)})" for t in bag.topics.values() if t.places)
        what = "colour" if role == "color" else role
        raise InputError(
            f"{shown(path)} has no topic of {what} images; {problem or 'its topics: ' + (listed or 'none')}"
        )
    bases = sorted({topic.base for topic in fitting})
    if other is not None and len(bases) > 1:
        space = other.base.split("/")[1]
        bases = [base for base in bases if base.split("/")[1] == space] or bases
    if len(bases) > 1:
        names = ", ".join(bases)
        raise InputError(
            f"{shown(path)} has {len(bases)} topics of {role} images: {names}; choose one by --topics {role}=NAME"
        )
    return min((topic for topic in fitting if topic.base == bases[0]), key=lambda topic: topic.topic.type != IMAGE)
