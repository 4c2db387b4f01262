"""Cases as files for a method from elsewhere, and its drapes read back. Both are drape files (docs/evaluation.md)."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

from quaffure.baselines.posed import PosedDraper
from quaffure.benchmark.drape_cache import TimedDrape
from quaffure.benchmark.evaluation_set import CaseEntry, EvaluationCase, EvaluationSet
from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.drape_motion import drape_motion
from quaffure.errors import InputError
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.io.drape_file import read_drape, write_drape
from quaffure.scene import Scene

ROOT_SLACK = 1e-3
"""Largest distance of a root from its position on the scalp [m]."""
LONGEST_DRAPE = 1e9
"""Limit of the time of a drape that a file may state [ms]."""


def write_case(folder: Path, case: EvaluationCase, set_version: int, body: BodyModel, material: HairMaterial) -> Path:
    """Write `<case>.npz`: a drape file whose strands are still the posed ones, with the groom and the body at rest.

    Raises:
        InputError: the folder is missing or not writable.
    """
    posed = drape_motion(PosedDraper(material), case.groom, body, case.motion, case.body_shape)
    meta = {name: posed.meta[name] for name in ("groom", "licence", "motion", "material")}
    meta |= {"stiffness": case.loading.mean_stiffness, "acceleration": case.loading.acceleration}
    meta |= {"case": case.name, "evaluation_set": set_version, "frames": case.frames}
    at_rest = {
        "rest_strands": case.groom.rest_strands.numpy(),
        "root_faces": case.groom.root_faces.numpy(),
        "root_barycentric": case.groom.root_barycentric.numpy(),
        "root_uv": case.groom.root_uv.numpy(),
        "rest_body_vertices": body.rest_vertices.numpy(),
    }
    path = folder / f"{case.name}.npz"
    write_drape(path, replace(posed, meta=meta), at_rest)
    return path


def read_submission(path: Path, of: EvaluationSet, material: HairMaterial) -> tuple[CaseEntry, DrapeSequence]:
    """The case that a submitted drape file is of, and the drape.

    Raises:
        InputError: no drape file, NaN in it, no case of this version of the set, or hair of another material.
    """
    sequence = read_drape(path).in_place()
    version, found = sequence.meta.get("evaluation_set"), sequence.meta.get("case")
    if version != of.version:
        raise InputError(path, f"meta with evaluation_set {of.version}, as --write-cases writes it", f"{version}")
    entry = next((entry for entry in of.cases if entry.name == found), None)
    if entry is None:
        raise InputError(path, "meta with the name of a case of the evaluation set", f"'{found}'")
    if sequence.meta.get("material") != asdict(material):
        raise InputError(path, f"hair of {asdict(material)}", f"{sequence.meta.get('material')}")
    return entry, sequence


def submitted_frames(path: Path, sequence: DrapeSequence, case: EvaluationCase, body: BodyModel) -> list[TimedDrape]:
    """The frames of a submission, checked to be those of the case.

    Raises:
        InputError: other shapes, bodies or strands than the case's, or roots that left the scalp.
    """
    scene = Scene(case.groom, case.bodies(body))
    expected = {
        "body_pose": case.motion.body_pose.numpy(),
        "body_shape": case.body_shape.numpy(),
        "rest_lengths": case.groom.rest_lengths.numpy(),
    }
    if sequence.strands.shape != tuple(scene.posed.shape):
        raise InputError(path, f"strands {tuple(scene.posed.shape)}", f"{sequence.strands.shape}")
    for name, values in expected.items():
        if not np.allclose(getattr(sequence, name), values, atol=1e-4):
            raise InputError(path, f"the {name} of the case {case.name}", "another")
    off = float(np.abs(sequence.strands[:, :, 0] - scene.posed[:, :, 0].numpy()).max())
    if off > ROOT_SLACK:
        raise InputError(path, f"roots within {1000 * ROOT_SLACK:g} mm of the scalp", f"{1000 * off:.3g} mm")
    milliseconds = sequence.meta.get("milliseconds")
    # JSON has whole numbers beyond any float.
    is_time = isinstance(milliseconds, int | float) and 0 <= milliseconds < LONGEST_DRAPE
    taken = float(milliseconds) if is_time else None  # type: ignore[arg-type]
    return [TimedDrape(torch.from_numpy(frame), taken) for frame in sequence.strands]
