"""Sequences: what moves, what rests, what is shared, and walks through the scenes made in code."""

import dataclasses
import pickle

import numpy as np
import pytest
import torch
from builders import box, generator, rounded, scene_of, sphere
from procedural_scenes import WHOLE_SCENES

from fovden.camera import StereoCamera
from fovden.tracer import (
    CameraPath,
    GazeKeyframe,
    GazePath,
    LightKeyframe,
    LightPath,
    Material,
    Materials,
    PointLight,
    Pose,
    RigidMotion,
    Scene,
    Sequence,
    make_scene,
    trace_frame,
    trace_gbuffer,
)

CAMERA = StereoCamera.look_at((0.3, 0.4, 4.0), (0, 0, 0), fov_y_deg=50, resolution=(24, 32))
WALK = CameraPath(CAMERA, ((0, (0, 0, 4), (0, 0, 0)), (5, (1, 0, 4), (0, 0, 0))))
LAMP = PointLight((0, 5, 0), 20)
QUARTER = (0.0, 0.5**0.5, 0.0, 0.5**0.5)


def ball_in_box(**attributes) -> Scene:
    """A ball with normals of its own in the middle of a box."""
    walls, ball = box((2, 2, 2), (8.0, 8.0, 8.0)), sphere(2)
    vertices = torch.cat([rounded(walls[0]), rounded(ball[0], 0.5)])
    faces = torch.cat([walls[1], ball[1] + len(walls[0])])
    normals = torch.cat([torch.zeros(len(walls[0]), 3), rounded(ball[0])])
    ids = (torch.arange(len(faces)) >= len(walls[1])).int()
    materials = (Material("wall", (0.7, 0.7, 0.7)), Material("ball", (0.6, 0.2, 0.1)))
    settings = {"material_ids": ids, "normals": normals, "lights": (LAMP,), "camera": CAMERA} | attributes
    return scene_of((vertices, faces), *materials, **settings)


def test_a_walk_shares_one_scene():
    scene = ball_in_box(path=WALK)
    sequence = Sequence(scene)
    assert len(sequence) == len(list(sequence)) == 6
    for frame, instant in enumerate(sequence):
        assert instant.scene is scene
        assert instant.camera == WALK[frame]
        assert instant.gaze is None
    assert sequence[-1].camera == WALK[5]
    assert sequence.at(resolution=(6, 8))[2].camera == WALK.at(resolution=(6, 8))[2]
    assert Sequence(ball_in_box(), CAMERA)[0].camera == Sequence(ball_in_box())[0].camera == CAMERA


def test_it_is_as_long_as_its_longest_path():
    gaze = GazePath((GazeKeyframe(0, 0, 0), GazeKeyframe(3, 5, 0)))
    motion = RigidMotion("ball", (Pose(0), Pose(7, (1.0, 0.0, 0.0))))
    lamp = LightPath((LightKeyframe(0, LAMP), LightKeyframe(11, LAMP)))
    scene = ball_in_box()
    assert len(Sequence(scene)) == 1
    assert len(Sequence(scene, WALK, gaze)) == 6
    assert len(Sequence(scene, WALK, gaze, (motion,))) == 8
    whole = Sequence(scene, WALK, gaze, (motion,), (lamp,))
    assert len(whole) == 12
    assert whole[11].camera == WALK[5]
    assert torch.equal(whole[11].gaze.pixels, gaze.gaze(3, WALK[5]).pixels)
    assert len(Sequence(scene, WALK, frames=3)) == 3
    for frame in (12, -13):
        with pytest.raises(IndexError, match="expected one from 0 to 11"):
            whole[frame]


def test_a_part_moves_and_the_rest_stays():
    scene = ball_in_box()
    turned_first = Pose(0, rotation=QUARTER)
    sequence = Sequence(scene, objects=(RigidMotion("ball", (turned_first, Pose(4, (2.0, 0.0, 0.0), QUARTER))),))
    moved = sequence[2].scene
    ball = slice(len(box((2, 2, 2), (1, 1, 1))[0]), None)
    assert torch.equal(moved.faces, scene.faces)
    assert torch.equal(moved.vertices[: ball.start], scene.vertices[: ball.start])
    assert torch.equal(moved.normals[: ball.start], scene.normals[: ball.start])
    x, y, z = scene.vertices[ball].unbind(1)
    # A quarter turn about y takes z to x and x to -z; the ball's centre is its pivot.
    assert torch.allclose(moved.vertices[ball], torch.stack([z + 1, y, -x], 1), atol=1e-6)
    x, y, z = scene.normals[ball].unbind(1)
    assert torch.allclose(moved.normals[ball], torch.stack([z, y, -x], 1), atol=1e-6)
    seen = trace_gbuffer(moved, CAMERA)
    on_ball = (seen.prim >= 48)[:, 0]
    assert on_ball.any()
    distance = (seen.position - torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1)).norm(dim=1)[on_ball]
    assert ((distance > 0.45) & (distance < 0.501)).all()  # on the ball, whose faces lie up to 4 % inside


def test_scenes_are_kept_for_the_next_frame():
    keys = (Pose(0), Pose(2, held=True), Pose(4, (1.0, 0.0, 0.0)), Pose(9, (2.0, 0.0, 0.0)))
    lamp = LightPath((LightKeyframe(0, LAMP, held=True), LightKeyframe(7, PointLight((0, 5, 0), 0))))
    scene = ball_in_box()
    sequence = Sequence(scene, objects=(RigidMotion("ball", keys),))
    assert sequence[0].scene is sequence[1].scene is sequence[3].scene is scene  # at rest
    assert sequence[5].scene is sequence[5].scene
    kept = sequence[4].scene
    assert sequence[5].scene is not kept
    assert sequence[4].scene is kept
    lit = Sequence(scene, objects=(RigidMotion("ball", keys),), lights=(lamp, LAMP))
    six, seven = lit[6].scene, lit[7].scene
    assert six.lights == (LAMP, LAMP)
    assert seven.lights == (PointLight((0, 5, 0), 0), LAMP)
    assert lit[6].scene.bvh is lit[6].scene.bvh is not seven.bvh
    still = Sequence(scene, lights=(lamp,))
    assert still[0].scene.bvh is still[7].scene.bvh is scene.bvh


def test_moved_scenes_are_those_made_anew_and_share_their_textures():
    image = torch.randint(0, 256, (4, 4, 3), generator=generator(1), dtype=torch.uint8)
    ball = Material("ball", (0.6, 0.2, 0.1), emission=(1.0, 2.0, 3.0))
    plain = ball_in_box(uv=torch.rand(216, 2, generator=generator(2)))
    scene = dataclasses.replace(plain, materials=Materials.of([Material("wall", (0.7, 0.7, 0.7), texture=image), ball]))
    sequence = Sequence(scene, objects=(RigidMotion("ball", (Pose(0, (0.5, 0.0, 0.0), QUARTER),)),), lights=(LAMP,))
    moved = sequence[0].scene
    made = Scene(**{each.name: getattr(moved, each.name) for each in dataclasses.fields(Scene) if each.init})
    frame, expected = trace_frame(moved, CAMERA, 2), trace_frame(made, CAMERA, 2)
    assert torch.equal(frame.radiance, expected.radiance)
    assert torch.equal(frame.gbuffer.position, expected.gbuffer.position)
    assert not torch.equal(frame.radiance, trace_frame(scene, CAMERA, 2).radiance)
    texels = [each.kernel_arrays("uniform")[2].texels for each in (scene, moved, moved.with_lights(()), made)]
    assert [np.shares_memory(texels[0], each) for each in texels] == [True, True, True, False]


def test_objects_that_tear_or_share_triangles_are_refused():
    scene = ball_in_box()
    half = (scene.material_ids == 1) & (torch.arange(scene.triangle_count) % 2 == 0)
    with pytest.raises(ValueError, match="corners of triangles that rest"):
        Sequence(scene, objects=(RigidMotion(half, (Pose(0),)),))
    with pytest.raises(ValueError, match="vertices in more than one"):
        Sequence(scene, objects=(RigidMotion("ball", (Pose(0),)), RigidMotion("ball", (Pose(0),))))
    with pytest.raises(ValueError, match="a material of the scene"):
        Sequence(scene, objects=(RigidMotion("cube", (Pose(0),)),))
    with pytest.raises(ValueError, match="camera"):
        Sequence(ball_in_box(camera=None))
    with pytest.raises(ValueError, match="frames"):
        Sequence(scene, frames=0)


def test_pickles_hold_what_cannot_be_made_again():
    """The tensors' own bytes, and some kilobytes of names and numbers, whatever was built or traced before."""
    scene = ball_in_box(views={"side": CAMERA})
    sequence = Sequence(scene, WALK, objects=(RigidMotion("ball", (Pose(0), Pose(4, (2.0, 0.0, 0.0)))),))
    trace_gbuffer(scene, CAMERA)
    trace_gbuffer(sequence[2].scene, CAMERA)
    tensors = (scene.vertices, scene.faces, scene.material_ids, scene.normals, scene.uv)
    size = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
    data = pickle.dumps(sequence)
    assert len(data) < size + 10_000
    read = pickle.loads(data)
    assert not {"bvh", "_geometry_arrays", "_copies"} & vars(read.scene).keys()
    assert dict(read.scene.views) == {"side": CAMERA}
    with pytest.raises(TypeError):
        read.scene.views["side"] = None
    assert torch.equal(read[2].scene.vertices, sequence[2].scene.vertices)
    assert torch.equal(trace_gbuffer(*read[2][:2]).position, trace_gbuffer(*sequence[2][:2]).position)


@pytest.mark.parametrize("name", WHOLE_SCENES)
def test_walks_of_the_scenes(name):
    """Motion from the frame before is small and finite, and almost everything was seen there."""
    sequence = Sequence(make_scene(name, detail=2000)).at(resolution=(20, 24))
    assert len(sequence) == 1000
    for frame in (1, 400, 999):
        scene, camera, _ = sequence[frame]
        assert scene is sequence.scene
        motion = trace_gbuffer(scene, camera, previous=sequence[frame - 1]).motion
        assert np.isfinite(motion.numpy()).all()
        # A step of at most 4 cm and half a degree: less than 3 pixels where nothing is nearer than 0.3 m.
        assert 0 < float(motion.abs().median()) < 3
