"""What rays find, as differentiable tensor operations on the numbers of the triangles that they hit.

Which triangle a ray hits is a choice and has no derivative. Where it hits, and what the surface is like there, are
formulas in vertices, rays, camera and materials. The functions here are these formulas: pure, of any floating type, on
any device. ``attached`` joins them to what the kernels computed: the kernel's number, to the bit, with the
formula's derivative. So nothing but the derivative changes when an input asks for one.

What moves when the edge of a surface moves, a shadow's border or a silhouette, is not in these derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.autograd import forward_ad

from fovden.camera import Camera, pixel_centres
from fovden.color import srgb_to_linear

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene
    from fovden.warps import Warp

__all__ = [
    "albedo_at",
    "attached",
    "corners_at",
    "emission_at",
    "hits_at",
    "interpolated",
    "is_differentiable",
    "normal_at",
    "rows_at",
    "seen_at",
    "texture_colour",
]


def is_differentiable(*tensors: Tensor | None) -> bool:
    """Returns whether a derivative is being asked for, backwards or forwards, with respect to any of the tensors.

    Example:
        >>> is_differentiable(torch.ones(2)), is_differentiable(None, torch.ones(2, requires_grad=True))
        (False, True)
    """
    given = [tensor for tensor in tensors if tensor is not None]
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in given):
        return True
    if torch.compiler.is_compiling():  # which knows no forward mode
        return False
    return any(forward_ad.unpack_dual(tensor).tangent is not None for tensor in given)  # type: ignore[no-untyped-call]


def attached(value: Tensor, formula: Tensor) -> Tensor:
    """Returns the value, to the bit, with the derivative of a formula that equals it but for rounding.

    Args:
        value: What a kernel computed; may be infinite.
        formula: The same as a function of what is to be differentiated, finite, of the same shape.

    Returns:
        ``value - (formula.detach() - formula)``, in the type and on the device of ``value``.

    Differentiable: in ``formula``.

    Example:
        >>> x = torch.tensor(3.0, requires_grad=True)
        >>> y = attached(torch.tensor(9.5), x**2)
        >>> y.backward()
        >>> y.item(), x.grad.item()
        (9.5, 6.0)
    """
    return value - (formula.detach() - formula).to(value)  # in this order, for -0 - 0 is -0


def corners_at(vertices: Tensor, faces: Tensor, prim: Tensor) -> Tensor:
    """Returns the corners of triangles.

    Args:
        vertices: Positions, shape (n, 3).
        faces: Vertex numbers, shape (m, 3).
        prim: Triangle numbers, any shape; -1 is a miss.

    Returns:
        Corners, shape (..., 3, 3): corner, axis. For a miss, those of a triangle of the unit cube, so that formulas
        stay finite there.

    Differentiable: in ``vertices``.

    Example:
        >>> corners_at(torch.eye(3), torch.tensor([[2, 1, 0]]), torch.tensor([0]))[0, 0]
        tensor([0., 0., 1.])
    """
    corners = rows_at(vertices, faces, prim)
    return torch.where((prim >= 0)[..., None, None], corners, torch.eye(3).to(corners))


def rows_at(table: Tensor, faces: Tensor, prim: Tensor) -> Tensor:
    """Returns the rows of a table of vertices that belong to the corners of triangles.

    Args:
        table: One row a vertex, shape (n, c).
        faces: Vertex numbers, shape (m, 3).
        prim: Triangle numbers, any shape; a negative one gets the rows of triangle 0.

    Returns:
        Rows of shape (..., 3, c).

    Differentiable: in ``table``.

    Example:
        >>> rows_at(torch.tensor([[5.0], [6.0], [7.0]]), torch.tensor([[2, 1, 0]]), torch.tensor([0]))[0, :, 0]
        tensor([7., 6., 5.])
    """
    chosen = faces[prim.long().clamp_min(0)].long()
    return table.index_select(0, chosen.flatten()).reshape(*chosen.shape, table.shape[1])


def hits_at(corners: Tensor, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Returns where lines meet the planes of triangles: o + t d = (1 - u - v) a + u b + v c.

    Args:
        corners: Corners a, b, c, shape (..., 3, 3).
        origins: Points o, shape (..., 3).
        directions: Directions d, shape (..., 3).

    Returns:
        t, u and v, of shape (...). A line within its triangle's plane meets it nowhere; it gets zeros, without
        derivative.

    Differentiable: in everything, twice. Source: the system's solution by Cramer's rule as Möller and Trumbore, "Fast,
    minimum storage ray/triangle intersection" (JGT 2(1), 1997), arrange it.

    Example:
        >>> t, u, v = hits_at(torch.eye(3), torch.zeros(3), torch.tensor([1.0, 1.0, 2.0]))
        >>> t, u, v
        (tensor(0.2500), tensor(0.2500), tensor(0.5000))
    """
    first, second = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    across = torch.linalg.cross(directions, second)
    determinant = _dot(first, across)
    meets = determinant.detach().abs() > torch.finfo(determinant.dtype).tiny
    scale = torch.where(meets, 1 / torch.where(meets, determinant, 1), 0)
    start = origins - corners[..., 0, :]
    beside = torch.linalg.cross(start, first)
    return _dot(second, beside) * scale, _dot(start, across) * scale, _dot(directions, beside) * scale


def interpolated(corners: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Returns (1 - u - v) a + u b + v c for values a, b, c at triangles' corners.

    Args:
        corners: The values, shape (..., 3, c).
        u: Weight of the second corner, shape (...).
        v: Weight of the third, shape (...).

    Returns:
        Values of shape (..., c).

    Differentiable: in everything.

    Example:
        >>> interpolated(torch.eye(3), torch.tensor(0.25), torch.tensor(0.5))
        tensor([0.2500, 0.2500, 0.5000])
    """
    a, b, c = corners.unbind(-2)
    return (1 - u - v)[..., None] * a + u[..., None] * b + v[..., None] * c


def normal_at(corners: Tensor, normals: Tensor, directions: Tensor, u: Tensor, v: Tensor) -> Tensor:
    """Returns unit shading normals on the side that rays come from.

    Args:
        corners: Corners of the triangles, shape (..., 3, 3).
        normals: Normals at the corners, zero where there is none, shape (..., 3, 3).
        directions: Directions of the rays, shape (..., 3).
        u: Weight of the second corner, shape (...).
        v: Weight of the third, shape (...).

    Returns:
        Normals of shape (..., 3): interpolated; those of the triangles where the interpolated ones vanish or lie in
        the triangle's plane.

    Differentiable: in everything but ``directions``, which only choose the side.

    Example:
        >>> flat = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> normal_at(flat, torch.zeros(3, 3), torch.tensor([0.0, 0, 1]), torch.tensor(0.2), torch.tensor(0.2))
        tensor([-0., -0., -1.])
    """
    geometric = torch.linalg.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    shading = interpolated(normals, u, v)
    outward = torch.where(_dot(geometric, directions) > 0, -1, 1)[..., None]
    side = (_dot(shading, geometric)[..., None] * outward).detach()
    chosen = torch.where(side == 0, geometric * outward, torch.where(side < 0, -shading, shading))
    chosen = chosen / chosen.detach().abs().amax(-1, keepdim=True)  # so that no square under- or overflows
    return torch.nn.functional.normalize(chosen, dim=-1)


def texture_colour(image: Tensor, uv: Tensor) -> Tensor:
    """Returns the linear colour of a repeating image, bilinear between decoded texels.

    Args:
        image: Texels, shape (h, w, 3), top row first: uint8 with the sRGB curve, or linear of the type of ``uv``.
        uv: Texture coordinates, shape (n, 2); (0, 0) is the image's lower left corner.

    Returns:
        Colours of shape (n, 3), in the type of ``uv``.

    Differentiable: in ``uv``, piecewise: the derivative jumps where the four texels change; and in a linear ``image``.

    Example:
        >>> image = torch.tensor([[[0, 0, 0], [255, 255, 255]]], dtype=torch.uint8)
        >>> texture_colour(image, torch.tensor([[0.5, 0.5], [0.75, 0.5]]))[:, 0]
        tensor([0.5000, 1.0000])
    """
    height, width = image.shape[:2]
    within = uv - uv.detach().floor()
    x, y = within[:, 0] * width - 0.5, (1 - within[:, 1]) * height - 0.5
    left, upper = x.detach().floor(), y.detach().floor()
    fx, fy = x - left, y - upper
    colour = torch.zeros_like(uv[:, :1])
    for dy in range(2):
        for dx in range(2):
            texel = image[(upper.long() + dy) % height, (left.long() + dx) % width]
            weight = (fx if dx else 1 - fx) * (fy if dy else 1 - fy)
            linear = texel if image.is_floating_point() else srgb_to_linear(texel.to(uv) / 255)
            colour = colour + weight[:, None] * linear
    return colour


def albedo_at(factor: Tensor, textures: Sequence[Tensor], texture: Tensor, uv: Tensor) -> Tensor:
    """Returns reflectances: factors times textures.

    Args:
        factor: Reflectance of each point's material, or the factor of its texture, shape (n, 3).
        textures: Images as in :func:`texture_colour`.
        texture: Which of them each point has, -1 for none, shape (n).
        uv: Texture coordinates, shape (n, 2).

    Returns:
        Reflectances of shape (n, 3).

    Differentiable: in ``factor``, ``uv`` and linear images.

    Example:
        >>> white = torch.full((1, 1, 3), 255, dtype=torch.uint8)
        >>> albedo_at(torch.full((2, 3), 0.5), [white], torch.tensor([-1, 0]), torch.zeros(2, 2))[:, 0]
        tensor([0.5000, 0.5000])
    """
    albedo = factor
    for number, image in enumerate(textures):
        chosen = texture == number
        if torch.compiler.is_compiling():  # a graph's shapes do not depend on what a ray finds
            colour = texture_colour(image.to(uv.device), uv)
            albedo = torch.where(chosen[:, None], factor * colour, albedo)
            continue
        rows = chosen.nonzero()[:, 0]
        if len(rows) > 0:
            coloured = factor[rows] * texture_colour(image.to(uv.device), uv[rows])
            albedo = albedo.index_copy(0, rows, coloured)
    return albedo


def emission_at(corners: Tensor, emission: Tensor, directions: Tensor) -> Tensor:
    """Returns the radiance that triangles emit against rays: only on the side of their normals.

    Args:
        corners: Corners of the triangles, shape (..., 3, 3).
        emission: Radiance of their materials, shape (..., 3).
        directions: Directions of the rays, shape (..., 3).

    Returns:
        Radiance of shape (..., 3).

    Differentiable: in ``emission``.

    Example:
        >>> flat = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
        >>> emission_at(flat, torch.ones(3), torch.tensor([0.0, 0, 1]))
        tensor([0., 0., 0.])
    """
    normal = torch.linalg.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    return torch.where((_dot(normal, directions) < 0)[..., None], emission, 0)


def seen_at(
    scene: Scene, camera: Camera, jitter: tuple[float, float], prim: Tensor, warp: Warp | None = None
) -> dict[str, Tensor]:
    """Returns what pixels see, from the triangles that they see.

    Args:
        scene: The scene.
        camera: The views.
        jitter: Shift (x, y) of all rays in pixels.
        prim: Triangle of each pixel, -1 for none, shape (v, 1, h, w).
        warp: The raster whose cells the pixels are; ``None`` for the camera's own.

    Returns:
        The fields ``albedo``, ``normal``, ``position``, ``depth`` and ``barycentric`` of a
        :class:`fovden.frame.GBuffer`, and the ``emission`` of surfaces, shape (v, 3, h, w); zero where nothing is hit.

    Differentiable: in the scene's vertices, normals, texture coordinates and materials, and in the tensors of
    camera and raster.

    Example:
        >>> from fovden.tracer import make_scene, trace_gbuffer
        >>> scene = make_scene("cornell_box")
        >>> views = scene.camera.at((4, 4)).views
        >>> seen_at(scene, views, (0.0, 0.0), trace_gbuffer(scene, views).prim)["depth"].amin() > 7
        tensor(True)
    """
    assert scene.normals is not None  # filled in by Scene, like uv
    assert scene.uv is not None
    numbers = prim.flatten(1)
    if warp is None:
        pixels = pixel_centres(camera.resolution).to(camera.origin) + torch.tensor(jitter).to(camera.origin)
    else:
        pixels = warp.positions(jitter).to(camera.origin)
    origins, directions = camera.rays(pixels.expand(camera.view_count, -1, 2))
    corners = corners_at(scene.vertices, scene.faces, numbers)
    t, u, v = hits_at(corners, origins, directions)
    materials, material = scene.materials, scene.material_ids[numbers.long().clamp_min(0)].long().flatten()
    uv = interpolated(rows_at(scene.uv, scene.faces, numbers), u, v).flatten(0, 1)
    texture = materials.texture[material]
    factor, emission = (table.index_select(0, material) for table in (materials.albedo, materials.emission))
    fields = {
        "albedo": albedo_at(factor, materials.textures, texture, uv).reshape(directions.shape),
        "normal": normal_at(corners, rows_at(scene.normals, scene.faces, numbers), directions, u, v),
        "position": interpolated(corners, u, v),
        "depth": (t * _dot(directions, -camera.rotation[:, None, :, 2]))[..., None],
        "barycentric": torch.stack([u, v], 2),
        "emission": emission_at(corners, emission.reshape(directions.shape), directions),
    }
    hit = prim >= 0
    return {name: torch.where(hit, _image(values, prim), 0) for name, values in fields.items()}


def _image(values: Tensor, like: Tensor) -> Tensor:
    """Values by view, pixel and channel as an image of shape (v, c, h, w)."""
    return values.mT.reshape(len(values), -1, *like.shape[2:])


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)
