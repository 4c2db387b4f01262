"""A skinned character of a file as a body: skeleton, skin, collision surface and scalp."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.character.collision_surface import Triangles
    from quaffure.character.import_body import ImportSettings
    from quaffure.character.parts import parts_of
    from quaffure.character.skeleton import fit_skeleton

__all__, __getattr__, __dir__ = lazy_exports(__name__)
