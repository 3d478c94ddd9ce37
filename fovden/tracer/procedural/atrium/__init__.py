"""The atrium: a colonnaded court of two storeys."""

from fovden.tracer.procedural.atrium.scene import TRIANGLES, atrium

__all__ = ["TRIANGLES", "atrium"]
