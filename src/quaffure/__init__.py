"""Drape strand hair on a posed, shaped body, by a network that was trained on physics alone.

import torch, quaffure as qf
groom = qf.load_groom("long_straight")  # a bundled name or a file
model = qf.load_model()  # the shipped weights
body_pose, body_shape = torch.zeros(1, 81), torch.zeros(1, 10)
hair = model.drape(groom, body_pose, body_shape)  # [1, strands, 24, 3] metres, world
"""

import os
from importlib.metadata import version
from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.apps.drape_clip import drape_clip, draw, save_drape
    from quaffure.body.body_model import BodyModel, load_body
    from quaffure.config import HairMaterial
    from quaffure.energies.hair_energy import HairEnergy
    from quaffure.errors import InputError
    from quaffure.hair.drape_sequence import DrapeSequence
    from quaffure.hair.groom import Groom
    from quaffure.io.load_groom import load_groom
    from quaffure.io.load_motion import load_motion
    from quaffure.model.quaffure_model import Quaffure, load_model

# Torch and numba have threads of their own, which by default spin while they wait for work: beside other busy programs,
# drapes took twice to four times as long. Too late where torch was imported before; on idle cores it costs nothing.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

__version__ = version("quaffure")

__all__, __getattr__, __dir__ = lazy_exports(__name__)
__all__ += ["__version__"]
