"""The path tracer: scenes, rays, noisy frames and their references.

Tensors outside, compiled kernels inside. Everything random is a function of a seed; the same call gives the same bits
on any number of threads.
"""

from fovden.tracer.bvh import Bvh, Hits, build_bvh, intersect, occluded
from fovden.tracer.gbuffer import trace_gbuffer
from fovden.tracer.integrator import trace_frame
from fovden.tracer.lights import DirectionalLight, EnvironmentLight, PointLight
from fovden.tracer.materials import Material, Materials
from fovden.tracer.reference import CheckpointError, accumulate_reference
from fovden.tracer.scene import Scene

__all__ = [
    "Bvh",
    "CheckpointError",
    "DirectionalLight",
    "EnvironmentLight",
    "Hits",
    "Material",
    "Materials",
    "PointLight",
    "Scene",
    "accumulate_reference",
    "build_bvh",
    "intersect",
    "occluded",
    "trace_frame",
    "trace_gbuffer",
]
