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
from fovden.figures import error_map
from fovden.filters import NonHomogeneousAtrous
from fovden.foveation import Gaze, ThreeLayer, sample_map
from fovden.tracer import accumulate_reference, make_scene, trace_frame, trace_gbuffer

small = "FOVDEN_SMALL" in os.environ

# %% [markdown]
# A scene has triangles, materials, lights and a camera. The camera is a pair of eyes; the resolution is that of one.

# %%
scene = make_scene("cornell_box" if small else "atrium")
camera = scene.camera.at(resolution=(64, 64) if small else (540, 480))
print(f"{scene.name}: {scene.triangle_count:,} triangles; eyes {camera.eye_separation * 1000:.0f} mm apart")

# %% [markdown]
# The G-buffer is what each eye sees, free of noise: the guides of the filter. Images are `(views, channels, height,
# width)`, the left eye first; here the left eye's albedo, normal and depth.

# %%
gbuffer = trace_gbuffer(scene, camera)
_, panels = plt.subplots(1, 3, figsize=(12, 4.5), layout="constrained")
guides = {
    "albedo": color.linear_to_srgb(gbuffer.albedo[0]),
    "normal": gbuffer.normal[0] / 2 + 0.5,
    "depth / largest": (gbuffer.depth[0] / gbuffer.depth[0].max()).expand(3, -1, -1),
}
for panel, (name, image) in zip(panels, guides.items(), strict=True):
    panel.imshow(image.permute(1, 2, 0))
    panel.set_title(name)
    panel.axis("off")

# %% [markdown]
# Foveation says how many samples a pixel gets: all pixels near the gaze, then ever fewer, then every other one.

# %%
gaze = Gaze.center(camera)
samples = sample_map(ThreeLayer(), camera, gaze=gaze, spp=4, seed=0)
pixels = 2 * camera.resolution[0] * camera.resolution[1]
print(f"radii {samples.radii} pixels; {samples.paths:,} paths, {4 * pixels / samples.paths:.2f} times fewer than all")

# %% [markdown]
# Two frames of the same scene, with the same seed: every pixel traced, and only the listed ones.

# %%
full = trace_frame(scene, camera, 4, seed=0)
foveated = trace_frame(scene, camera, samples, seed=0)

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
# Every metric, over the whole image and in each layer; the exposure is the reference's.

# %%
comparison = metrics.compare(images, reference, layer=foveated.layer)
print(comparison)

# %% [markdown]
# The left eye, and below it how far each image is from the reference, all on one scale.

# %%
_, panels = plt.subplots(2, len(images), figsize=(3.2 * len(images), 7.5), layout="constrained")
for (above, below), (name, image) in zip(panels.T, images.items(), strict=True):
    above.imshow(color.display(image[0], comparison.exposure).permute(1, 2, 0))
    above.set_title(name)
    errors = below.imshow(error_map(image, reference.mean, comparison.exposure)[0, 0], cmap="magma", vmin=0, vmax=0.3)
    above.axis("off")
    below.axis("off")
bar = plt.colorbar(errors, ax=panels, shrink=0.6, extend="max")
bar.set_label("RMS difference of display values")

# %% [markdown]
# The answer is yes: with fewer paths than the full noisy frame, the foveated one is closer to the reference once it is
# denoised, and more similar to it.

# %%
assert samples.paths < 4 * pixels / 1.5
assert comparison.value("NH3LD", "rmse") < comparison.value("noisy, full", "rmse")
assert comparison.value("NH3LD", "ssim") > comparison.value("noisy, full", "ssim")
