"""The text of a camera file as a mapping: JSON, YAML (OpenCV's dialect too), OpenCV's XML; or as lines."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from miniloop_cli.datasets.paths import read_bytes, shown
from miniloop_cli.errors import InputError
from miniloop_cli.runtime.safe_yaml import load_plain

MAX_YAML_BYTES = 64 << 10  # a larger one would take seconds
MAX_XML_DEPTH = 20
_YAML_HEADER = re.compile(r"\A((?:\s*#[^\n]*\n)*)\s*%YAML[: ]\s*\d\.\d[^\n]*", re.ASCII)
_MATRIX_TAG = "tag:yaml.org,2002:opencv-matrix"
_INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9]*)\Z", re.ASCII)
_FLOAT = re.compile(r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\Z|[-+]?\.(?:inf|nan)\Z", re.ASCII)


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, or UTF-16 with a mark as Windows' shell writes it. Raises InputError."""
    data = read_bytes(path)
    try:
        return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{shown(path)}: not a text file (byte {error.start} is not UTF-8)") from None


def parse_mapping(text: str, path: Path) -> Any:
    """The content of a text in JSON, YAML or OpenCV's XML. Raises InputError naming the file, and the line if known."""
    start = text.lstrip()[:1]
    if start == "<":
        return _parse_xml(text, shown(path))
    if start == "{" and (path.suffix.lower() == ".json" or _looks_like_json(text)):
        return _parse_json(text, shown(path))
    return _parse_yaml(text, shown(path))


def _looks_like_json(text: str) -> bool:
    return re.match(r'\s*\{\s*(?:"|\})', text) is not None


def _once(pairs: list[tuple[str, Any]], where: str) -> dict[str, Any]:
    """Keys and values as a mapping. Raises InputError for a repeated key."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"{where}: key '{shown(twice[:40])}' is given twice")
    return found


def _parse_json(text: str, where: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=lambda pairs: _once(pairs, where))
    except json.JSONDecodeError as error:
        raise InputError(f"{where}:{error.lineno}: not JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: not JSON: {type(error).__name__}") from None


def _parse_yaml(text: str, where: str) -> Any:
    import yaml

    if len(text) > MAX_YAML_BYTES:
        raise InputError(f"{where}: {len(text) >> 10} kB of YAML, more than the {MAX_YAML_BYTES >> 10} kB allowed")
    # PyYAML refuses OpenCV's header. Its line is kept, so that line numbers are right. ROS ends messages with ---.
    plain = re.sub(r"\n---\s*\Z", "\n", _YAML_HEADER.sub(r"\1", text).replace("\t", " "))
    try:
        return load_plain(plain, _loader())
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{where}{line}: not a YAML file: {error.problem}") from None
    except yaml.YAMLError as error:
        raise InputError(f"{where}: not a YAML file: {error}") from None


@cache
def _loader() -> type:
    """YAML's safe loader with the numbers of YAML 1.2 and OpenCV's matrices; it refuses repeated keys.

    YAML 1.1 reads 1e-5 as text, 0640 as octal, 1_0 and 5:25 as numbers.
    """
    import yaml

    class CameraLoader(yaml.SafeLoader):
        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
            keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            for k, key in enumerate(keys):
                if key in keys[:k]:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key '{shown(key[:40])}' is given twice", node.value[k][0].start_mark
                    )
            return super().construct_mapping(node, deep)

    def matrix(loader: CameraLoader, node: yaml.MappingNode) -> Any:
        return loader.construct_mapping(node, deep=True)

    numbers = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float", "tag:yaml.org,2002:timestamp")
    CameraLoader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag not in numbers]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    CameraLoader.add_implicit_resolver(numbers[0], _INTEGER, list("-+0123456789"))
    CameraLoader.add_implicit_resolver(numbers[1], _FLOAT, list("-+.0123456789"))
    CameraLoader.add_constructor(_MATRIX_TAG, matrix)
    return CameraLoader


def _parse_xml(text: str, where: str) -> dict[str, Any]:
    from xml.etree import ElementTree

    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{where}: XML with a document type; OpenCV writes none")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{where}: not XML: {error}") from None
    if root.tag != "opencv_storage":
        raise InputError(f"{where}: XML of <{shown(root.tag[:40])}>; only OpenCV's <opencv_storage> is known")
    return _once([(child.tag, _xml_value(child, where, MAX_XML_DEPTH)) for child in root], where)


def _xml_value(element: Any, where: str, depth: int) -> Any:
    if depth == 0:
        raise InputError(f"{where}: XML nested more than {MAX_XML_DEPTH} deep")
    if len(element) and all(child.tag == "_" for child in element):  # how OpenCV writes a list
        return [_xml_value(child, where, depth - 1) for child in element]
    if len(element):
        children = _once([(child.tag, _xml_value(child, where, depth - 1)) for child in element], where)
        data = children.get("data")
        return children | {"data": [data]} if isinstance(data, int | float) else children
    words = (element.text or "").split()
    numbers = [_number(word) for word in words]
    if words and None not in numbers:
        return numbers[0] if len(numbers) == 1 else numbers
    return (element.text or "").strip().strip('"')


def _number(word: str) -> float | None:
    return float(word) if _FLOAT.match(word) and "n" not in word.lower() else None
