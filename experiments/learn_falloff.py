"""Which falloff is the best one for a given number of paths, and can it be learned by gradient?

    python -m experiments.learn_falloff --preset smoke

For each scene the radii of three layers are learned under the paper's budget on frames of some poses, and judged on a
pose and on seeds that were not seen. The loss is SMAPE weighted by acuity: a pixel at e degrees from the gaze counts
1 / (1 + e / 2.3)^2, which is how the density of what can be resolved falls (half of the resolution at e2 = 2.3 degrees:
W. Geisler, J. Perry, "A real-time foveated multiresolution system for low-bandwidth video communication", SPIE 3299,
1998). Learned by differences, circles take the layers of the denoiser along; by relaxed masks they leave them where the
paper has them, since no mask sees a layer. A coarse grid over both radii is the check that the optimum is one.

Before that, the gradients themselves are compared on the Cornell box: relaxed masks against differences of drawn ones.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn

from experiments.compare_denoisers import sponza
from experiments.harness import run_script
from fovden import metrics
from fovden.camera import Camera, Gaze, StereoCamera
from fovden.figures import draw_falloff
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import (
    Falloff,
    LearnedProfile,
    LearnedThreeLayer,
    RateMap,
    ThreeLayer,
    add_differences,
    eccentricity_degrees,
    mask_numbers,
    relaxed_mask,
    thinned,
)
from fovden.frame import Frame
from fovden.results import Measurement, Run
from fovden.tracer import Scene, accumulate_reference, load_scene, make_scene, trace_frame

__all__ = ["Settings", "main"]

SPONZA_POSES = (
    ((-11.5, 2.2, -0.4), (0, 3.4, 0)),
    ((9.0, 2.2, 0.6), (0, 3.0, -0.8)),
    ((3.0, 6.5, 3.2), (-6.0, 4.0, -2.0)),
)
"""Eye and target, metres: along the nave as in the comparison, back along it, and down from a gallery."""


@dataclass(frozen=True)
class Settings:
    """What is learned, and from what.

    Attributes:
        scenes: Names of scenes made in code with three views, or ``"sponza"``, which is left out where its file is not.
        resolution: Height and width of each view.
        spp: Samples per pixel of a frame.
        reference_spp: Samples per pixel of the references.
        frames: Frames with seeds of their own for each pose.
        steps: Steps by differences; three times as many by relaxed masks, each of which costs a third.
        step: Width of the differences.
        rate: Learning rate of Adam at the start; it falls to a tenth.
        temperature: Temperature of relaxed masks.
        grid: Radii of the grid in units of the paper's r0.
        masks: Masks for each frame when falloffs are judged; half as many in the grid.
        gradient_masks: Masks for the comparison of gradients, 0 to leave it out.

    Example:
        >>> Settings().temperature
        0.1
    """

    scenes: tuple[str, ...] = ("atrium", "sponza")
    resolution: tuple[int, int] = (270, 240)
    spp: int = 4
    reference_spp: int = 256
    frames: int = 4
    steps: int = 50
    step: float = 0.2
    rate: float = 0.15
    temperature: float = 0.1
    grid: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0, 2.0)
    masks: int = 4
    gradient_masks: int = 24


class Pose(NamedTuple):
    """What is seen from one place: frames that were traced everywhere, what they should be, and the pixels' worth."""

    frames: list[Frame]
    reference: Tensor
    weight: Tensor
    views: Camera
    gaze: Gaze

    def loss(self, denoiser: nn.Module, falloff: Falloff, seed: int, temperature: float | None = None) -> Tensor:
        """Returns the loss of one frame and mask, with a drawn mask or a relaxed one; the mean over the eyes."""
        rate, layer, _, _ = falloff(self.views, self.gaze)
        numbers = mask_numbers(self.views.resolution, seed, views=self.views.view_count)
        mask = (numbers < rate).to(rate.dtype)
        if temperature is not None:
            mask = relaxed_mask(rate, numbers, temperature, straight_through=False)
        image = denoiser(thinned(self.frames[seed % len(self.frames)], mask, layer)).image
        # SMAPE of Vogels et al. 2018, with the epsilon of fovden.metrics, for every pixel.
        error = ((image - self.reference).abs() / (image.abs() + self.reference.abs() + 0.01)).mean(1, keepdim=True)
        return (self.weight * error).sum() / self.weight.sum()


def pose_of(scene: Scene, camera: StereoCamera, settings: Settings, first_seed: int) -> Pose:
    """Traces a pose. Emission is left out on both sides: it has no noise, and filling it costs more than the rest."""
    views = camera.views
    reference = accumulate_reference(scene, camera, spp=settings.reference_spp, progress=None)
    frames = [trace_frame(scene, camera, settings.spp, seed=first_seed + n) for n in range(settings.frames)]
    shown = reference.mean - frames[0].emission
    frames = [replace(frame, emission=torch.zeros_like(frame.emission)) for frame in frames]
    gaze = Gaze.center(views)
    weight = metrics.acuity_weight(views, gaze)
    return Pose(frames, shown.clamp(min=0), weight, views, gaze)


def poses_of(name: str, settings: Settings) -> list[Pose] | None:
    """Returns the poses of a scene, the last of which is for the test; nothing where its file is missing."""
    if name == "sponza":
        view = sponza().view
        if not Path(view.scene).is_file():
            print(f"{view.scene} is not there; set FOVDEN_SCENES")
            return None
        scene = load_scene(view.scene, lights=view.lights)
        assert view.fov_x_deg is not None
        cameras = [StereoCamera(eye, target, fov_x_deg=view.fov_x_deg) for eye, target in SPONZA_POSES]
    else:
        scene = make_scene(name)
        assert scene.camera is not None
        cameras = [scene.camera, *scene.views.values()]
        if len(cameras) == 1:  # a second place a step aside
            x, y, z = scene.camera.eye
            cameras.append(replace(scene.camera, eye=(x + 0.5, y, z)))
    cameras = [camera.at(resolution=settings.resolution) for camera in cameras]
    return [pose_of(scene, camera, settings, 100 * number) for number, camera in enumerate(cameras)]


def uniform_falloff(rate: float) -> Falloff:
    """Returns the falloff that has one rate everywhere, and the paper's layers."""

    def falloff(camera: Camera, gaze: Gaze) -> RateMap:
        found = ThreeLayer()(camera, gaze)
        return found._replace(rate=torch.full_like(found.rate, rate))

    return falloff


def learn(
    falloff: LearnedThreeLayer | LearnedProfile,
    poses: Sequence[Pose],
    denoiser: nn.Module,
    settings: Settings,
    *,
    relaxed: bool,
    tell: Callable[[int], None],
) -> None:
    """Learns by Adam, one frame and mask a step; the falloff ends with the mean of the last third of the steps."""
    steps = settings.steps * (3 if relaxed else 1)
    parameters = list(falloff.parameters())
    optimiser = torch.optim.Adam(parameters, settings.rate)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.1, steps)
    kept: list[list[Tensor]] = []
    tell(0)
    for number in range(steps):
        pose, seed = poses[number % len(poses)], 1000 + number // len(poses)
        optimiser.zero_grad()
        if relaxed:
            pose.loss(denoiser, falloff, seed, settings.temperature).backward()  # type: ignore[no-untyped-call]
        else:
            add_differences(parameters, lambda p=pose, s=seed: p.loss(denoiser, falloff, s), settings.step)
        optimiser.step()
        schedule.step()
        tell(number + 1)
        if 3 * number >= 2 * steps:
            kept.append([each.detach().clone() for each in parameters])
    with torch.no_grad():
        for number, each in enumerate(parameters):
            each.copy_(torch.stack([values[number] for values in kept]).mean(0))
    tell(steps + 1)


def measure(record: Run, settings: Settings, name: str, poses: Sequence[Pose]) -> None:
    """Learns, judges, and fills the grid, for one scene."""
    denoiser = NonHomogeneousAtrous.nh3ld(demodulate=True).requires_grad_(False)
    train, test = list(poses[:-1]), poses[-1]
    paper = ThreeLayer()
    budget = float(paper(test.views, test.gaze).rate.mean(dtype=torch.float64))

    def add(method: str, region: str, metric: str, value: float, frame: int = 0) -> None:
        record.measurements.append(Measurement(name, frame, "", method, region, metric, value))

    def judged(falloff: Falloff, where: Sequence[Pose], masks: int) -> Tensor:
        seeds = range(masks * settings.frames)
        with torch.no_grad():
            return torch.stack([torch.stack([pose.loss(denoiser, falloff, s) for s in seeds]) for pose in where])

    falloffs: dict[str, Falloff] = {"paper": paper, "uniform": uniform_falloff(budget)}
    learners: dict[str, tuple[LearnedThreeLayer | LearnedProfile, bool]] = {
        "differences": (LearnedThreeLayer(budget=budget), False),
        "differences, layers kept": (LearnedThreeLayer(budget=budget, layers=paper), False),
        "relaxed, layers kept": (LearnedThreeLayer(budget=budget, layers=paper), True),
        "profile, layers kept": (LearnedProfile(budget=budget, layers=paper), True),
    }
    for method, (falloff, relaxed) in learners.items():

        def tell(step: int, method: str = method, falloff: nn.Module = falloff) -> None:
            if isinstance(falloff, LearnedThreeLayer):
                add(method, "path", "r0", float(falloff.log_r0.detach().exp()), step)
                add(method, "path", "width", float(falloff.log_width.detach().exp()), step)

        with record.stage(f"{name}: {method}"):
            learn(falloff, train, denoiser, settings, relaxed=relaxed, tell=tell)
        falloffs[method] = falloff
    add("", "whole", "budget", budget)
    baseline = {region: judged(paper, where, settings.masks) for region, where in (("train", train), ("test", [test]))}
    for method, each in falloffs.items():
        rate = each(test.views, test.gaze).rate.detach()
        add(method, "whole", "mean_rate", float(rate.mean(dtype=torch.float64)))
        for region, where in (("train", train), ("test", [test])):
            losses = judged(each, where, settings.masks)
            # The same frames and masks: what differs is the falloff alone.
            ratio = losses.mean(1) / baseline[region].mean(1)
            spread = (losses / baseline[region]).std(1) / math.sqrt(losses.shape[1])
            for metric, value in (
                ("loss", losses.mean()), ("ratio", ratio.mean()), ("ratio_error", spread.square().mean().sqrt())
            ):  # fmt: skip
                add(method, region, metric, float(value))
            print(f"{name:10} {method:26} {region:6} loss {losses.mean():.5f}  {ratio.mean():.4f} of the paper's")
        row = test.views.resolution[0] // 2, slice(test.views.resolution[1] // 2, None)
        degrees = eccentricity_degrees(test.gaze, test.views)[0, 0][row]
        for degree, value in zip(degrees.tolist(), rate[0, 0][row].tolist(), strict=True):
            add(method, f"{degree:.4f} deg", "rate", value)
        if isinstance(each, LearnedThreeLayer):
            r0, r1, p = (value.item() for value in each.values(test.views, test.gaze))
            unit = math.sqrt(math.prod(test.views.resolution) / 50)
            for metric, value in (("r0", r0 / unit), ("r1", r1 / unit), ("p", p)):
                add(method, "whole", metric, value)
            print(f"{name:10} {method:26} r0 {r0 / unit:.3f}  r1 {r1 / unit:.3f}  p {p:.3f}")
    with record.stage(f"{name}: grid"):
        for method, layers in (("grid", None), ("grid, layers kept", paper)):
            for r0 in settings.grid:
                for width in settings.grid:
                    losses = judged(
                        LearnedThreeLayer(r0, width, budget=budget, layers=layers), train, -(-settings.masks // 2)
                    )
                    add(method, f"{r0:g} {width:g}", "loss", float(losses.mean()))


def compare_gradients(record: Run, settings: Settings) -> None:
    """Gradients by relaxed masks and by differences, means and standard errors over masks, on the Cornell box."""
    scene = make_scene("cornell_box")
    assert scene.camera is not None
    camera = scene.camera.at(resolution=(64, 64))
    parts = [pose_of(scene, camera, replace(settings, reference_spp=1024, frames=1), seed) for seed in range(16)]
    frame = Frame.stack([part.frames[0] for part in parts])
    assert frame.camera is not None
    views = frame.camera
    pose = Pose([frame], *(torch.cat([part[k] for part in parts]) for k in (1, 2)), views, Gaze.center(views))
    for demodulate in (False, True):
        denoiser = NonHomogeneousAtrous.nh3ld(demodulate=demodulate).requires_grad_(False)
        for layers in (ThreeLayer(), None):
            falloff = LearnedThreeLayer(layers=layers)
            names, parameters = zip(*falloff.named_parameters(), strict=True)
            found: dict[str, list[Tensor]] = {}
            for seed in range(settings.gradient_masks):
                for temperature in (None, 0.5, 0.2, 0.1, 0.05) if layers is not None else (None,):
                    falloff.zero_grad()
                    if temperature is None:
                        add_differences(parameters, lambda d=denoiser, f=falloff, s=seed: pose.loss(d, f, s))
                    else:
                        pose.loss(denoiser, falloff, seed, temperature).backward()  # type: ignore[no-untyped-call]
                    label = "differences" if temperature is None else f"relaxed {temperature:g}"
                    label += ", layers move" if layers is None else ""
                    gradients = [each.grad for each in parameters if each.grad is not None]
                    found.setdefault(label, []).append(torch.stack(gradients).double())
            region = "demodulated" if demodulate else "radiance"
            for label, values in found.items():
                gradient = torch.stack(values)
                error = gradient.std(0) / math.sqrt(len(values))
                for number, each in enumerate(names):
                    for metric, value in ((each, gradient.mean(0)[number]), (f"{each}_error", error[number])):
                        record.measurements.append(
                            Measurement("cornell_box", 0, "", label, region, metric, float(value))
                        )
                    print(f"{region:12} {label:28} {each:10} {gradient.mean(0)[number]:.3e} +- {error[number]:.1e}")


def run(settings: Settings, folder: Path) -> None:
    """Learns on all scenes on one thread and draws the figure."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with Run(folder, settings) as record:
            if settings.gradient_masks:
                with record.stage("gradients"):
                    compare_gradients(record, settings)
            for name in settings.scenes:
                with record.stage(f"{name}: trace"):
                    poses = poses_of(name, settings)
                if poses is not None:
                    measure(record, settings, name, poses)
    finally:
        torch.set_num_threads(before)
    print(f"figure: {draw_falloff(folder)}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the script and returns the exit status."""
    small = Settings(("cornell_box",), (32, 32), 2, 16, 2, 3, grid=(0.5, 1.0), masks=2, gradient_masks=0)
    presets: dict[str, Callable[[], Settings]] = {"smoke": lambda: small, "full": Settings}
    return run_script("learn_falloff", str(__doc__), presets, run, arguments)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
