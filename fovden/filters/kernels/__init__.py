"""Compiled kernels of the filters: private, called through the tensor functions of the package above."""
