"""What a drape reads besides the network, as plain arrays, for runtimes without torch (`examples`).

Names with a dot are fields of the classes of that name, which the compiled kernels take; lengths are in metres:

    Skeleton.*        joints (`quaffure.body.kinematics_kernel`)
    near              joints of the pose features, the head first
    Skin.*            vertices to pose (`quaffure.body.head_frame_kernels`): those of the point-sampled body, then the
                      scalp, then the collision skin, which begin at `parts` [2]
    radius, per_radius    of the sampled points, and its inverse
    StrandBlocks.*    strands at rest (`quaffure.hair.block_arrays`)
    RodBlocks.*       as rods (`quaffure.model.initial_shape_kernels`)
    rows, texels      row of the network's input in each lane, and texel of each row
    Surroundings.*    what surrounds strands in their design (`quaffure.model.surroundings`)
    GridUnits.*       of the grid of densities (`quaffure.model.surroundings_kernels`)
    groom_code        [16]
    PushedRods.*      strands for the projection (`quaffure.model.projection_kernel`)
    PushSettings.*    its settings
    faces, band       of the collision skin, and how far below and above it they count
    passes, least_disturbance, decay_length, tied_share, bend_relaxation       of the initial shape
    feature_columns, own_feature_columns    numbers that the network reads of a strand, and how many come before those
                      of its surroundings
"""

from pathlib import Path
from typing import Any

import numpy as np

from quaffure.body.body_model import BodyModel
from quaffure.body.collision_skin import collision_skin
from quaffure.body.head_frame import near_hair, scalp_vertices, skin_to_pose
from quaffure.body.kinematics import skeleton_of
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.atomic import replacing
from quaffure.model.network_config import NetworkConfig
from quaffure.model.neural import NeuralDraper
from quaffure.model.prepared_groom import PreparedGroom
from quaffure.model.projection import push_settings
from quaffure.model.strand_layers import OWN_FEATURES, feature_size
from quaffure.model.surroundings import Surroundings, grid_units


def write_drape_constants(path: Path, draper: NeuralDraper, groom: Groom, body: BodyModel) -> None:
    """Write the constants of a groom on a body as an .npz.

    Raises:
        InputError: a network without pose features, contact or surroundings; a groom
            that is not laid out for the network; or not writable.
    """
    config = draper.network.config
    if not (config.predicts_directions and config.contact and config.surroundings and config.pose_features):
        raise InputError(
            "--weights", "a network of edge directions, with pose features, contact and surroundings", "another one"
        )
    prepared = draper.prepared(groom, body)
    arrays = _of_body(body, config, prepared.most_clearance) | _of_groom(prepared) | _of_network(config)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _of_body(body: BodyModel, config: NetworkConfig, most_clearance: float) -> dict[str, np.ndarray]:
    skeleton, own = skeleton_of(body), config.initial_shape.body
    if skeleton is None:
        raise InputError("body", "float32, on the CPU", "another one")
    posed = skin_to_pose(body, own.leaves, True)
    skin, sampled = collision_skin(body, most_clearance), len(posed.normals)
    parts = np.array([sampled, sampled + len(scalp_vertices(body))])
    return {
        **_fields(skeleton),
        **_fields(posed),
        "near": near_hair(body),
        "parts": parts,
        "radius": np.array(own.kernel_radius, np.float32),
        "per_radius": np.array(1 / own.kernel_radius, np.float32),
        "faces": skin.faces.numpy(),
        "band": skin.band,
    }


def _of_groom(groom: PreparedGroom) -> dict[str, np.ndarray]:
    blocks = groom.blocks
    return {
        **_fields(blocks.strands),
        **_fields(blocks.rods),
        **_fields(blocks.pushed),
        **{f"Surroundings.{name}": values for name, values in zip(Surroundings._fields, blocks.surroundings)},
        "rows": blocks.rows,
        "texels": blocks.texels.flat.numpy(),
        "groom_code": groom.code.numpy(),
    }


def _of_network(config: NetworkConfig) -> dict[str, np.ndarray]:
    shape = config.initial_shape
    return {
        **_fields(grid_units(config.density_grid)),
        **_fields(push_settings(config.projection, 1.0)),
        "passes": np.array(shape.passes),
        "least_disturbance": np.array(shape.least_disturbance**2 + 1e-12, np.float32),
        "decay_length": np.array(shape.decay_length, np.float32),
        "tied_share": np.array(shape.tied_share, np.float32),
        "bend_relaxation": np.array(shape.bend_relaxation, np.float32),
        "feature_columns": np.array(feature_size(config)),
        "own_feature_columns": np.array(OWN_FEATURES),
    }


def _fields(arrays: Any) -> dict[str, np.ndarray]:
    return {f"{type(arrays).__name__}.{name}": np.asarray(values) for name, values in arrays._asdict().items()}
