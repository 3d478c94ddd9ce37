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
# # What do widths learned from one view gain on another?
#
# The edge-stopping widths of a foveated denoiser are learned by gradient from noisy frames of one view, and judged on a
# view that was not seen. Costs about two minutes on two cores; nothing is downloaded. With the environment variable
# `FOVDEN_SMALL` set it runs in seconds, on a smaller scene.

# %%
import os
import tempfile
from dataclasses import replace

import torch
from IPython.display import Image

from fovden import metrics
from fovden.figures import contact_sheet, draw_history
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import ThreeLayer
from fovden.tracer import FrameDataset, Sequence, make_scene
from fovden.tuning import ImageError, fit, load_parameters, readable

small = "FOVDEN_SMALL" in os.environ

# %% [markdown]
# Two views of a scene: one to learn from, and one from a step aside, turned, to be judged by.

# %%
scene = make_scene("cornell_box" if small else "atrium")
here = scene.view().at(resolution=(64, 64) if small else (360, 320))
(x, y, z), (tx, ty, tz) = here.eye, here.target
there = replace(here, eye=(x + 0.6, y + 0.1, z), target=(tx - 0.5, ty, tz))
scene

# %% [markdown]
# A `FrameDataset` traces frames with their references. The same view comes several times, with masks and noise of its
# own, so that the widths fit the scene and not the noise. A list traces each once and keeps it.

# %%
spp = 64 if small else 256
pairs = list(FrameDataset(Sequence(scene, here), ThreeLayer(), spp=4, seed=0, draws=5, reference_spp=spp))
train, held_out = pairs[:4], pairs[4:]
test, reference = FrameDataset(Sequence(scene, there), ThreeLayer(), spp=4, seed=1, reference_spp=spp)[0]
test

# %% [markdown]
# The denoiser is the three-layer one with the library's default widths, on light without albedo. Its parameters are the
# logarithms of the widths; `readable` shows the widths themselves.

# %%
denoiser = NonHomogeneousAtrous.nh3ld(demodulate=True)
before = readable(denoiser)
with torch.no_grad():
    images = {"noisy": test.radiance, "before": denoiser(test).image}
denoiser

# %% [markdown]
# What is made small decides what is gained. Here it is the absolute error that a display shows, with a fifth of what
# structural similarity lacks; any function of an image, its reference and the frame would do.

# %%
error = ImageError({"l1": 1.0, "ssim": 0.2})
[float(error(denoiser(frame).image.detach(), truth.mean, frame)) for frame, truth in train]

# %% [markdown]
# Adam takes one frame a step. The frame held out says which of the widths met on the way are kept. The folder keeps the
# course, and an interrupted fit goes on from it.

# %%
folder, steps = tempfile.mkdtemp(), 20 if small else 60
course = fit(denoiser, train, error, held_out=held_out, steps=steps, learning_rate=0.1, patience=3, folder=folder)
print(f"held-out error {course.history[0].held_out_loss:.4f} before, {course.best.held_out_loss:.4f} after")

# %% [markdown]
# The way that the widths took, by layer: 0 is the fovea's.

# %%
Image(draw_history(folder), width=900)

# %% [markdown]
# Before and after, in numbers. The parameters lie in the folder as safetensors, with a readable copy, and a denoiser
# made with the same options reads them.

# %%
for name, width in readable(denoiser).items():
    print(f"{name:34} {before[name]:8.3f} -> {width:8.3f}")
tuned = NonHomogeneousAtrous.nh3ld(demodulate=True)
load_parameters(tuned, f"{folder}/parameters.safetensors")

# %% [markdown]
# The view that was not seen: images, and every metric over the whole image and in each layer.

# %%
with torch.no_grad():
    images["after"] = tuned(test).image
comparison = metrics.compare(images, reference, layer=test.layer)
print(comparison)
contact_sheet({name: image[:1] for name, image in (images | {"Reference": reference.mean}).items()}, columns=2)

# %% [markdown]
# What the widths learned from one view gain on the other is no fit to its noise: neither its pose nor its random
# numbers were seen. `fovden tune` does the same from a shell, also with EXR files of another renderer, and
# `python -m experiments.tune_sigmas` measures how far widths carry over, on four scenes.

# %%
assert course.best.held_out_loss < course.history[0].held_out_loss
assert comparison.value("after", "rmse") < comparison.value("before", "rmse") < comparison.value("noisy", "rmse")
assert comparison.value("after", "ssim") > comparison.value("before", "ssim")
