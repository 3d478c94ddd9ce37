"""How the acceleration structure and a ray on its way lie in memory, shared by all code that writes or reads them.

A node is 64 float32 (256 bytes, four cache lines): six rows of eight bounds (lower x, y, z, then upper x, y, z), a row
of eight int32 child codes and a row of eight int32 orders. A child code >= 0 is a node, a negative one is the leaf
block ``~code``. Children come by rising chance of stopping a ray, measured by what it costs to ask them. An order
belongs to the signs of a direction: 1 for a negative x, 2 for y, 4 for z, added up, are its number, and its eight
groups of four bits name the children from the farthest to the nearest. Unused lanes hold an inverted, infinite box,
which every ray misses.

A leaf block is 80 float32 (320 bytes): nine rows of eight coordinates (first vertex x, y, z, then second, then third)
and a row of eight int32 triangle numbers, to which CUTOUT is added where a triangle has holes. Unused lanes, and
triangles whose corners lie in a line, are all zeros, which every ray misses. A large triangle may be in several blocks.

A ray is 32 float32, two cache lines; what each is for stands with :func:`fovden.tracer.kernels.rays.prepare`. What is
written for three axes at once has four places, of which the last is something else.
"""

WIDTH = 8
NODE_SIZE = 64
UPPER = 24  # offset of the upper bounds' rows
CHILDREN = 48
ORDERS = 56
BLOCK_SIZE = 80
PRIMITIVES = 72
CUTOUT = 1 << 30

MAX_BINARY_DEPTH = 48  # deeper nodes are split at the median, which bounds the depth by this plus log2 of 2^31 / 8
STACK_SIZE = 640  # at most 7 entries are left behind at each of at most 48 + 28 levels

RAY_SIZE = 32
NEAR, NEAR_AT, FAR, FAR_AT = 0, 4, 8, 12  # x, y, z each
ORIGIN, SHEAR = 16, 20  # along the permuted axes
HIT_U, HIT_V, SCALE, LIMIT = 3, 7, 11, 23
NEAR_ROWS, VERTEX_ROWS, OCTANT, HIT_PRIM = 24, 28, 27, 31  # int32

RESULTS_SIZE = 32  # t, u and v of a block's triangles
