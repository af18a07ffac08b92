"""Public functions are documented; those with arrays state the shapes, those that raise name their errors."""

import ast
import re
from pathlib import Path

import click
import pytest

import miniloop_cli

PACKAGE = Path(miniloop_cli.__file__).parent
ARRAY = re.compile(r"\b(Floats|Floats32|Ints|Bools|Bytes|NDArray|ndarray)\b")
# (n, 4, 4), (K,), (...), (3,), 3 x 4
SHAPE = re.compile(r"\([A-Za-z0-9_ +*/^.|-]+,[^()]*\)|\(\.\.\.\)|\b\d+ ?x ?\d+\b|\(\d\)|\([a-z]\)")


def public_functions():
    """(where, name, definition, docstring of its class) of each public function and method."""
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = [(ast.parse(path.read_text(encoding="utf-8")), "")]
        while inside:
            node, about = inside.pop()
            for child in ast.iter_child_nodes(node):
                if isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
                    inside.append((child, ast.get_docstring(child) or ""))
                elif isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
                    yield f"{path.relative_to(PACKAGE).as_posix()}:{child.lineno} {child.name}", child, about


# A method that a protocol (read(), header() ...), a path or click's group documents need not repeat it.
DOCUMENTED = {*dir(Path), *dir(click.Group)} | {
    node.name for _, node, about in public_functions() if about and ast.get_docstring(node)
}


def test_every_public_function_is_documented():
    missing = [
        where
        for where, node, about in public_functions()
        if not ast.get_docstring(node) and not (about and node.name in DOCUMENTED)
    ]
    assert missing == []


def raised_by(node):
    """The errors that the body of a function raises itself, without those of functions defined inside it."""
    waiting = list(node.body)
    while waiting:
        child = waiting.pop()
        if isinstance(child, (ast.FunctionDef, ast.ClassDef, ast.Lambda)):
            continue
        if isinstance(child, ast.Raise) and child.exc is not None:
            yield ast.unparse(child.exc)
        waiting += ast.iter_child_nodes(child)


def is_command(node):
    """Whether the docstring of a function is the help text of a command."""
    return any("command" in ast.unparse(one) or "group" in ast.unparse(one) for one in node.decorator_list)


@pytest.mark.slow
def test_functions_that_raise_say_so():
    unsaid, counted = [], 0
    for where, node, about in public_functions():
        errors = list(raised_by(node))
        said = ast.get_docstring(node) or ""
        if not errors or is_command(node) or (not said and node.name in DOCUMENTED):
            continue
        counted += 1
        if not re.search(r"\b[Rr]aises?\s", said + about):
            unsaid.append((where, errors))
    assert counted > 150
    assert unsaid == []


def about_module(where):
    """The docstring of the module of a function."""
    return ast.get_docstring(ast.parse((PACKAGE / where.split(":")[0]).read_text(encoding="utf-8"))) or ""


@pytest.mark.slow
def test_every_array_is_described():
    """By its name, in the docstring of the function, its class or its module; or there are as many shapes as arrays."""
    undescribed, counted = [], 0
    for where, node, about in public_functions():
        said = ast.get_docstring(node)
        if not said:
            continue
        arguments = [one for one in (*node.args.args, *node.args.kwonlyargs) if one.annotation is not None]
        names = [one.arg for one in arguments if ARRAY.search(ast.unparse(one.annotation))]
        counted += len(names)
        text = " ".join((said, about, about_module(where)))
        unnamed = [name for name in names if not re.search(rf"\b{name}\b", text)]
        if unnamed and len(SHAPE.findall(said)) < len(names):
            undescribed.append((where, unnamed))
    assert counted > 800
    assert undescribed == []


def test_functions_of_arrays_state_their_shapes():
    unstated, counted = [], 0
    for where, node, about in public_functions():
        annotations = [argument.annotation for argument in (*node.args.args, *node.args.kwonlyargs)] + [node.returns]
        if not any(ARRAY.search(ast.unparse(one)) for one in annotations if one is not None):
            continue
        counted += 1
        said = ast.get_docstring(node) or ""
        if not SHAPE.search(said + about) and not (about and not said and node.name in DOCUMENTED):
            unstated.append(where)
    assert counted > 500
    assert unstated == []
