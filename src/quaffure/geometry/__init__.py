"""Geometry that knows no hair: meshes, distances, grids, polylines and rotations."""

from typing import TYPE_CHECKING

from quaffure._kernel_cache import drop_own_kernels_of_other_types
from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.geometry.bvh import Bvh
    from quaffure.geometry.mls_surface import MlsSurface, resolve_contact_reference
    from quaffure.geometry.occupancy_grid import FREE, FREE_DISTANCE, OUTSIDE, classify
    from quaffure.geometry.polyline import directors, integrate_directions, integrate_directions_reference
    from quaffure.geometry.rotation import (
        axis_angle_from_matrix,
        cross_product_matrix,
        matrix_from_axis_angle,
        quaternion_from_matrix,
        quaternion_multiply,
    )
    from quaffure.geometry.sampling import farthest_points
    from quaffure.geometry.surface import Surface, occupancy_of, posed_surface, surface_topology
    from quaffure.geometry.triangle_grid import TriangleGrid

drop_own_kernels_of_other_types()

__all__, __getattr__, __dir__ = lazy_exports(__name__)
