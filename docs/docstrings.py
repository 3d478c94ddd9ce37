"""Brings the package's docstrings to Sphinx as they were meant."""

from __future__ import annotations

import contextlib
import re
import sys
import typing
from typing import Any

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

from fovden import frame
from fovden.foveation import Warp
from fovden.tracer import Scene


def show_as_written(_app: Sphinx, _what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Makes a literal block of each block that a docstring's text indents, and keeps the bars of absolute values."""
    shown: list[str] = []
    block: int | None = None  # margin of the text that a literal block interrupts
    example = False
    for line in lines:
        margin = len(line) - len(line.lstrip())
        example = bool(line) and (example or line.lstrip().startswith(">>>"))
        if block is not None and line and margin <= block:
            block = None
        if block is None and line and len(shown) > 1 and not shown[-1] and shown[-2]:
            before = shown[-2]
            outer = len(before) - len(before.lstrip())
            if margin > outer and not re.match(r"\s*([-*]|\.\.) ", before):
                block = outer
                shown += [] if before.endswith("::") else [" " * outer + "::", ""]
        if block is None and not example:
            line = re.sub(r"(``.*?``)|\|", lambda found: found[1] or r"\|", line)  # noqa: PLW2901
        shown.append(line)
    lines[:] = shown


def describe_values(_app: Sphinx, what: str, name: str, obj: Any, _options: Any, lines: list[str]) -> None:
    """Gives a value that a package passes on the text that stands below its definition."""
    package, _, leaf = name.rpartition(".")
    if what != "data":
        return
    for place in [place for place, module in sys.modules.items() if vars(module).get(leaf) is obj]:
        text = ModuleAnalyzer.for_module(place).find_attr_docs().get(("", leaf)) if place.startswith(package) else None
        if text:
            lines[:] = text


def keep_colons(_app: Sphinx, what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Puts back what stood before a colon: napoleon takes it for a type, and these docstrings state none."""
    for number in reversed(range(len(lines))):
        field = re.match(r":(rtype|type): (.*)", lines[number])
        if field and field[1] == "type" and what != "class":
            lines[0] = f"{field[2]}: {lines[0]}"
            del lines[number]
        elif field and field[1] == "rtype":
            start = max(n for n in range(number) if lines[n].lstrip().startswith(":returns:"))
            lines[start] = lines[start].replace(":returns:", f":returns: {field[2]}:", 1)
            del lines[number]


def put_types_beside_names(_app: Sphinx, what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Shows the types of a class's attributes as in the source, in place of a paragraph below each."""
    for number in reversed(range(len(lines))):
        field = re.match(r"\s+:type: .*", lines[number])
        if what == "class" and field:
            start = max(n for n in range(number) if lines[n].startswith(".. attribute::"))
            del lines[number]
            lines.insert(start + 1, field[0])


def resolve_annotations(_app: Sphinx, what: str, _name: str, obj: Any, *_: Any) -> None:
    """Evaluates annotations, so that names such as ``Border`` show what they stand for."""
    function = vars(obj).get("__init__") if what == "class" else obj
    names: dict[str, Any] = {"Scene": Scene}
    if what == "class":  # a data class repeats annotations of its bases, written with the names that are known there
        for base in reversed(obj.__mro__):
            names |= vars(sys.modules[base.__module__])
    if hasattr(function, "__annotations__"):
        with contextlib.suppress(AttributeError):  # a method of a built-in class has nothing to set
            function.__annotations__ = typing.get_type_hints(function, localns=names)


def leave_out_what_says_nothing(
    _app: Sphinx, _what: str, _name: str, obj: Any, skip: bool | None, _options: Any
) -> bool | None:
    """Leaves out the fields of named tuples, which their class describes."""
    return True if (getattr(obj, "__doc__", None) or "").startswith("Alias for field number") else skip


def setup(app: Sphinx) -> dict[str, bool]:
    """Connects the functions above."""
    vars(frame)["Warp"] = Warp  # known to type checkers alone where it is used, which leaves nothing to refer to
    app.connect("autodoc-process-docstring", describe_values, priority=50)
    app.connect("autodoc-process-docstring", show_as_written, priority=100)  # before napoleon
    app.connect("autodoc-process-docstring", keep_colons, priority=900)  # after it
    app.connect("autodoc-process-docstring", put_types_beside_names, priority=900)
    app.connect("autodoc-process-signature", resolve_annotations, priority=100)
    app.connect("autodoc-skip-member", leave_out_what_says_nothing)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
