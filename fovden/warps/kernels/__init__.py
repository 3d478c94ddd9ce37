"""Compiled kernels of warps: private, called through the tensor functions of the package above."""
