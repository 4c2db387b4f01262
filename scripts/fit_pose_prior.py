"""Fit the pose prior to a folder of motion clips: `python scripts/fit_pose_prior.py FOLDER`.

Writes `src/quaffure/assets/pose_prior.npz` (see `quaffure.body.pose_prior`). The clips that the evaluation set names
are left out. Each clip counts twice, as it is and mirrored, so the prior knows no left and right.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.stats import norm, rankdata

from quaffure.benchmark.evaluation_set import SETS, load_evaluation_set
from quaffure.body import PRIOR_FILE, BodyModel, Motion, PosePrior, joint_matrices, load_body, without_heading
from quaffure.body.retargeting import body_bone
from quaffure.errors import InputError
from quaffure.io import replacing
from quaffure.io.read_motion import MOTION_SUFFIXES, read_motion

# Tables run from the 0.5th to the 99.5th percentile, 53 entries.
LARGEST_SCORE = 2.6
EXPLAINED_VARIANCE = 0.99
BACKWARD_ELBOW_SINE = 0.3  # 17 degrees: elbows overextend by 10 at most
# People in the clips face ahead; hair needs heads that turn. Range of the head relative to the chest [degrees], about
# x (bend), y (lean), z (turn), evenly filled: just inside what healthy necks do (about 45-60, 45 and 60-80).
HEAD_RANGE_DEGREES = (45.0, 30.0, 70.0)
NECK_SHARES = {"Neck": 0.28, "Neck1": 0.34, "Head": 0.38}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="motion clips (.bvh, .npz)")
    body = load_body()
    clips = training_clips(parser.parse_args().folder, body)
    prior = fit(clips, body)
    check_prior(prior, str(PRIOR_FILE))
    with replacing(PRIOR_FILE) as temporary:
        np.savez(
            temporary,
            **{name: getattr(prior, name).numpy() for name in PosePrior.__dataclass_fields__},
            meta=np.array(
                json.dumps({"clips": [clip.name for clip in clips], "fitted_by": "scripts/fit_pose_prior.py"})
            ),
        )
    frames = sum(map(len, clips))
    print(f"{len(clips)} clips, {frames} frames, {len(prior.rates)} components -> {PRIOR_FILE.name}")


def check_prior(prior: PosePrior, source: str) -> None:
    """Check a fitted prior.

    Raises:
        InputError: a number is not finite, a table falls, or a row of the loadings has not unit length.
    """
    tensors = (prior.mean_pose, prior.scores, prior.quantiles, prior.loadings, prior.rates)
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors):
        raise InputError(source, "finite numbers", "NaN or infinity")
    if bool((prior.quantiles.diff(dim=0) < 0).any()):
        raise InputError(source, "quantiles that rise", "a table that falls")
    if not torch.allclose(prior.loadings.norm(dim=1), torch.ones(81), atol=1e-4):
        raise InputError(source, "rows of loadings of unit length", f"{prior.loadings.norm(dim=1)}")


def training_clips(folder: Path, body: BodyModel) -> list[Motion]:
    held_out = {name for version in SETS for name in load_evaluation_set(version).motions}
    paths = [path for path in sorted(folder.glob("*")) if path.suffix.lower() in MOTION_SUFFIXES]
    paths = [path for path in paths if path.stem not in held_out]
    clips = [read_motion(path, body) for path in paths]
    sound = [clip for clip in clips if share_of_backward_elbows(clip, body) < 0.05]
    broken = sorted({clip.name for clip in clips} - {clip.name for clip in sound})
    print(f"left out, for elbows that bend backwards: {', '.join(broken) or 'none'}")
    if not sound:
        raise InputError(folder, "motion clips that are not held out", "none")
    return sound


def share_of_backward_elbows(clip: Motion, body: BodyModel) -> float:
    """Share of frames in which a hand lies behind the line of its upper arm, as in the conversion of CMU's 13_18."""
    rotations = joint_matrices(clip.body_pose)
    backward = torch.zeros(len(clip), dtype=torch.bool)
    for side in ("Left", "Right"):
        forearm = torch.nn.functional.normalize(body_bone(body, f"{side}ForeArm", f"{side}Hand").double(), dim=-1)
        direction = rotations[:, body.joint_names.index(f"{side}ForeArm")] @ forearm
        backward |= direction[:, 1] > BACKWARD_ELBOW_SINE
    return float(backward.double().mean())


def fit(clips: list[Motion], body: BodyModel) -> PosePrior:
    poses = [without_heading(clip.body_pose).double().numpy() for clip in clips]
    poses += [mirrored(pose, body) for pose in poses]
    rates_per_second = [clip.fps for clip in clips] * 2
    mean, offsets = offsets_from_mean(poses)
    scores = normal_scores(offsets)
    loadings = component_loadings(scores)
    grid = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, 53)
    quantiles = np.quantile(np.concatenate(offsets), norm.cdf(grid), axis=0)
    widen_neck(quantiles, grid, body)
    return PosePrior(
        mean_pose=torch.from_numpy(mean).float(),
        scores=torch.from_numpy(grid).float(),
        quantiles=torch.from_numpy(quantiles).float(),
        loadings=torch.from_numpy(loadings).float(),
        rates=torch.from_numpy(component_rates(scores, loadings, rates_per_second)).float(),
    )


def mirrored(pose: Float[np.ndarray, "f 81"], body: BodyModel) -> Float[np.ndarray, "f 81"]:
    """The pose with left and right exchanged: rotation vectors are mirrored as (x, -y, -z)."""
    names = list(body.joint_names)
    other = {"Left": "Right", "Right": "Left", "LHip": "RHip", "RHip": "LHip"}
    swapped = []
    for name in names:
        side = next((side for side in other if name.startswith(side)), "")
        swapped.append(names.index(other.get(side, "") + name.removeprefix(side)))
    return (pose.reshape(-1, 27, 3)[:, swapped] * [1.0, -1.0, -1.0]).reshape(-1, 81)


def offsets_from_mean(poses: list[np.ndarray]) -> tuple[Float[np.ndarray, "81"], list[np.ndarray]]:
    """Mean rotation of each joint and each pose's rotation vectors from it [rad]."""
    joints = np.concatenate(poses).reshape(-1, 27, 3)
    means = [Rotation.from_rotvec(joints[:, joint]).mean() for joint in range(27)]
    offsets = [
        np.concatenate(
            [(means[j].inv() * Rotation.from_rotvec(pose[:, 3 * j : 3 * j + 3])).as_rotvec() for j in range(27)], axis=1
        )
        for pose in poses
    ]
    return np.concatenate([mean.as_rotvec() for mean in means]), offsets


def normal_scores(offsets: list[np.ndarray]) -> list[np.ndarray]:
    """Each column's rank among all frames as a standard normal score; 0 in columns that never move."""
    together = np.concatenate(offsets)
    scores = norm.ppf((rankdata(together, axis=0) - 0.5) / len(together))
    scores[:, together.std(axis=0) < 1e-4] = 0.0
    return np.split(scores, np.cumsum([len(part) for part in offsets])[:-1])


def component_loadings(scores: list[np.ndarray]) -> Float[np.ndarray, "81 c"]:
    """Principal components of the scores, scaled so that each of the 81 scores has variance 1."""
    values, vectors = np.linalg.eigh(np.cov(np.concatenate(scores), rowvar=False))
    values, vectors = values[::-1].clip(min=0), vectors[:, ::-1]
    count = int(np.searchsorted(np.cumsum(values) / values.sum(), EXPLAINED_VARIANCE)) + 1
    loadings = vectors[:, :count] * np.sqrt(values[:count])
    length = np.linalg.norm(loadings, axis=1, keepdims=True)
    # A column that never moves has a flat table: which component it follows does not matter.
    return np.where(length > 1e-6, loadings / length.clip(min=1e-6), np.eye(81, count)[:1])


def component_rates(
    scores: list[np.ndarray], loadings: Float[np.ndarray, "81 c"], fps: list[float]
) -> Float[np.ndarray, " c"]:
    """Rate of each component [1/s]: the process has speed variance r^2 where its own variance is 1."""
    project = np.linalg.pinv(loadings)
    components = [part @ project.T for part in scores]
    speeds = [np.diff(part, axis=0) * rate for part, rate in zip(components, fps)]
    variance = np.concatenate(components).var(axis=0)
    return np.sqrt((np.concatenate(speeds) ** 2).mean(axis=0) / variance)


def widen_neck(quantiles: Float[np.ndarray, "q 81"], grid: Float[np.ndarray, " q"], body: BodyModel) -> None:
    """Replace the tables of neck and head by an even spread over `HEAD_RANGE_DEGREES`, each joint with its share."""
    even = (norm.cdf(grid) - 0.5) / (norm.cdf(LARGEST_SCORE) - 0.5)
    for name, share in NECK_SHARES.items():
        joint = list(body.joint_names).index(name)
        quantiles[:, 3 * joint : 3 * joint + 3] = share * np.radians(HEAD_RANGE_DEGREES) * even[:, None]


if __name__ == "__main__":
    main()
