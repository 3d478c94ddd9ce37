"""Compiled kernels of the tracer: private, called through the tensor functions of the package above."""
