"""Names of array axes, used in every annotation.

`b` batch, `s` strand, `n` vertex of a strand (0 is the root), `e` edge of a strand (n - 1), `v` vertex of a mesh,
`k` face of a mesh, `j` joint, `f` frame of a motion. Shapes are checked at run time under pytest only.
"""

from jaxtyping import Bool, Float, Int  # noqa: F401  imported from here with the others
from torch import Tensor

Scalar = float | Float[Tensor, ""]
Positions = Float[Tensor, "b s n 3"]
EdgeVectors = Float[Tensor, "b s e 3"]
RestLengths = Float[Tensor, "s e"]
Energy = Float[Tensor, " b"]
BodyPose = Float[Tensor, "b 81"]
BodyShape = Float[Tensor, "b 10"]
MeshVertices = Float[Tensor, "b v 3"]
MeshFaces = Int[Tensor, "k 3"]
