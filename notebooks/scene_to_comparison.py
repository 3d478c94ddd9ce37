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
# # Does a foveated frame, denoised, beat the full noisy one?
#
# From scene to comparison in ten cells: a scene is traced for two eyes, fully and foveated, denoised, and compared with
# a reference. Costs about a minute on two cores; nothing is downloaded. With the environment variable `FOVDEN_SMALL`
# set it runs in seconds, on a smaller scene.

# %%
import os

import torch
from matplotlib import pyplot as plt

from fovden import color, metrics
from fovden.figures import contact_sheet
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import Gaze, ThreeLayer, sample_map
from fovden.tracer import accumulate_reference, make_scene, trace_frame, trace_gbuffer

small = "FOVDEN_SMALL" in os.environ

# %% [markdown]
# A scene has triangles, materials, lights and a camera. The camera is a pair of eyes; the resolution is that of one.
# Scenes, G-buffers, sample maps and frames show themselves.

# %%
scene = make_scene("cornell_box" if small else "atrium")
camera = scene.camera.at(resolution=(64, 64) if small else (540, 480))
scene

# %% [markdown]
# The G-buffer is what each eye sees, free of noise: the guides of the filter. Images are `(views, channels, height,
# width)`, the left eye first.

# %%
trace_gbuffer(scene, camera)

# %% [markdown]
# Foveation says how many samples a pixel gets: all pixels near the gaze, then ever fewer, then every other one.

# %%
gaze = Gaze.center(camera)
samples = sample_map(ThreeLayer(), camera, gaze=gaze, spp=4, seed=0)
pixels = 2 * camera.resolution[0] * camera.resolution[1]
print(f"radii {samples.radii} pixels; {samples.paths:,} paths, {4 * pixels / samples.paths:.2f} times fewer than all")
samples

# %% [markdown]
# Two frames of the same scene, with the same seed: every pixel traced, and only the listed ones.

# %%
full = trace_frame(scene, camera, 4, seed=0)
foveated = trace_frame(scene, camera, samples, seed=0)
foveated

# %% [markdown]
# Denoisers are plain modules that fold a frame into an image. Base filters every pixel alike; NH3LD uses 3, 4 and 5
# passes in the three layers, and fills the pixels that were not traced. Without the albedo (`demodulate`) textures stay
# sharp.

# %%
with torch.no_grad():
    images = {
        "noisy, full": full.radiance,
        "noisy, foveated": foveated.radiance,
        "Base": NonHomogeneousAtrous.base(demodulate=True)(full).image,
        "NH3LD": NonHomogeneousAtrous.nh3ld(demodulate=True)(foveated).image,
    }

# %% [markdown]
# The reference is the mean of many samples, and knows how well it is known.

# %%
reference = accumulate_reference(scene, camera, spp=64 if small else 256, seed=0, progress=False)
print(f"{reference.count} samples per pixel, standard error {reference.standard_error.mean():.4f} on average")

# %% [markdown]
# Every metric, over the whole image and in each layer, and the images of the left eye; the exposure is the reference's.

# %%
comparison = metrics.compare(images, reference, layer=foveated.layer)
print(comparison)
contact_sheet({name: image[:1] for name, image in (images | {"Reference": reference.mean}).items()}, columns=3)

# %% [markdown]
# And where each differs from the reference, as FLIP sees it: how much a viewer notices when the two alternate.

# %%
shown = color.display(reference.mean, comparison.exposure)
_, panels = plt.subplots(1, len(images), figsize=(3.2 * len(images), 4), layout="constrained")
for panel, (name, image) in zip(panels, images.items(), strict=True):
    flip = metrics.flip_map(color.display(image, comparison.exposure), shown)
    errors = panel.imshow(flip[0, 0], cmap="magma", vmin=0, vmax=1)
    panel.set_title(f"{name}: {comparison.value(name, 'flip'):.3f}")
    panel.axis("off")
bar = plt.colorbar(errors, ax=panels, shrink=0.8)
bar.set_label("FLIP")

# %% [markdown]
# The answer is yes: with fewer paths than the full noisy frame, the foveated one is closer to the reference once it is
# denoised, and more similar to it. `fovden.report.write_report("report.html", images, reference)` makes a page of all
# this, in which to flip between the images, zoom, and read pixels.

# %%
assert samples.paths < 4 * pixels / 1.5
assert comparison.value("NH3LD", "rmse") < comparison.value("noisy, full", "rmse")
assert comparison.value("NH3LD", "ssim") > comparison.value("noisy, full", "ssim")
