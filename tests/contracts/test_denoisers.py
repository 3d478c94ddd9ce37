"""What every denoiser promises, asked of every member.

``relative`` tells whether a member measures the frame in its own units, and so must follow a change of exposure or of
the unit of length; widths in literal units belong to one exposure and one unit of length.
"""

import copy
import inspect
from dataclasses import dataclass, fields, replace

import pytest
import torch

import fovden.filters
from fovden.camera import Gaze
from fovden.filters import Atrous, Denoised, Denoiser, NonHomogeneousAtrous, PredictedSigmas, WarpedDenoiser
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp
from fovden.frame import Frame, GBuffer

RASTERS = {
    "log-polar": lambda gaze, size: LogPolarWarp(gaze, (9, 12), size, "rotate", 2.0),
    "visual-polar": lambda gaze, size: VisualPolarWarp(gaze, (9, 12), size, e_max=12.0),
    "stair": lambda gaze, size: VisualPolarWarp(gaze, (9, 12), size, "rotate", e_max=12.0, cut="stair", block=2),
    "as the screen": lambda gaze, size: ScreenWarp(gaze, size, size),
}


@dataclass(frozen=True)
class Member:
    """A denoiser of the suite."""

    kind: type
    options: dict
    constructor: str | None = None
    relative: bool = True
    outer: type | None = None
    raster: str | None = None
    learn: tuple = ()

    @property
    def few_passes(self):
        """Options that keep the member what it is and make it quick."""
        few = {"base": {"level": 2}, "nh2ld": {"levels": (1, 2)}, "nh3ld": {"levels": (1, 2, 3)}}
        return few[self.constructor] if self.constructor else {"steps": (2, 1)}

    def __str__(self):
        name = f"{self.kind.__name__}.{self.constructor}" if self.constructor else self.kind.__name__
        name = f"{self.outer.__name__}.{name}" if self.outer else name
        name = f"{self.raster}.{name}" if self.raster else name
        return "-".join([name, *(f"{key}={value}" for key, value in self.options.items())])

    def build(self, size=(10, 13), **options):
        """Returns a new denoiser in double precision, for frames of a height and width if it is made for one raster."""
        make = getattr(self.kind, self.constructor) if self.constructor else self.kind
        denoiser = make(**{**self.options, **options}).double()
        denoiser = denoiser if self.outer is None else stirred(self.outer(denoiser, channels=4))
        if self.raster:
            warp = RASTERS[self.raster](Gaze(torch.zeros(1, 2)), size)
            denoiser = WarpedDenoiser(denoiser, warp, blur=2.0, contrast=0.3, learn=self.learn)
        return denoiser.double()

    def frame(self, views=2, height=10, width=13, **options):
        """Returns a frame in the member's raster, with a gaze for each eye."""
        frame = make_frame(views, height, width, **options)
        if self.raster is None:
            return frame
        gaze = Gaze(torch.tensor([[6.3, 4.9], [5.2, 4.1]], dtype=frame.direct.dtype)[:views])
        return replace(frame, gaze=gaze, warp=RASTERS[self.raster](gaze, (height, width)))

    def screen(self, frame):
        """Returns the shape of the image of a frame."""
        return (*frame.direct.shape[:2], *(frame.warp.screen if self.raster else frame.resolution))


def stirred(denoiser):
    """A network that is no longer what it starts as: its last layer is not 0."""
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for weight in denoiser.network.parameters():
            weight.add_(0.1 * torch.randn(weight.shape, generator=generator))
    return denoiser


MEMBERS = [
    Member(Atrous, {}),
    Member(Atrous, {"steps": (4, 2, 1)}),
    Member(Atrous, {"demodulate": True, "border": "clamp"}),
    Member(Atrous, {"relative": False, "sigma_position": 0.1}, relative=False),
    Member(NonHomogeneousAtrous, {}, "base"),
    Member(NonHomogeneousAtrous, {}, "nh2ld"),
    Member(NonHomogeneousAtrous, {}, "nh3ld"),
    Member(NonHomogeneousAtrous, {"demodulate": True}, "nh3ld"),
    Member(NonHomogeneousAtrous, {"mask_update": "fill", "layers": "interleaved"}, "nh3ld"),
    Member(NonHomogeneousAtrous, {"guide": "input", "unsampled_guide": "nearest", "layers": "snapshot"}, "nh3ld"),
    Member(NonHomogeneousAtrous, {"schedule": "constant", "sigma_by": "scale", "border": "clamp"}, "nh3ld"),
    Member(NonHomogeneousAtrous, {"relative": False, "sigma_position": 0.1}, "nh3ld", relative=False),
    Member(Atrous, {"per_pass": True, "learn_kernel": True}),
    Member(NonHomogeneousAtrous, {"per_pass": True, "learn_kernel": True}, "nh3ld"),
    Member(NonHomogeneousAtrous, {"guide_curve": "log", "sigma_radiance": 1.0}, "nh3ld"),
    Member(Atrous, {"steps": (4, 2, 1)}, outer=PredictedSigmas),
    Member(NonHomogeneousAtrous, {"demodulate": True, "per_pass": True}, "nh3ld", outer=PredictedSigmas),
    Member(Atrous, {"steps": (4, 2, 1)}, raster="log-polar", learn=("blur", "contrast", "alpha")),
    Member(NonHomogeneousAtrous, {"demodulate": True}, "nh3ld", raster="visual-polar", learn=("blur",)),
    Member(NonHomogeneousAtrous, {"mask_update": "fill"}, "nh3ld", raster="as the screen"),
    Member(NonHomogeneousAtrous, {}, "nh3ld", outer=PredictedSigmas, raster="stair"),
]

each_member = pytest.mark.parametrize("member", MEMBERS, ids=str)


def make_frame(views=2, height=10, width=13, *, seed=0, constant=False, dtype=torch.float64):
    """A frame with unsampled pixels, three layers, a texture and a corner that sees nothing."""
    generator = torch.Generator().manual_seed(seed)

    def rand(channels):
        return torch.rand(views, channels, height, width, generator=generator, dtype=dtype)

    def zeros(channels):
        return torch.zeros(views, channels, height, width, dtype=dtype)

    y = torch.arange(height, dtype=dtype)[:, None].expand(views, 1, height, width)
    x = torch.arange(width, dtype=dtype).expand(views, 1, height, width)
    counts = (rand(1) < 0.6).to(dtype) * 4
    counts[..., -1, -1] = 4  # at least one sample in a view
    sampled = counts > 0
    if constant:
        hit = torch.ones_like(counts, dtype=torch.bool)
        albedo = normal = position = zeros(3) + 0.5
        depth, direct = zeros(1) + 2, (zeros(3) + 0.3) * sampled
    else:
        hit = y + x > min(height, width) / 4
        albedo, depth = (0.2 + 0.6 * rand(3)) * hit, (3 + 0.02 * x + 0.1 * rand(1)) * hit
        normal = torch.nn.functional.normalize(0.3 * rand(3) + 0.5, dim=1) * hit
        position = torch.cat([0.03 * x, -0.03 * y, -depth], dim=1) * hit
        direct = rand(3) * sampled
    distance = ((y + 0.5 - height / 2) ** 2 + (x + 0.5 - width / 2) ** 2).sqrt()
    gbuffer = GBuffer(
        albedo=albedo,
        normal=normal,
        position=position,
        depth=depth,
        roughness=hit.to(dtype),
        motion=zeros(2),
        prim=hit.int() - 1,
        barycentric=zeros(2),
    )
    return Frame(
        direct=direct,
        indirect=zeros(3) if constant else rand(3) * sampled,
        emission=zeros(3),
        counts=counts,
        luminance_squared=zeros(1),
        layer=(distance > height / 6).int() + (distance > height / 3).int(),
        gbuffer=gbuffer,
    )


def tensors_in(record):
    """Every tensor of a frame, by name."""
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, torch.Tensor):
            yield field.name, value
        elif isinstance(value, GBuffer):
            yield from tensors_in(value)


def test_every_exported_denoiser_is_a_member():
    exported = [getattr(fovden.filters, name) for name in fovden.filters.__all__]
    classes = {value for value in exported if inspect.isclass(value) and issubclass(value, Denoiser)}
    assert {kind for kind in classes if not inspect.isabstract(kind)} == {
        WarpedDenoiser if member.raster else member.outer or member.kind for member in MEMBERS
    }


@each_member
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_shape_type_and_device_are_kept(member, dtype):
    frame = member.frame(dtype=dtype)
    for denoiser in (member.build(), member.build().float()):
        denoised = denoiser(frame, history=None)
        assert isinstance(denoised, Denoised)
        assert denoised.image.shape == member.screen(frame)
        assert (denoised.image.dtype, denoised.image.device) == (dtype, frame.radiance.device)
        assert bool(torch.isfinite(denoised.image).all())


@each_member
def test_it_denoises(member):
    # A flat grey wall under noise: the image is nearer to it than the frame was, in its sampled pixels alone.
    frame = member.frame(1, 24, 24, constant=True)
    noise = torch.rand(frame.direct.shape, generator=torch.Generator().manual_seed(1), dtype=frame.direct.dtype)
    frame = replace(frame, direct=0.6 * noise * frame.mask)
    image = member.build((24, 24))(frame).image
    before = ((frame.radiance - 0.3) * frame.mask).square().sum() / (3 * frame.mask.sum())
    assert (image - 0.3).square().mean() < before / 4


@each_member
def test_constant_light_is_a_fixed_point(member):
    image = member.build()(member.frame(constant=True)).image
    torch.testing.assert_close(image, torch.full_like(image, 0.3), rtol=1e-12, atol=1e-12)


@each_member
def test_views_are_independent(member):
    left, right = member.frame(1, seed=1), member.frame(1, seed=2)
    denoiser = member.build()
    both = denoiser(Frame.stack([left, right])).image
    # Strips of rows hold another number of views, so that sums may be vectorised differently.
    torch.testing.assert_close(both, torch.cat([denoiser(left).image, denoiser(right).image]), rtol=1e-12, atol=1e-12)


@each_member
def test_inputs_are_left_alone_and_calls_repeat(member):
    frame = member.frame()
    before = {name: tensor.clone() for name, tensor in tensors_in(frame)}
    denoiser = member.build()
    state = copy.deepcopy(denoiser.state_dict())
    first = denoiser(frame).image
    denoiser(member.frame(seed=5))
    assert torch.equal(first, denoiser(frame).image)
    for name, tensor in tensors_in(frame):
        assert torch.equal(tensor, before[name]), name
    assert all(torch.equal(value, state[name]) for name, value in denoiser.state_dict().items())


@each_member
@pytest.mark.parametrize("size", [(1, 1), (1, 2), (3, 1), (2, 5), (7, 11)])
def test_odd_and_tiny_sizes(member, size):
    image = member.build(size)(member.frame(2, *size, constant=True)).image
    torch.testing.assert_close(image, torch.full_like(image, 0.3), rtol=1e-12, atol=1e-12)
    assert bool(torch.isfinite(member.build(size)(member.frame(2, *size)).image).all())


@each_member
def test_gradients_reach_the_radiance_and_every_parameter(member):
    frame = member.frame(1)
    direct = frame.direct.clone().requires_grad_()
    denoiser = member.build()
    target = torch.rand(member.screen(frame), generator=torch.Generator().manual_seed(3), dtype=direct.dtype)
    (denoiser(replace(frame, direct=direct)).image - target).square().sum().backward()
    assert bool(torch.isfinite(direct.grad).all())
    sampled = frame.mask > 0 if frame.warp is None else (frame.mask > 0) & frame.warp.exists
    sampled = sampled.expand_as(direct)
    assert bool((direct.grad[sampled] != 0).all())
    for name, parameter in denoiser.named_parameters():
        assert parameter.grad is not None, name
        assert bool(torch.isfinite(parameter.grad).all()), name
        assert bool((parameter.grad != 0).any()), name


@each_member
def test_gradcheck(member):
    frame = member.frame(1, 4, 5)
    # The view's units are constants to the gradient, so the radiance is checked in literal ones.
    denoiser = member.build((4, 5), **{**member.few_passes, "relative": False})

    def by_radiance(direct):
        # Unsampled pixels hold no light: what is added to them is not read.
        return denoiser(replace(frame, direct=direct * frame.mask)).image

    direct = (frame.direct + 0.1).requires_grad_()
    assert torch.autograd.gradcheck(by_radiance, direct, fast_mode=True)
    denoiser = member.build((4, 5), **member.few_passes)
    names, values = zip(*denoiser.named_parameters(), strict=True)

    def by_parameters(*values):
        return torch.func.functional_call(denoiser, dict(zip(names, values, strict=True)), (frame,)).image

    assert torch.autograd.gradcheck(
        by_parameters, [value.detach().requires_grad_() for value in values], fast_mode=True
    )


@pytest.mark.parametrize("member", [member for member in MEMBERS if member.relative], ids=str)
def test_exposure_and_the_unit_of_length_do_not_matter(member):
    frame, denoiser = member.frame(), member.build()
    want = denoiser(frame).image
    brighter = replace(frame, direct=frame.direct * 37, indirect=frame.indirect * 37)
    torch.testing.assert_close(denoiser(brighter).image, want * 37, rtol=1e-10, atol=1e-10)
    gbuffer = replace(frame.gbuffer, position=frame.gbuffer.position * 0.01, depth=frame.gbuffer.depth * 0.01)
    torch.testing.assert_close(denoiser(replace(frame, gbuffer=gbuffer)).image, want, rtol=1e-10, atol=1e-10)


@each_member
def test_state_goes_to_a_dictionary_and_back(member):
    frame, trained = member.frame(), member.build()
    with torch.no_grad():
        for parameter in trained.parameters():
            parameter.add_(0.3)
    fresh = member.build()
    assert not torch.allclose(fresh(frame).image, trained(frame).image)
    fresh.load_state_dict(trained.state_dict())
    assert torch.equal(fresh(frame).image, trained(frame).image)
