"""Parameters on disk: tensors in a safetensors file, and beside it the same in numbers that a person can read."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save_file
from torch import nn

from fovden.checks import require
from fovden.io import atomic_write
from fovden.io.files import FilePath
from fovden.tuning.checkpoint import load_tensors

__all__ = ["describe", "load_parameters", "readable", "save_parameters"]

MOST_NUMBERS = 32
"""A parameter of more elements is not spelt out."""

LOGARITHM = "log_"
"""What the names of parameters that are logarithms begin with."""


def readable(module: nn.Module) -> dict[str, float]:
    """Returns the learnable numbers of a module by name, logarithms as what they are logarithms of.

    Args:
        module: Any module.

    Returns:
        Numbers by name, in the order of the parameters: ``edge_stopping.0.sigma_normal`` for
        ``edge_stopping.0.log_sigma_normal``, with an index where a parameter has several elements. Parameters of more
        than 32 elements are left out, and those beside them in their module: the biases of a network, with its weights.

    Example:
        >>> from fovden.filters import EdgeStopping
        >>> {name: round(number, 3) for name, number in readable(EdgeStopping(4.0)).items()}
        {'sigma_radiance': 4.0, 'sigma_normal': 0.1, 'sigma_position': 0.03}
    """
    numbers = {}
    large = {name.rpartition(".")[0] for name, each in module.named_parameters() if each.numel() > MOST_NUMBERS}
    for name, parameter in module.named_parameters():
        *path, leaf = name.split(".")
        if ".".join(path) in large:
            continue
        values = parameter.detach().double()
        if leaf.startswith(LOGARITHM):
            leaf, values = leaf.removeprefix(LOGARITHM), values.exp()
        for index in itertools.product(*map(range, values.shape)):
            at = f"[{','.join(map(str, index))}]" if index else ""
            numbers[".".join([*path, leaf]) + at] = float(values[index])
    return numbers


def describe(module: nn.Module) -> dict[str, Any]:
    """Returns what a module is apart from its parameters: the class and the options of it and of its parts.

    Args:
        module: Any module whose options are public attributes.

    Returns:
        Options as JSON can hold them, by the name of the part; the whole has the name ``""``.

    Example:
        >>> from fovden.filters import EdgeStopping
        >>> describe(EdgeStopping(schedule="constant"))
        {'': {'class': 'EdgeStopping', 'schedule': 'constant', 'sigma_by': 'pass'}}
    """
    parts = {}
    for name, part in module.named_modules():
        options = {key: value for key, value in vars(part).items() if not key.startswith("_") and key != "training"}
        parts[name] = {"class": type(part).__name__, **{key: _plain(value) for key, value in options.items()}}
    return parts


def _plain(value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return [_plain(each) for each in value] if isinstance(value, tuple | list) else repr(value)


def save_parameters(module: nn.Module, path: FilePath, notes: Mapping[str, Any] | None = None) -> None:
    """Writes the parameters and buffers of a module, and ``path`` with the ending ``.json`` for people to read.

    Args:
        module: The module.
        path: The file, best with the ending ``.safetensors``; its folder must exist.
        notes: What else to write into the JSON file.

    Raises:
        FileNotFoundError: If the folder does not exist.

    Example:
        >>> import tempfile
        >>> from fovden.filters import EdgeStopping
        >>> folder = Path(tempfile.mkdtemp())
        >>> save_parameters(EdgeStopping(4.0), folder / "edges.safetensors", {"scene": "atrium"})
        >>> json.loads((folder / "edges.json").read_text())["scene"]
        'atrium'
    """
    path, options = Path(path), describe(module)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in module.state_dict().items()}
    with atomic_write(path) as temporary:
        save_file(tensors, temporary, metadata={"module": json.dumps(options)})
    text = json.dumps({**(notes or {}), "parameters": readable(module), "module": options}, indent=1)
    with atomic_write(path.with_suffix(".json")) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def load_parameters(module: nn.Module, path: FilePath) -> None:
    """Reads parameters into a module that is made as the one was that they were learned with.

    Args:
        module: The module; it is left as it was if anything is wrong.
        path: A file of :func:`save_parameters`.

    Raises:
        FileNotFoundError: If the file is missing.
        ValueError: If it is damaged, or belongs to a module with other parts, options or shapes.

    Example:
        >>> import tempfile
        >>> from fovden.filters import EdgeStopping
        >>> path = Path(tempfile.mkdtemp()) / "edges.safetensors"
        >>> save_parameters(EdgeStopping(4.0), path)
        >>> edges = EdgeStopping()
        >>> load_parameters(edges, path)
        >>> round(edges.sigma_radiance.item(), 4)
        4.0
    """
    tensors, metadata = load_tensors(path)
    require("module" in metadata, str(path), "no description of a module", "a file of save_parameters")
    _require_same(str(path), json.loads(metadata["module"]), describe(module))
    own = module.state_dict()
    for name in sorted(own.keys() | tensors.keys()):
        mine, theirs = (list(each[name].shape) if name in each else None for each in (own, tensors))
        require(mine == theirs, f"{path}: {name}", _shape(theirs), _shape(mine))
    module.load_state_dict(tensors)


def _shape(shape: list[int] | None) -> str:
    return "no such parameter" if shape is None else f"shape {tuple(shape)}"


def _require_same(path: str, saved: dict[str, Any], own: dict[str, Any]) -> None:
    for part in sorted(saved.keys() | own.keys()):
        theirs, mine = saved.get(part, {}), own.get(part, {})
        for key in sorted(theirs.keys() | mine.keys()):
            name = f"{path}: {part}.{key}".replace(": .", ": ")
            require(theirs.get(key) == mine.get(key), name, theirs.get(key), f"{mine.get(key)!r}, as in the module")
