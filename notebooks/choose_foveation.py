# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Where should the paths of a frame go?
#
# The same number of paths is placed in five ways: by three falloffs on the screen's pixels, and in two polar rasters.
# All are traced, denoised by the same filter and judged, and the gaze can be dragged. Costs about a minute on two
# cores; nothing is downloaded. With the environment variable `FOVDEN_SMALL` set it runs in seconds, on a smaller scene.

# %%
import os
import tempfile

import IPython.display
import ipywidgets
import torch
from ipywidgets import FloatSlider, VBox

from fovden import metrics
from fovden.figures import contact_sheet, draw_rasters, draw_sample_maps
from fovden.filters import NonHomogeneousAtrous, WarpedDenoiser
from fovden.foveation import (
    AcuityFalloff,
    Gaze,
    LinearFalloff,
    LogPolarWarp,
    ThreeLayer,
    VisualPolarWarp,
    sample_map,
    uniform_map,
    warp_at_budget,
)
from fovden.tracer import accumulate_reference, make_scene, trace_frame

small, folder = "FOVDEN_SMALL" in os.environ, tempfile.mkdtemp()

# %% [markdown]
# A scene, two eyes, and a gaze. Normalised coordinates are 0 in the centre, 1 at the right and the upper edge. Each eye
# may look elsewhere, also past its image.

# %%
scene = make_scene("cornell_box" if small else "atrium")
camera = scene.camera.at(resolution=(64, 64) if small else (405, 360))
gaze = Gaze.from_normalised(torch.tensor([[0.35, -0.2], [0.35, -0.2]]), camera.resolution)
scene

# %% [markdown]
# The budget is 0.4 paths for each pixel of the screen. A falloff on the screen spends it by leaving out pixels. A polar
# raster has as many cells as there are paths, small ones near the gaze and large ones far from it, so that each cell
# gets one; its size follows from the budget and the gaze.

# %%
budget, spread = 0.4, {"spp": 1, "mean_spp": 0.4, "source": "blue_noise"}
ways = {
    "Three layers": lambda at: sample_map(ThreeLayer(), camera, at, **spread),
    "Linear": lambda at: sample_map(LinearFalloff(), camera, at, **spread),
    "Acuity": lambda at: sample_map(AcuityFalloff(), camera, at, **spread),
    "Log-polar": lambda at: uniform_map(
        camera, budget, warp=warp_at_budget(LogPolarWarp.for_camera(camera, at), budget)
    ),
    "Visual-polar": lambda at: uniform_map(
        camera, budget, warp=warp_at_budget(VisualPolarWarp.for_camera(camera, at), budget)
    ),
}
maps = {name: way(gaze) for name, way in ways.items()}
{name: samples.paths for name, samples in maps.items()}

# %% [markdown]
# Where they go. A falloff cannot have more than one path in a pixel here; a raster can. The dashed line is what the
# eye's acuity would ask for.

# %%
IPython.display.Image(draw_sample_maps(maps, f"{folder}/densities.png", camera=camera), width=900)

# %% [markdown]
# The rasters, drawn with a hundredth of their cells: on the whole screen, and around the gaze.

# %%
rasters = {name: samples.warp for name, samples in maps.items() if samples.warp}
coarse = {name: warp_at_budget(warp, budget / (10 if small else 100)) for name, warp in rasters.items()}
IPython.display.Image(draw_rasters(coarse, f"{folder}/rasters.png"), width=700)

# %% [markdown]
# Tracing takes the map, whichever raster it is in. Cells are traced along their own rays: nothing is resampled.

# %%
frames = {name: trace_frame(scene, camera, samples, seed=1) for name, samples in maps.items()}
frames["Visual-polar"]

# %% [markdown]
# One filter for all: five à-trous passes on light without albedo, with widths for one path. It works in the raster that
# a frame was traced in; `WarpedDenoiser` adds the way to the screen, and a blur that grows from the gaze outwards.

# %%
inner = NonHomogeneousAtrous.base(demodulate=True, sigma_radiance=32.0, sigma_normal=0.1, sigma_position=0.1)
denoisers = {name: WarpedDenoiser(inner, rasters[name]) if name in rasters else inner for name in ways}
with torch.no_grad():
    images = {name: denoisers[name](frame).image for name, frame in frames.items()}
reference = accumulate_reference(scene, camera, spp=64 if small else 256)
contact_sheet({name: image[:1] for name, image in (images | {"Reference": reference.mean}).items()}, columns=3)

# %% [markdown]
# Judged with all pixels alike, within the circles of three layers, and weighted by acuity. A raster spends its paths
# where the gaze is, and the rim pays twice: a coarse cell has one albedo and one normal for all the pixels that it
# covers, where a pixel of the screen has its own, whether it has a path or not.

# %%
layer, weights = ThreeLayer()(camera.views, gaze).layer, {"acuity": metrics.acuity_weight(camera, gaze)}
comparison = metrics.compare(images, reference, layer, weights=weights)
print(comparison)

# %% [markdown]
# Drag the gaze: two ways are laid out, traced and filtered anew wherever it goes, in a fraction of a second.

# %%
x, y = (FloatSlider(0.0, min=-1.0, max=1.0, step=0.05, description=f"gaze {name}") for name in "xy")
picture = ipywidgets.Image(format="png", width=800)
for slider in (x, y):
    slider.continuous_update = False
    slider.observe(
        lambda _: picture.set_trait(
            "value",
            contact_sheet(
                {
                    name: denoisers[name](trace_frame(scene, camera, ways[name](at))).image[:1].detach()
                    for at in [Gaze.from_normalised(torch.tensor([[x.value, y.value]] * 2), camera.resolution)]
                    for name in ("Three layers", "Visual-polar")
                }
            ).png(),
        ),
        "value",
    )
x.value = 0.35
before = picture.value
y.value = -0.2
VBox([x, y, picture])

# %% [markdown]
# All ways trace the same number of paths, and of the two rasters the one that follows acuity is the better. `python -m
# experiments.compare_foveation` fits widths to each way's own frames and judges nine of them on three scenes.

# %%
assert all(abs(samples.paths - budget * 2 * layer[0].numel()) < 0.01 * samples.paths for samples in maps.values())
assert comparison.value("Visual-polar", "rmse", "acuity") < comparison.value("Log-polar", "rmse", "acuity")
assert comparison.value("Visual-polar", "rmse") < comparison.value("Log-polar", "rmse")
assert before != picture.value  # what a drag draws
