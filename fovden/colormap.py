"""The colour map of error maps: magma, from black over purple and orange to pale yellow.

Its lightness rises evenly, so that it reads the same in grey and to the colour-blind. FLIP's maps are shown with it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from fovden.checks import require_shapes

__all__ = ["MAGMA", "NO_VALUE", "apply"]

# By Nathaniel J. Smith and Stefan van der Walt, put into the public domain (CC0); the bytes that matplotlib draws with.
_HEXADECIMAL = (
    "000003 000004 000006 010007 010109 01010b 02020d 02020f 030311 040313 040415 050417 060519 07051b 08061d 09071f"
    "0a0722 0b0824 0c0926 0d0a28 0e0a2a 0f0b2c 100c2f 110c31 120d33 140d35 150e38 160e3a 170f3c 180f3f 1a1041 1b1044"
    "1c1046 1e1049 1f114b 20114d 221150 231152 251155 261157 281159 2a115c 2b115e 2d1060 2f1062 301065 321067 341068"
    "350f6a 370f6c 390f6e 3b0f6f 3c0f71 3e0f72 400f73 420f74 430f75 450f76 470f77 481078 4a1079 4b1079 4d117a 4f117b"
    "50127b 52127c 53137c 55137d 57147d 58157e 5a157e 5b167e 5d177e 5e177f 60187f 61187f 63197f 651a80 661a80 681b80"
    "691c80 6b1c80 6c1d80 6e1e81 6f1e81 711f81 731f81 742081 762181 772181 792281 7a2281 7c2381 7e2481 7f2481 812581"
    "822581 842681 852681 872781 892881 8a2881 8c2980 8d2980 8f2a80 912a80 922b80 942b80 952c80 972c7f 992d7f 9a2d7f"
    "9c2e7f 9e2e7e 9f2f7e a12f7e a3307e a4307d a6317d a7317d a9327c ab337c ac337b ae347b b0347b b1357a b3357a b53679"
    "b63679 b83778 b93778 bb3877 bd3977 be3976 c03a75 c23a75 c33b74 c53c74 c63c73 c83d72 ca3e72 cb3e71 cd3f70 ce4070"
    "d0416f d1426e d3426d d4436d d6446c d7456b d9466a da4769 dc4869 dd4968 de4a67 e04b66 e14c66 e24d65 e44e64 e55063"
    "e65162 e75262 e85461 ea5560 eb5660 ec585f ed595f ee5b5e ee5d5d ef5e5d f0605d f1615c f2635c f3655c f3675b f4685b"
    "f56a5b f56c5b f66e5b f6705b f7715b f7735c f8755c f8775c f9795c f97b5d f97d5d fa7f5e fa805e fa825f fb8460 fb8660"
    "fb8861 fb8a62 fc8c63 fc8e63 fc9064 fc9265 fc9366 fd9567 fd9768 fd9969 fd9b6a fd9d6b fd9f6c fda16e fda26f fda470"
    "fea671 fea873 feaa74 feac75 feae76 feaf78 feb179 feb37b feb57c feb77d feb97f febb80 febc82 febe83 fec085 fec286"
    "fec488 fec689 fec78b fec98d fecb8e fdcd90 fdcf92 fdd193 fdd295 fdd497 fdd698 fdd89a fdda9c fddc9d fddd9f fddfa1"
    "fde1a3 fce3a5 fce5a6 fce6a8 fce8aa fceaac fcecae fceeb0 fcf0b1 fcf1b3 fcf3b5 fcf5b7 fbf7b9 fbf9bb fbfabd fbfcbf"
)

MAGMA = torch.tensor(list(bytes.fromhex(_HEXADECIMAL)), dtype=torch.uint8).reshape(256, 3)
"""The 256 colours of the map from 0 to 1, sRGB, shape (256, 3), uint8."""

NO_VALUE = (0, 255, 255)
"""Signal colour of what is not a number, in images and in error maps, sRGB levels: cyan, which renderings hardly ever
contain and no entry of the map comes near."""


def apply(values: Tensor) -> Tensor:
    """Returns the colours of values: entry ``round(255 value)`` of :data:`MAGMA`.

    Args:
        values: In [0, 1], shape (v, 1, h, w); what lies beyond gets the colour of the nearer end, NaN that of
            :data:`NO_VALUE`.

    Returns:
        Display-encoded colours in [0, 1], float32, shape (v, 3, h, w).

    Raises:
        ShapeError: If ``values`` has another shape.

    Differentiable: no. Source: the rounding is that of FLIP's evaluator since version 1.1.

    Example:
        >>> apply(torch.tensor([[[[0.0, 0.5, 1.0]]]])).mul(255).int().flatten(2)[0].T.tolist()
        [[0, 0, 3], [182, 54, 121], [251, 252, 191]]
    """
    require_shapes("v 1 h w", values=values)
    values = values.detach()[:, 0]
    entries = torch.nan_to_num(255 * values.clamp(0, 1) + 0.5, nan=len(MAGMA)).long()
    table = torch.cat([MAGMA, MAGMA.new_tensor([NO_VALUE])]).to(values.device)
    return table[entries].permute(0, 3, 1, 2).float() / 255
