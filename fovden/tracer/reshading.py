"""Surface points shaded again, with exactly the random numbers of the frame that they come from."""

from __future__ import annotations

from fovden import parallel
from fovden.camera import Camera, StereoCamera
from fovden.rng import Stream
from fovden.tracer.gradient import attached, is_differentiable
from fovden.tracer.integrator import PAPERS, Integrator, require_light
from fovden.tracer.light_paths import Paths
from fovden.tracer.points import Shading, SurfacePoints
from fovden.tracer.scene import Scene
from fovden.tracer.shading import shaded

__all__ = ["record_paths", "reshade"]


def reshade(
    scene: Scene,
    points: SurfacePoints,
    *,
    integrator: Integrator = PAPERS,
    camera: Camera | StereoCamera | None = None,
    progress: parallel.Progress = None,
) -> Shading:
    """Returns the light of exactly the surface points that a frame saw, with exactly its random numbers.

    In the scene of that frame these are the frame's values, to the bit. In a scene whose lights, materials or vertices
    have changed since, the difference is due to that change, and not to noise: the temporal gradient of adaptive SVGF
    (Schied, Peters and Dachsbacher 2018, section 4.1).

    Args:
        scene: The scene now, with the triangles of then in the same order.
        points: The points, see :func:`fovden.tracer.surface_points`.
        integrator: How the frame's paths were made.
        camera: The views that look at the points now; ``None`` for the rays of the frame. Only surfaces that are not
            Lambertian look different from elsewhere.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        The light, one row a point. :meth:`SurfacePoints.image` makes images of it.

    Raises:
        ValueError: If the scene has no light, or lacks a triangle of the points.

    Differentiable: in the materials' albedo and emission along the same paths, as :func:`fovden.tracer.trace_frame` is.

    Example:
        >>> from fovden.tracer import make_scene, surface_points, trace_frame
        >>> scene = make_scene("cornell_box")
        >>> frame = trace_frame(scene, scene.camera.at((16, 16)), 2, seed=1)
        >>> points = surface_points(frame)
        >>> bool((points.image(reshade(scene, points).radiance) == frame.radiance).all())
        True
    """
    require_light(scene)
    setting = integrator.setting(points.seed, Stream.PATH)
    views = None if camera is None else camera.views
    asked = is_differentiable(scene.materials.albedo, scene.materials.emission)
    paths = shaded(scene, points, integrator.lights, setting, camera=views, taped=asked, progress=progress)
    if not asked:
        return paths.shading
    return Shading(*(attached(*pair) for pair in zip(paths.shading, paths.shade(), strict=True)))


def record_paths(
    scene: Scene,
    points: SurfacePoints,
    *,
    integrator: Integrator = PAPERS,
    camera: Camera | StereoCamera | None = None,
    progress: parallel.Progress = None,
) -> Paths:
    """Returns the paths of surface points on record, to be shaded with other albedos and lights, differentiably.

    Traced once, evaluated and differentiated as often as an optimisation needs. A record takes 64 bytes for each
    surface of a path; where an image has too many, take some of its points at a time.

    Args:
        scene: The scene.
        points: The points, see :func:`fovden.tracer.surface_points`.
        integrator: How paths are made.
        camera: See :func:`reshade`.
        progress: See :func:`fovden.parallel.run`.

    Returns:
        The record.

    Raises:
        ValueError: If the scene has no light, or lacks a triangle of the points.

    Example:
        How strong a lamp is, from a picture of what it lights:

        >>> import torch
        >>> from fovden.tracer import PointLight, make_scene, surface_points, trace_frame
        >>> dim, bright = (make_scene("cornell_box").with_lights([PointLight((2.8, 4, 2.8), i)]) for i in (5, 20))
        >>> points = surface_points(trace_frame(bright, bright.camera.at((8, 8)), 4))
        >>> picture, paths = reshade(bright, points).radiance, record_paths(dim, points)
        >>> lamp = torch.tensor(5.0, requires_grad=True)
        >>> optimiser = torch.optim.Adam([lamp], lr=1.0)
        >>> for _ in range(100):
        ...     error = (paths.shade(lights=[lamp]).radiance - picture).square().mean()
        ...     lamp.grad = torch.autograd.grad(error, lamp)[0]
        ...     _ = optimiser.step()
        >>> abs(lamp.item() - 20) < 0.1
        True
    """
    require_light(scene)
    setting = integrator.setting(points.seed, Stream.PATH)
    views = None if camera is None else camera.views
    return shaded(scene, points, integrator.lights, setting, camera=views, taped=True, progress=progress)
