"""Data sets give the same bits in every process, and frames that differ in what they should."""

import dataclasses
from multiprocessing.context import set_spawning_popen
from multiprocessing.reduction import ForkingPickler

import pytest
import torch
from builders import rounded, scene_of, sphere
from torch.utils.data import DataLoader

from fovden.foveation import ThreeLayer, VisualPolarWarp, sample_map
from fovden.tracer import (
    EnvironmentLight,
    FrameDataset,
    GazeKeyframe,
    GazePath,
    Integrator,
    Pose,
    RigidMotion,
    Scene,
    Sequence,
    accumulate_reference,
    make_scene,
    trace_frame,
)

# Python 3.12 and later warn at every fork of a process with threads, which a process with PyTorch always is.
forks = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


def sequence(frames=3, resolution=(8, 10)) -> Sequence:
    """The Cornell box, its short block sliding, under a wandering gaze."""
    scene = make_scene("cornell_box")
    heights = scene.vertices[scene.faces.long()][..., 1]
    block = (scene.material_ids == 0) & (heights <= 1.66).all(1) & (heights.amax(1) > 1)
    slide = RigidMotion(block, (Pose(0), Pose(2, (0.4, 0.0, 0.0))))
    gaze = GazePath((GazeKeyframe(0, -5, 0), GazeKeyframe(2, 5, 3)))
    return Sequence(scene, scene.camera, gaze, (slide,), frames=frames).at(resolution)


def same(one, other):
    frames = torch.equal(one[0].radiance, other[0].radiance) and torch.equal(one[0].counts, other[0].counts)
    motion = torch.equal(one[0].gbuffer.motion, other[0].gbuffer.motion)
    if one[1] is None:
        return frames and motion and other[1] is None
    return (
        frames
        and motion
        and torch.equal(one[1].mean, other[1].mean)
        and torch.equal(one[1].variance, other[1].variance)
    )


def test_items_are_frames_and_references_of_the_sequence():
    scenes = sequence()
    dataset = FrameDataset(scenes, ThreeLayer(r0=2, r1=4), spp=2, seed=5, draws=2, reference_spp=3)
    assert len(dataset) == 6
    frame, reference = dataset[4]
    now, previous = scenes[1], scenes[0]
    samples = sample_map(ThreeLayer(r0=2, r1=4), now.camera, now.gaze, spp=2, seed=5, index=4)
    expected = trace_frame(now.scene, now.camera, samples, seed=frame.seed, index=1, previous=previous)
    assert frame.index == 1
    assert same((frame, None), (expected, None))
    assert frame.gbuffer.motion.any()
    assert torch.equal(frame.gaze.pixels, now.gaze.pixels)
    expected = accumulate_reference(now.scene, now.camera, spp=3, seed=reference.seed, progress=None)
    assert torch.equal(reference.mean, expected.mean)
    assert not dataset[0][0].gbuffer.motion.any()
    assert same(dataset[-1], dataset[5])
    assert FrameDataset(scenes, spp=2)[0][0].counts.unique().tolist() == [2]
    for index in (6, -7):
        with pytest.raises(IndexError, match="expected one from 0 to 5"):
            dataset[index]


def storages(value, seen):
    """Addresses of the memory of all tensors that can be reached from a value."""
    if id(value) in seen:
        return set()
    seen[id(value)] = value
    if isinstance(value, torch.Tensor):
        return {value.untyped_storage().data_ptr()} if value.numel() else set()
    parts = value if isinstance(value, tuple | list) else getattr(value, "__dict__", {}).values()
    return set().union(*(storages(part, seen) for part in parts))


def test_items_share_no_memory_with_the_data_set_or_each_other():
    """A worker moves what it sends to shared memory, and frees it, while it makes the next item from the rest."""
    dataset = FrameDataset(sequence(), ThreeLayer(r0=2, r1=4), spp=1, reference_spp=1)
    items = [dataset[index] for index in range(2)]
    own, found = storages(dataset, {}), [storages(item, {}) for item in items]
    assert len(own) > 5
    assert len(found[0]) > 15
    assert not found[0] & own
    assert not found[0] & found[1]


def test_draws_share_the_reference_and_nothing_random():
    dataset = FrameDataset(sequence(), ThreeLayer(r0=1, r1=2), spp=1, draws=2, reference_spp=2)
    one, other = dataset[1], dataset[4]
    assert torch.equal(one[0].gbuffer.position, other[0].gbuffer.position)
    assert torch.equal(one[1].mean, other[1].mean)
    assert one[0].seed != other[0].seed
    assert not torch.equal(one[0].counts, other[0].counts)
    seeds = {FrameDataset(sequence(), spp=1, seed=seed)[index][0].seed for seed in range(3) for index in range(3)}
    assert len(seeds) == 9
    assert dataset[0][1].seed != dataset[1][1].seed  # or the noise of references would stand still on the screen


def test_frames_and_references_have_the_same_bounces():
    dark = FrameDataset(sequence(), spp=1, reference_spp=2, integrator=Integrator(bounces=0))
    frame, reference = dark[0]
    assert not frame.indirect.any()
    now, settings = dark.sequence[0], {"spp": 2, "seed": reference.seed, "progress": None}
    expected = [
        accumulate_reference(now.scene, now.camera, integrator=Integrator(bounces, "power"), **settings).mean
        for bounces in (0, 1)
    ]
    assert torch.equal(reference.mean, expected[0])
    assert not torch.equal(reference.mean, expected[1])


@pytest.fixture
def two_threads():
    """As many threads as PyTorch has on two cores; the pool that they make does not survive a fork."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@forks
@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_make_the_same_bits(method):
    dataset = FrameDataset(sequence(), ThreeLayer(r0=2, r1=4), spp=2, seed=1, reference_spp=2)
    expected = [dataset[index] for index in range(3)]
    loader = DataLoader(dataset, batch_size=None, num_workers=2, multiprocessing_context=method, timeout=120)
    assert all(same(item, wanted) for item, wanted in zip(loader, expected, strict=True))
    assert all(same(dataset[index], expected[index]) for index in range(3))  # the arrays of this process stand


@forks
@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("workers", [0, 1, 2])
def test_order_and_number_of_workers_do_not_matter(workers):
    """Two shuffled epochs of the same workers, whatever PyTorch's, NumPy's and Python's own random states are."""
    dataset = FrameDataset(sequence(), ThreeLayer(r0=2, r1=4), spp=1, seed=3, draws=2)
    expected = {dataset[index][0].seed: dataset[index] for index in range(6)}
    assert len(expected) == 6
    loader = DataLoader(
        dataset,
        batch_size=None,
        shuffle=True,
        generator=torch.Generator().manual_seed(workers),
        num_workers=workers,
        persistent_workers=workers > 0,
        multiprocessing_context="fork" if workers else None,
        timeout=120 if workers else 0,
    )
    epochs = [[(item[0].seed, same(item, expected[item[0].seed])) for item in loader] for _ in range(2)]
    assert epochs[0] != epochs[1]
    assert all({seed for seed, _ in epoch} == set(expected) and all(kept for _, kept in epoch) for epoch in epochs)


def test_a_sequence_in_the_dark_is_refused_where_it_is_made():
    vertices, faces = sphere(1)
    dark = scene_of((rounded(vertices), faces), camera=make_scene("cornell_box").camera)
    with pytest.raises(ValueError, match="at least one light"):
        FrameDataset(Sequence(dark))


class Spawning:
    """Stands for a process that is being spawned, and is given files."""

    DupFd = int

    def duplicate_for_child(self, file: int) -> int:
        return file


def test_a_spawned_worker_is_sent_the_names_of_shared_memory():
    """Of a megabyte a few thousand bytes are sent, the memory is the same for every worker, and this process's own
    tensors, which its kernels read, stay where they are."""
    vertices, faces = sphere(5)
    scene = scene_of((rounded(vertices), faces), camera=make_scene("cornell_box").camera, lights=(EnvironmentLight(1),))
    own = [scene.vertices.data_ptr(), scene.bvh.nodes.data_ptr()]
    set_spawning_popen(Spawning())
    try:
        sent = [len(ForkingPickler.dumps(FrameDataset(Sequence(scene)))) for _ in range(2)]
        shared = scene.__getstate__()
    finally:
        set_spawning_popen(None)
    assert scene.bvh.nodes.nbytes + scene.bvh.blocks.nbytes + scene.vertices.nbytes + scene.faces.nbytes > 1e6
    assert max(sent) < 20_000
    assert shared["vertices"].is_shared()
    assert shared["bvh"].nodes.is_shared()
    assert own == [scene.vertices.data_ptr(), scene.bvh.nodes.data_ptr()]
    assert torch.equal(shared["vertices"], scene.vertices)
    read = Scene.__new__(Scene)
    read.__setstate__(shared)
    ray = torch.tensor([[0.1, 0.2, 3.0]]), torch.tensor([[0.0, 0.0, -1.0]])
    assert read.intersect(*ray) == scene.intersect(*ray)


@forks
def test_batches_join_views():
    dataset = FrameDataset(sequence(), spp=1, reference_spp=2)
    loader = DataLoader(
        dataset, batch_size=2, collate_fn=dataset.collate, num_workers=1, multiprocessing_context="fork"
    )
    (frames, references), (last, _) = loader
    assert frames.view_count == 4
    assert last.view_count == 2
    for index in range(2):
        frame, reference = dataset[index]
        views = slice(2 * index, 2 * index + 2)
        assert torch.equal(frames.radiance[views], frame.radiance)
        assert torch.equal(references.mean[views], reference.mean)
        assert torch.equal(references.camera.origin[views], reference.camera.origin)
    with pytest.raises(ValueError, match="one for each frame or none"):
        dataset.collate([dataset[0], (dataset[1][0], None)])
    with pytest.raises(ValueError, match="the same number in all"):
        dataset.collate([dataset[0], FrameDataset(sequence(), spp=1, reference_spp=3)[1]])


def test_references_are_kept(tmp_path, monkeypatch):
    dataset = FrameDataset(sequence(), spp=1, draws=2, reference_spp=2, folder=tmp_path)
    _, reference = dataset[1]
    assert [path.name for path in tmp_path.iterdir()] == ["cornell_box-00001-0.safetensors"]
    monkeypatch.setattr("fovden.parallel.run", None)  # nothing is traced for it again
    file, settings = next(tmp_path.iterdir()), {"spp": 2, "seed": reference.seed, "progress": None}
    kept = accumulate_reference(*dataset.sequence[1][:2], checkpoint=file, **settings)
    assert torch.equal(kept.mean, reference.mean)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"spp": 0}, "spp"),
        ({"seed": -1}, "seed"),
        ({"draws": 0}, "draws"),
        ({"reference_spp": 0}, "reference_spp"),
        ({"folder": "/nowhere"}, "an existing folder"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        FrameDataset(sequence(), **settings)


def test_items_in_cells_follow_the_gaze_and_their_references_stay_on_the_screen():
    scenes = sequence(resolution=(16, 20))
    warp = VisualPolarWarp.for_camera(scenes[0].camera)
    dataset = FrameDataset(scenes, ThreeLayer(r0=3, r1=6), spp=2, seed=5, reference_spp=2, warp=warp)
    items = [dataset[i] for i in range(3)]
    for number, (frame, reference) in enumerate(items):
        now = scenes[number]
        around = dataclasses.replace(warp, gaze=now.gaze)
        samples = sample_map(ThreeLayer(r0=3, r1=6), now.camera, spp=2, seed=5, index=number, warp=around)
        assert torch.equal(frame.counts, samples.counts.expand_as(frame.counts))
        assert torch.equal(frame.warp.gaze.pixels, now.gaze.pixels)
        assert frame.resolution == warp.resolution
        assert reference.mean.shape == (2, 3, 16, 20)
    assert not torch.equal(items[0][0].warp.gaze.pixels, items[2][0].warp.gaze.pixels)
    plain = FrameDataset(scenes, spp=2, seed=5, reference_spp=2)
    assert torch.equal(plain[1][1].mean, items[1][1].mean)
    frames, references = FrameDataset.collate(items)
    assert frames.view_count == references.mean.shape[0] == 6
    assert references.camera.resolution == frames.warp.screen == (16, 20)
    assert (FrameDataset(scenes, spp=1, warp=warp)[0][0].counts.amax(), items[0][0].counts.amax()) == (1, 2)


def test_a_raster_for_another_screen_is_an_error():
    warp = VisualPolarWarp.for_camera(sequence(resolution=(16, 20))[0].camera)
    with pytest.raises(ValueError, match=r"camera\.resolution: expected the screen's, \(16, 20\), got \(8, 10\)"):
        FrameDataset(sequence(), warp=warp)


@forks
def test_workers_trace_cells_with_the_same_bits():
    scenes = sequence()
    dataset = FrameDataset(scenes, spp=1, warp=VisualPolarWarp.for_camera(scenes[0].camera))
    loader = DataLoader(dataset, batch_size=None, num_workers=1)
    for number, item in enumerate(loader):
        assert same(item, dataset[number])
        assert item[0].raster == "visual-polar"
