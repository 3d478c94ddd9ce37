"""A comparison read back from its folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from fovden.checks import require
from fovden.comparison.methods import METHODS, file_name
from fovden.frame import Frame, Reference
from fovden.io import load_frame, load_image, load_reference
from fovden.results import Measurement, read_config, read_metrics, read_provenance

__all__ = ["SavedComparison", "read_comparison"]


@dataclass(frozen=True, eq=False)
class SavedComparison:
    """What the folder of a comparison holds.

    Attributes:
        scene: Name of the scene.
        images: Linear radiance of every method, shape (v, 3, h, w) each, in the order of the table.
        reference: What they are judged against.
        frames: The traced frames by name: ``"full"``, ``"foveated"`` and ``"equal_paths"``.
        exposure: Scale from radiance to the display.
        radii: Radii of the layers' circles in pixels, from the inside out.
        measurements: Every number.
        config: The settings.
        provenance: Versions, processor, commit, command and times.

    Example:
        >>> SavedComparison.__annotations__["radii"]
        'tuple[float, ...]'
    """

    scene: str
    images: dict[str, Tensor]
    reference: Reference
    frames: dict[str, Frame]
    exposure: float
    radii: tuple[float, ...]
    measurements: list[Measurement]
    config: dict[str, Any]
    provenance: dict[str, Any]

    @property
    def foveated(self) -> Frame:
        """The foveated noisy frame."""
        return self.frames["foveated"]


def read_comparison(folder: str | os.PathLike[str]) -> SavedComparison:
    """Reads what :func:`compare_denoisers` wrote.

    Args:
        folder: Its folder.

    Returns:
        The comparison.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If one is damaged, or holds something else.

    Example:
        >>> import tempfile
        >>> from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers
        >>> view, folder = SceneSettings("cornell_box", resolution=(16, 16)), tempfile.mkdtemp()
        >>> _ = compare_denoisers(CompareSettings(view, reference_spp=2, repeats=1), folder, progress=False)
        >>> read_comparison(folder).reference.count
        2
    """
    folder = Path(folder)
    measurements = read_metrics(folder)
    single = {(row.method, row.region, row.metric): row.value for row in measurements if row.view == ""}
    key = ("Reference", "whole", "exposure")
    require(key in single, str(folder / "metrics.csv"), "a table without exposure", "the results of a comparison")
    frames = {name: load_frame(folder / "frames" / f"{name}.exr") for name in ("full", "foveated", "equal_paths")}
    images = {
        method.name: frames[method.frame].radiance
        if method.denoiser is None
        else load_image(folder / "images" / f"{file_name(method.name)}.exr")
        for method in METHODS
    }
    return SavedComparison(
        scene=measurements[0].scene,
        images=images,
        reference=load_reference(folder / "reference.exr"),
        frames=frames,
        exposure=single[key],
        radii=tuple(row.value for row in measurements if (row.method, row.metric) == ("Foveation", "radius")),
        measurements=measurements,
        config=read_config(folder),
        provenance=read_provenance(folder),
    )
