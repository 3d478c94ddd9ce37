"""Small frames with everything in them: unsampled pixels, three layers, misses, textures, an emitter."""

import torch

from fovden.frame import Frame, GBuffer


def make_frame(views=2, height=9, width=11, *, seed=0, density=0.6, dtype=torch.float64, misses=True, emission=False):
    generator = torch.Generator().manual_seed(seed)

    def rand(channels):
        return torch.rand(views, channels, height, width, generator=generator, dtype=dtype)

    y = torch.arange(height, dtype=dtype)[:, None].expand(views, 1, height, width)
    x = torch.arange(width, dtype=dtype).expand(views, 1, height, width)
    hit = (y + x > 3) if misses else torch.ones_like(y, dtype=torch.bool)
    normal = torch.nn.functional.normalize(rand(3) * 0.3 + torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1), dim=1)
    depth = 4 + 0.1 * x + rand(1)
    position = torch.cat([0.1 * x, -0.1 * y, -depth], dim=1)
    prim = torch.where(hit, (x // 4).to(torch.int32), -1)
    counts = (rand(1) < density).to(dtype) * 4
    sampled = counts > 0
    distance = ((y + 0.5 - height / 2) ** 2 + (x + 0.5 - width / 2) ** 2).sqrt()
    layer = (distance > height / 6).int() + (distance > height / 3).int()
    emitted = 5.0 * (prim == 1) * sampled * torch.ones_like(position)
    zero = torch.zeros_like(depth)
    return Frame(
        direct=rand(3) * 1.5 * sampled,
        indirect=rand(3) * sampled,
        emission=emitted if emission else torch.zeros_like(emitted),
        counts=counts,
        luminance_squared=zero,
        layer=layer,
        gbuffer=GBuffer(
            albedo=(rand(3) * 0.8 + 0.1) * hit,
            normal=normal * hit,
            position=position * hit,
            depth=depth * hit,
            roughness=hit.to(dtype),
            motion=torch.zeros(views, 2, height, width, dtype=dtype),
            prim=prim,
            barycentric=torch.zeros(views, 2, height, width, dtype=dtype),
        ),
    )


def tensors_of(frame):
    """Radiance, normals, positions, mask and layers, for ``filter``."""
    return frame.radiance, frame.gbuffer.normal, frame.gbuffer.position, frame.mask, frame.layer
