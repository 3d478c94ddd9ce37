"""References: many samples a pixel, accumulated over minutes or hours, interrupted and continued at will.

The state is two sums in double precision, of the samples and of their squares, and the number of samples in them. Each
sample is added by itself and in order, so the sums do not depend on how the work was divided: a run that was stopped
and continued gives the same bits as one that was not.
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from fovden import parallel
from fovden.camera import Camera, StereoCamera
from fovden.checks import require, require_integer
from fovden.frame import Reference
from fovden.io.files import atomic_write
from fovden.rng import Stream
from fovden.tracer.arrays import view_arrays
from fovden.tracer.integrator import Integrator, require_light
from fovden.tracer.kernels import paths
from fovden.tracer.scene import Scene

__all__ = ["CheckpointError", "accumulate_reference"]

PIXELS_PER_TILE = 256  # at most
SECONDS_PER_TILE = 0.1  # an interruption waits for the tiles that are being worked on
SECONDS_PER_PASS = 15.0  # a pass is what an interruption costs; each pass traces the camera rays once more


BY_POWER = Integrator(lights="power")


class CheckpointError(ValueError):
    """A checkpoint that cannot be read, or that belongs to another scene, camera or setting."""


def accumulate_reference(
    scene: Scene,
    camera: Camera | StereoCamera,
    *,
    spp: int = 1024,
    seed: int = 0,
    checkpoint: str | os.PathLike[str] | None = None,
    jitter: bool = False,
    integrator: Integrator = BY_POWER,
    progress: parallel.Progress = True,
) -> Reference:
    """Returns the mean of many samples per pixel, and the variance of that mean.

    With a checkpoint the sums are written there after each pass over the image, about every quarter of a minute,
    atomically; a call that finds the file continues it. A file with more samples than asked for is an error, since
    samples cannot be removed; one with as many is returned at once, and one with fewer is continued, also beyond what
    it was first meant for.

    Args:
        scene: The scene.
        camera: The views.
        spp: Samples per pixel, at least 1; with 1 the variance is unknown and given as 0.
        seed: Seed of the random numbers. They differ from those of any frame with the same seed.
        checkpoint: File to continue and to keep, or ``None``.
        jitter: Whether camera rays are spread over the pixel (anti-aliased) or pass its centre, as in frames.
        integrator: How paths are made.
        progress: See :func:`fovden.parallel.run`; called with samples times pixels.

    Returns:
        The reference.

    Raises:
        CheckpointError: If the checkpoint is unreadable or belongs to another scene, camera, seed or setting.
        ValueError: If the scene has no light, or an argument is out of range.

    Differentiable: no. Cost: about what ``spp`` frames of one sample cost.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> reference = accumulate_reference(scene, scene.camera.at(resolution=(8, 8)), spp=16, progress=None)
        >>> reference.count, reference.mean.shape
        (16, torch.Size([2, 3, 8, 8]))
    """
    require_integer("spp", spp, minimum=1)
    require_integer("seed", seed, minimum=0, maximum=0xFFFFFFFF)
    require_light(scene)
    views = camera.views
    shape = (views.view_count, 3, *views.resolution)
    identity = _fingerprint(scene, views, integrator, jitter, seed)
    sums = _Sums(torch.zeros(shape, dtype=torch.float64), torch.zeros(shape, dtype=torch.float64), 0)
    path = None if checkpoint is None else Path(checkpoint)
    if path is not None and path.exists():
        sums = _load(path, identity, shape)
        enough = sums.count <= spp
        require(enough, "spp", spp, f"at least the {sums.count} samples that are in the checkpoint {path}")
    elif path is not None and not path.parent.is_dir():
        raise FileNotFoundError(f"checkpoint: expected an existing folder, got {path.parent}")
    pixels = shape[0] * shape[2] * shape[3]
    arguments = (*scene.kernel_arrays(integrator.lights), view_arrays(views))
    per_pass, tile = 1, PIXELS_PER_TILE
    with parallel.reporting(progress, pixels * spp, f"{scene.name}, {spp} spp", unit=" samples") as report:
        while sums.count < spp:
            first, last = sums.count, min(sums.count + per_pass, spp)
            began = time.monotonic()
            parallel.run(
                paths.accumulate_all,
                pixels,
                (
                    *arguments,
                    first,
                    last,
                    jitter,
                    integrator.setting(seed, Stream.REFERENCE),
                    sums.total.numpy(),
                    sums.squares.numpy(),
                ),
                tile=tile,
                progress=lambda done, first=first, last=last: report(pixels * first + done * (last - first)),  # type: ignore[misc]
            )
            sums.count = last
            if path is not None:
                _save(path, sums, identity)
            seconds_per_sample = max(time.monotonic() - began, 1e-6) / (last - first)
            # At most doubled: the first passes are short, and say little about the speed of long ones.
            per_pass = max(1, min(2 * per_pass, int(SECONDS_PER_PASS / seconds_per_sample)))
            seconds_per_pixel = seconds_per_sample * per_pass * torch.get_num_threads() / pixels
            tile = max(1, min(PIXELS_PER_TILE, int(SECONDS_PER_TILE / seconds_per_pixel)))
    mean = sums.total / spp
    spread = (sums.squares - sums.total * mean).clamp_min(0) / max(spp - 1, 1)
    return Reference(mean.float(), (spread / spp).float(), spp, views, seed)


@dataclass
class _Sums:
    """The running sums of samples and of their squares, and how many samples are in them."""

    total: Tensor
    squares: Tensor
    count: int = field(default=0)


def _fingerprint(scene: Scene, views: Camera, integrator: Integrator, jitter: bool, seed: int) -> str:
    """Digest of all that decides the samples' values, but not their number; the choice of lights may change."""
    digest = hashlib.sha256(repr((views.resolution, integrator.bounces, integrator.sampler, jitter, seed)).encode())
    tensors = [scene.vertices, scene.faces, scene.material_ids, scene.normals, scene.uv]
    for values in vars(scene.materials).values():
        tensors += [
            value for value in (values if isinstance(values, tuple) else (values,)) if isinstance(value, Tensor)
        ]
    tensors += [views.origin, views.rotation, views.bounds]
    for light in scene.lights:
        values = vars(light)
        digest.update(type(light).__name__.encode())
        for name, value in values.items():
            digest.update(name.encode())
            if isinstance(value, Tensor):
                tensors.append(value)
            else:
                digest.update(repr(value).encode())
    for tensor in tensors:
        digest.update(repr((tuple(tensor.shape), tensor.dtype)).encode())
        digest.update(tensor.detach().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _save(path: Path, sums: _Sums, identity: str) -> None:
    metadata = {"count": str(sums.count), "identity": identity, "format": "fovden reference sums 1"}
    with atomic_write(path) as temporary:
        save_file({"total": sums.total, "squares": sums.squares}, temporary, metadata=metadata)


def _load(path: Path, identity: str, shape: tuple[int, ...]) -> _Sums:
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            sums = _Sums(file.get_tensor("total"), file.get_tensor("squares"), int(metadata["count"]))
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise CheckpointError(f"checkpoint: expected a file of reference sums, got {path} ({error})") from error
    if metadata.get("identity") != identity or tuple(sums.total.shape) != shape:
        message = f"checkpoint: {path} belongs to another scene, camera, seed or setting; remove it or name another"
        raise CheckpointError(message)
    return sums
