"""Strands in SIMD blocks, as compiled kernels read them; `quaffure.hair.strand_blocks` makes them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class StrandBlocks(NamedTuple):
    """`quaffure.hair.strand_blocks.RestStrands` in blocks; the last block repeats the last strand to fill its lanes.

    Attributes:
        strand: index of the strand in each lane.
        edges, offset, corners, barycentric: see `RestStrands`.
        anchor: of a tied strand (`Ties`), as an index of `scalp_vertices`; -1 for free ones.
        tie: of a tied strand, offset and direction (`Ties`).
        margin: distance from the body that the far vertex of each edge is to keep [m].
    """

    strand: Int[np.ndarray, "block lane"]
    edges: Float[np.ndarray, "block e 3 lane"]
    offset: Float[np.ndarray, "block 3 lane"]
    corners: Int[np.ndarray, "block 3 lane"]
    barycentric: Float[np.ndarray, "block 3 lane"]
    anchor: Int[np.ndarray, "block lane"]
    tie: Float[np.ndarray, "block 6 lane"]
    margin: Float[np.ndarray, "block e lane"]
