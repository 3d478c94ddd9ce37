"""Reflectance images made in code: stone, plaster, wood, cloth, plants and the ground.

Each function returns a uint8 image with the sRGB curve, shape (h, w, 3), top row first, that repeats without a seam.
Colours are given as sRGB values in [0, 1]. The variation is drawn by the generator that is passed in.
"""
