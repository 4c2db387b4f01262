"""Drapers to compare with: the posed groom, and GroomGen."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.baselines.groomgen import GroomGenDraper, load_groomgen
    from quaffure.baselines.groomgen_network import GroomGenLayers, GroomGenNetwork, save_groomgen
    from quaffure.baselines.posed import PosedDraper

__all__, __getattr__, __dir__ = lazy_exports(__name__)
