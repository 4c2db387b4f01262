"""Procedural hairstyles: named styles, a continuous family of styles and the generator of grooms."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.procedural.generator import make_groom
    from quaffure.procedural.hair_style import HELD_OUT, STYLES, Clipping, Fringe, HairStyle
    from quaffure.procedural.style_family import CURL_TYPES, sample_style
    from quaffure.procedural.style_sizes import StyleSize

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "generator": ["make_groom"],
        "hair_style": ["Clipping", "Fringe", "HELD_OUT", "HairStyle", "STYLES"],
        "style_family": ["CURL_TYPES", "sample_style"],
        "style_sizes": ["StyleSize"],
    },
)
