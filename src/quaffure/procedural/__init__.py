"""Procedural hairstyles: named styles, a continuous family of styles and the generator of grooms."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.procedural.curls import curl_arc_factor
    from quaffure.procedural.generator import make_groom
    from quaffure.procedural.hair_style import HELD_OUT, STYLES, Clipping, Fringe, HairStyle, read_styles
    from quaffure.procedural.style_family import CURL_TYPES, sample_style

__all__, __getattr__, __dir__ = lazy_exports(__name__)
