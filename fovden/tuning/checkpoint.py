"""Nested states on disk, such as an optimizer's: tensors and JSON in one safetensors file, and no pickle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from fovden.checks import require
from fovden.io import atomic_write
from fovden.io.files import FilePath

__all__ = ["load_state", "load_tensors", "save_state"]

TENSOR = "tensor"
MAPPING = "items"  # keys may be numbers, which those of JSON may not


def save_state(path: FilePath, state: Any) -> None:
    """Writes a state of nested mappings, lists, tuples, tensors, strings and numbers.

    Args:
        path: The file; its folder must exist.
        state: The state. Tuples come back as lists.

    Raises:
        TypeError: If there is anything else in it.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "state.safetensors"
        >>> save_state(path, {"step": 3, "moments": {0: torch.ones(2)}, "rates": [0.5, None]})
        >>> load_state(path)
        {'step': 3, 'moments': {0: tensor([1., 1.])}, 'rates': [0.5, None]}
    """
    tensors: dict[str, Tensor] = {}
    text = json.dumps(_pack(state, tensors))
    with atomic_write(path) as temporary:
        save_file(tensors, temporary, metadata={"state": text})


def load_state(path: FilePath) -> Any:
    """Returns a state that :func:`save_state` wrote.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: If it is missing.
        ValueError: If it is damaged or something else.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "state.safetensors"
        >>> save_state(path, torch.tensor([1, 2]))
        >>> load_state(path)
        tensor([1, 2])
    """
    tensors, metadata = load_tensors(path)
    require("state" in metadata, str(path), "no state", "a file of save_state")
    return _unpack(json.loads(metadata["state"]), tensors)


def load_tensors(path: FilePath) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Returns the tensors of a safetensors file by name, and the words that go with them.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: If it is missing.
        ValueError: If it is damaged or something else.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "ones.safetensors"
        >>> save_file({"ones": torch.ones(2)}, path, metadata={"unit": "metres"})
        >>> load_tensors(path)
        ({'ones': tensor([1., 1.])}, {'unit': 'metres'})
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with safe_open(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
            return tensors, file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: damaged, or not a safetensors file ({error})") from error


def _pack(state: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(state, Tensor):
        name = str(len(tensors))
        tensors[name] = state.detach().cpu().clone(memory_format=torch.contiguous_format)
        return {TENSOR: name}
    if isinstance(state, dict):
        return {MAPPING: [[key, _pack(value, tensors)] for key, value in state.items()]}
    if isinstance(state, list | tuple):
        return [_pack(each, tensors) for each in state]
    if state is None or isinstance(state, bool | int | float | str):
        return state
    raise TypeError(f"state: expected tensors, numbers, strings, lists and mappings, got {type(state).__name__}")


def _unpack(packed: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(packed, list):
        return [_unpack(each, tensors) for each in packed]
    if isinstance(packed, dict) and TENSOR in packed:
        return tensors[packed[TENSOR]]
    if isinstance(packed, dict):
        return {key: _unpack(value, tensors) for key, value in packed[MAPPING]}
    return packed
