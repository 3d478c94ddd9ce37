"""The path tracer: scenes, rays, noisy frames and their references.

Tensors outside, compiled kernels inside. Everything random is a function of a seed; the same call gives the same bits
on any number of threads.
"""

from fovden.tracer.animation import LightKeyframe, LightPath, Pose, RigidMotion
from fovden.tracer.bvh import Bvh, Hits, build_bvh, intersect, occluded
from fovden.tracer.dataset import FrameDataset
from fovden.tracer.formats.scene_file import SceneFileError
from fovden.tracer.gbuffer import trace_gbuffer
from fovden.tracer.integrator import Integrator, trace_frame
from fovden.tracer.light_paths import Paths
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, PointLight
from fovden.tracer.materials import Material, Materials
from fovden.tracer.meshes import load_scene
from fovden.tracer.motion import disoccluded
from fovden.tracer.points import Shading, SurfacePoints, surface_points
from fovden.tracer.procedural import make_scene
from fovden.tracer.reference import CheckpointError, accumulate_reference
from fovden.tracer.reshading import record_paths, reshade
from fovden.tracer.scene import Scene
from fovden.tracer.sequence import Instant, Sequence
from fovden.tracer.trajectory import CameraPath, GazeKeyframe, GazePath, Keyframe

__all__ = [
    "Bvh",
    "CameraPath",
    "CheckpointError",
    "DirectionalLight",
    "EnvironmentLight",
    "FrameDataset",
    "GazeKeyframe",
    "GazePath",
    "Hits",
    "Instant",
    "Integrator",
    "Keyframe",
    "LightKeyframe",
    "LightPath",
    "Material",
    "Materials",
    "Paths",
    "PointLight",
    "Pose",
    "RigidMotion",
    "Scene",
    "SceneFileError",
    "Sequence",
    "Shading",
    "SurfacePoints",
    "accumulate_reference",
    "build_bvh",
    "disoccluded",
    "intersect",
    "load_scene",
    "make_scene",
    "occluded",
    "record_paths",
    "reshade",
    "surface_points",
    "trace_frame",
    "trace_gbuffer",
]
