"""Drape strand hair on a posed, shaped body, by a network that was trained on physics alone.

import torch, quaffure as qf
groom = qf.load_groom("long_straight")  # a bundled name or a file
model = qf.load_model()  # the shipped weights
body_pose, body_shape = torch.zeros(1, 81), torch.zeros(1, 10)
hair = model.drape(groom, body_pose, body_shape)  # [1, strands, 24, 3] metres, world
"""

from importlib.metadata import version
from typing import TYPE_CHECKING

__version__ = version("quaffure")

__all__ = [
    "BodyModel",
    "Groom",
    "HairEnergy",
    "HairMaterial",
    "InputError",
    "Quaffure",
    "__version__",
    "load_body",
    "load_groom",
    "load_model",
]

if TYPE_CHECKING:
    from quaffure.body.body_model import BodyModel, load_body
    from quaffure.config import HairMaterial
    from quaffure.energies.hair_energy import HairEnergy
    from quaffure.errors import InputError
    from quaffure.hair.groom import Groom
    from quaffure.io.load_groom import load_groom
    from quaffure.model.quaffure_model import Quaffure, load_model
else:
    # Torch takes a second to import, so each name is fetched when it is first asked for (PEP 562).
    _MODULES = {
        "BodyModel": "quaffure.body.body_model",
        "Groom": "quaffure.hair.groom",
        "HairEnergy": "quaffure.energies.hair_energy",
        "HairMaterial": "quaffure.config",
        "InputError": "quaffure.errors",
        "Quaffure": "quaffure.model.quaffure_model",
        "load_body": "quaffure.body.body_model",
        "load_groom": "quaffure.io.load_groom",
        "load_model": "quaffure.model.quaffure_model",
    }

    def __getattr__(name: str) -> object:
        if name not in _MODULES:
            raise AttributeError(f"module 'quaffure' has no attribute '{name}'")
        from importlib import import_module

        return getattr(import_module(_MODULES[name]), name)

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
