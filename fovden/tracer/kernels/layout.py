"""How the acceleration structure lies in memory, shared by the code that packs it and the code that walks it.

A node is 64 float32 (256 bytes, four cache lines): six rows of eight bounds (lower x, y, z, then upper x, y, z) and a
row of eight int32 child codes; the last row is spare. A child code >= 0 is a node, a negative one is the leaf block
``~code``. Unused lanes hold an inverted box, which every ray misses.

A leaf block is 80 float32 (320 bytes): nine rows of eight coordinates (first vertex x, y, z, then second, then third)
and a row of eight int32 triangle numbers. Unused lanes, and triangles whose corners lie in a line, are all zeros, which
every ray misses.
"""

WIDTH = 8
NODE_SIZE = 64
UPPER = 24  # offset of the upper bounds' rows
CHILDREN = 48
BLOCK_SIZE = 80
PRIMITIVES = 72

MAX_BINARY_DEPTH = 48  # deeper nodes are split at the median, which bounds the depth by this plus log2 of 2^31 / 8
STACK_SIZE = 640  # at most 7 entries are left behind at each of at most 48 + 28 levels
RESULTS_SIZE = 24  # t, u and v of a block's triangles
