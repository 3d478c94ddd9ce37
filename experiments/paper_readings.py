"""Which of the paper's ambiguities matter: what does each other reading cost, or gain, in error?

    python -m experiments.paper_readings --preset smoke

NH3LD filters foveated frames of four scenes. In each row one reading of the 2023 paper is changed from its default and
everything else is left, and the errors are compared with the default's on the same frames. This is done with widths
that were fitted for the default, to each scene by itself, and, where the reading changes the error of the frames held
out by more than a threshold, with widths that were fitted on for the reading: widths may make up for a reading. Fits
for the readings begin at the default's widths and make the same steps in the same order. The default's own fit goes on
by as many steps too, and says how far a fit moves by itself.

All of it is done twice, with the filter on radiance as it is (``literal``) and on light without albedo
(``demodulated``), which is the question F13. A run that was interrupted goes on.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from experiments.frame_sets import SCENES, frame_set
from experiments.harness import run_script
from experiments.tune_sigmas import present
from fovden import metrics
from fovden.comparison.methods import file_name
from fovden.figures import draw_readings
from fovden.filters import NonHomogeneousAtrous
from fovden.frame import Frame, Reference
from fovden.results import Measurement, Run
from fovden.tuning import ImageError, fit, readable

__all__ = ["DEFAULT", "READINGS", "Settings", "main"]

DEFAULT = "default"
"""Name of the row in which nothing is changed."""

READINGS: Mapping[str, Mapping[str, Any]] = {
    "F1 mask_at=center": {"mask_at": "center"},
    "F4 guide=input": {"guide": "input"},
    "F5 unsampled_guide=literal": {"unsampled_guide": "literal"},
    "F5 unsampled_guide=nearest": {"unsampled_guide": "nearest"},
    "F6 F7 mask_update=fill": {"mask_update": "fill"},
    "F8 fill_holes=False": {"fill_holes": False},
    "F9 layers=snapshot": {"layers": "snapshot"},
    "F9 layers=interleaved": {"layers": "interleaved"},
    "F10 border=clamp": {"border": "clamp"},
    "F11 seam=True": {"seam": True},
    "F12 schedule=halve_phi": {"schedule": "halve_phi"},
    "F12 schedule=constant": {"schedule": "constant"},
    "F12 sigma_by=scale": {"sigma_by": "scale"},
}
"""The readings: the question's number, and the one option of the filter that is not the default's."""

LIGHTS = {"literal": False, "demodulated": True}

Pair = tuple[Frame, Reference]
Widths = tuple[float, float, float]


@dataclass(frozen=True)
class Settings:
    """What is compared, and on what.

    Attributes:
        scenes: Names of scenes; one whose file is not there is left out.
        resolution: Height and width of each eye's image.
        reference_spp: Samples per pixel of the references.
        steps: Steps of the default's fit to each scene, each on one of the training frames.
        more_steps: Steps of the fits that go on from there.
        evaluate_every: Steps between looks at the frame held out, which says which widths are kept.
        learning_rate: Of Adam, for the logarithms of the widths.
        start: Widths of radiance, normal and position at which the default's fit begins, for each kind of light.
        error: Terms of the error that the fits make small.
        threshold: Change of the error, relative, on the frames held out of any scene, that is worth a fit.
        references: Folder of the references; ``None`` for one beside the results.

    Example:
        >>> Settings().start["literal"]
        (32.0, 0.1, 0.02)
    """

    scenes: tuple[str, ...] = SCENES
    resolution: tuple[int, int] = (540, 480)
    reference_spp: int = 512
    steps: int = 48
    more_steps: int = 24
    evaluate_every: int = 8
    learning_rate: float = 0.15
    start: Mapping[str, Widths] = field(
        default_factory=lambda: {"literal": (32.0, 0.1, 0.02), "demodulated": (32.0, 0.025, 0.01)}
    )
    error: Mapping[str, float] = field(default_factory=lambda: {"l2": 5.0, "ssim": 0.05})
    threshold: float = 0.01
    references: str | None = None


class Study:
    """The frames of a study and the fits made on them, kept in a folder."""

    def __init__(self, settings: Settings, folder: Path) -> None:
        self.settings = settings
        self.folder = folder
        self.error = ImageError(settings.error)
        self.references = Path(settings.references) if settings.references else folder / "references"
        self.references.mkdir(parents=True, exist_ok=True)
        self.training = self.frames("train")
        self.held_out = self.frames("held_out")

    def frames(self, name: str) -> dict[str, list[Pair]]:
        """Traces a set of frames of each scene."""
        options = {"resolution": self.settings.resolution, "reference_spp": self.settings.reference_spp}
        found = {}
        for scene in self.settings.scenes:
            say(f"{scene}: frames of {name}")
            data = frame_set(scene, name, **options, folder=self.references)
            items = (data[index] for index in range(len(data)))
            found[scene] = [(frame, reference) for frame, reference in items if reference is not None]
        return found

    def denoiser(self, light: str, reading: str, widths: NonHomogeneousAtrous | None = None) -> NonHomogeneousAtrous:
        """Returns the filter of a reading, with the widths of another filter or those at the start."""
        names = ("sigma_radiance", "sigma_normal", "sigma_position")
        start = dict(zip(names, self.settings.start[light], strict=True))
        options = READINGS.get(reading, {})
        made = NonHomogeneousAtrous.nh3ld(**start, **options, demodulate=LIGHTS[light])
        if widths is not None:
            made.load_state_dict(widths.state_dict())
        return made

    def fitted(
        self, light: str, scene: str, reading: str, widths: NonHomogeneousAtrous | None = None
    ) -> NonHomogeneousAtrous:
        """Returns the filter of a reading, fitted to a scene, on from the widths of another filter if there is one."""
        name = f"{light}, {scene}, {reading}{'' if widths is None else ' on'}"
        say(f"fit {name}")
        denoiser = self.denoiser(light, reading, widths)
        fit(
            denoiser,
            self.training[scene],
            self.error,
            held_out=self.held_out[scene],
            steps=self.settings.steps if widths is None else self.settings.more_steps,
            learning_rate=self.settings.learning_rate,
            evaluate_every=self.settings.evaluate_every,
            seed=0 if widths is None else 1,
            folder=self.folder / "fits" / file_name(name),
            progress=None,
        )
        return denoiser

    def ratios(self, light: str, reading: str, defaults: Mapping[str, NonHomogeneousAtrous]) -> list[float]:
        """Returns the error on the frames held out of each scene, of a reading over the default, with its widths."""

        def error(denoiser: NonHomogeneousAtrous, scene: str) -> float:
            with torch.no_grad():
                return sum(
                    float(self.error(denoiser(frame).image, truth.mean, frame)) for frame, truth in self.held_out[scene]
                )

        ratios = [
            error(self.denoiser(light, reading, default), scene) / error(default, scene)
            for scene, default in defaults.items()
        ]
        say(f"{light}, {reading}, error by scene {', '.join(f'{ratio:.4f}' for ratio in ratios)} of the default's")
        return ratios

    def rows(self, light: str) -> dict[str, dict[str, NonHomogeneousAtrous]]:
        """Returns the filters of each scene by name: the light, the reading, and how its widths were found."""
        defaults = {scene: self.fitted(light, scene, DEFAULT) for scene in self.settings.scenes}
        rows = {
            scene: {
                f"{light}, {DEFAULT}, fitted": default,
                f"{light}, {DEFAULT}, fitted on": self.fitted(light, scene, DEFAULT, default),
            }
            for scene, default in defaults.items()
        }
        for reading in READINGS:
            is_fitted = any(abs(each - 1) >= self.settings.threshold for each in self.ratios(light, reading, defaults))
            for scene, default in defaults.items():
                rows[scene][f"{light}, {reading}, kept"] = self.denoiser(light, reading, default)
                if is_fitted:
                    rows[scene][f"{light}, {reading}, fitted"] = self.fitted(light, scene, reading, default)
        return rows


def judge(scene: str, pairs: Sequence[Pair], rows: Mapping[str, NonHomogeneousAtrous]) -> list[Measurement]:
    """Returns the errors of all filters on the frames of a scene, means over poses and eyes, seconds, and widths."""
    say(f"judge on {scene}")
    values: dict[tuple[str, str, str], list[float]] = {}
    for frame, truth in pairs:
        images = {}
        for row, denoiser in rows.items():
            began = time.perf_counter()
            with torch.no_grad():
                images[row] = denoiser(frame).image
            values.setdefault((row, "whole", "seconds"), []).append(time.perf_counter() - began)
        for score in metrics.compare(images, truth, layer=frame.layer).scores:
            if score.metric in ("rmse", "psnr", "ssim", "flip"):
                values.setdefault((score.method, score.region, score.metric), []).append(score.value)
    for row, denoiser in rows.items():
        if not row.endswith("kept"):
            values |= {(row, "whole", name): [value] for name, value in readable(denoiser).items()}
    return [
        Measurement(scene, 0, "", row, region, metric, float(f"{statistics.fmean(found):.6g}"))
        for (row, region, metric), found in values.items()
    ]


def say(line: str) -> None:
    """Says on standard error what is being done."""
    sys.stderr.write(line + "\n")


def run(settings: Settings, folder: Path) -> None:
    """Compares the readings with both kinds of light, on one thread, and draws the figure."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        kept = {name: value for name, value in asdict(settings).items() if name != "references"}
        with Run(folder, kept) as record:
            with record.stage("frames"):
                study = Study(settings, folder)
            rows: dict[str, dict[str, NonHomogeneousAtrous]] = {scene: {} for scene in settings.scenes}
            for light in LIGHTS:
                with record.stage(f"{light}: fit"):
                    for scene, found in study.rows(light).items():
                        rows[scene] |= found
            study.training.clear()
            with record.stage("judge"):
                for scene, pairs in study.frames("test").items():
                    record.measurements += judge(scene, pairs, rows[scene])
    finally:
        torch.set_num_threads(before)
    print(f"figure: {draw_readings(folder)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    presets: dict[str, Callable[[], Settings]] = {
        "smoke": lambda: Settings(("atrium", "forest"), (48, 48), 8, steps=2, more_steps=1, evaluate_every=2),
        "full": lambda: Settings(scenes=present(SCENES), references=os.environ.get("FOVDEN_REFERENCES")),
    }
    return run_script("paper_readings", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
