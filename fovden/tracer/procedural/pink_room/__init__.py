"""The pink room: a furnished sitting room in the afternoon sun."""

from fovden.tracer.procedural.pink_room.scene import TRIANGLES, pink_room

__all__ = ["TRIANGLES", "pink_room"]
