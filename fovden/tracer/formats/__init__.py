"""Scene files: what a scene looks like in Wavefront OBJ and glTF 2.0, read and written.

Users call :func:`fovden.tracer.load_scene` and :meth:`fovden.tracer.Scene.export`; here is what stands under them.
Readers hand over a :class:`SceneParts`, writers take a scene.
"""

from fovden.tracer.formats.gltf import gltf_parts, read_gltf_header
from fovden.tracer.formats.gltf_writer import write_gltf
from fovden.tracer.formats.obj import read_obj
from fovden.tracer.formats.obj_writer import write_obj
from fovden.tracer.formats.scene_file import SceneFileError, SceneParts

__all__ = [
    "SceneFileError",
    "SceneParts",
    "gltf_parts",
    "read_gltf_header",
    "read_obj",
    "write_gltf",
    "write_obj",
]
