"""A short drape of a small groom on the body, as exporters take it."""

import torch

from quaffure.baselines import PosedDraper
from quaffure.body import BodyModel, Motion
from quaffure.drape_motion import drape_motion
from quaffure.hair import ExportClip, ExportSettings, Groom, interpolation_of
from quaffure.hair.groom_binding import groom_binding

SHAPE = torch.tensor([1.0, *[0.0] * 9])
FRAMES = 4


def export_clip(
    groom: Groom, body: BodyModel, strands: int | None = None, settings: ExportSettings | None = None
) -> ExportClip:
    """The posed groom on a body that nods, with `strands` between the guides where asked for."""
    pose = torch.zeros(FRAMES, 81)
    pose[:, 3 * body.joint_names.index("Head")] = torch.linspace(0, 0.4, FRAMES)
    sequence = drape_motion(PosedDraper(), groom, body, Motion(pose, 24.0, "nod"), SHAPE)
    interpolation = None if strands is None else interpolation_of(groom, body, strands)
    return ExportClip(sequence, interpolation, groom_binding(groom, body, SHAPE), settings or ExportSettings())
