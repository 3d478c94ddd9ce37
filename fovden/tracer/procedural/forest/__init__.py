"""The forest: a clearing at night, lit by lanterns."""

from fovden.tracer.procedural.forest.scene import TRIANGLES, forest

__all__ = ["TRIANGLES", "forest"]
