"""What do the foveated denoisers save, and what does it cost in quality?

    python -m experiments.compare_denoisers --preset smoke

The same comparison as ``fovden compare`` and ``fovden demo``, with settings that can be quoted by name.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from experiments.harness import run_script
from fovden.comparison import PRESETS, CompareSettings, SceneSettings, compare_denoisers, summary
from fovden.figures import draw_figures
from fovden.report import report_comparison
from fovden.results import read_metrics
from fovden.tracer import DirectionalLight, PointLight

__all__ = ["main", "sponza"]


def sponza() -> CompareSettings:
    """Returns the 2023 paper's setting on Crytek's Sponza: its triangles, one directional and one point light.

    The scene is looked for in the folder that the environment variable ``FOVDEN_SCENES`` names, or in
    ``../shared/scenes``, as ``sponza/sponza.obj``.

    Example:
        >>> sponza().reference_spp
        1024
    """
    folder = Path(os.environ.get("FOVDEN_SCENES", "../shared/scenes"))
    view = SceneSettings(
        scene=str(folder / "sponza" / "sponza.obj"),
        lights=(DirectionalLight((0.15, -1, 0.25), 12), PointLight((0, 4.5, -0.4), 40)),
        eye=(-11.5, 2.2, -0.4),
        target=(0, 3.4, 0),
        fov_x_deg=75,
        resolution=PRESETS["atrium"].view.resolution,
    )
    return replace(PRESETS["atrium"], view=view)


def run(settings: CompareSettings, folder: Path) -> None:
    """Compares, draws the figures, writes the page, and prints the table."""
    compare_denoisers(settings, folder)
    figures = draw_figures(folder)
    page = report_comparison(folder)
    print(summary(read_metrics(folder)))
    print(f"\nreport: {page}\nfigures: {figures[0].parent}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    presets = {name: lambda name=name: PRESETS[name] for name in PRESETS}
    return run_script("compare_denoisers", str(__doc__), {**presets, "sponza": sponza}, run, arguments)


if __name__ == "__main__":
    sys.exit(main())
