"""Meshes and materials that are called as hair is."""

import re

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
"""Words of a name: `_`, digits and other signs separate them, and so do capitals (`LongHair`)."""
_HAIR_WORD = re.compile(
    r"[a-z]*(?<!c)hair|hair(?:s|style|cut|cards?|cap)|wigs?|(?:eye)?brows?|(?:eye)?lash(?:es)?|beards?"
    r"|mou?staches?|ponytails?|bangs?|fringes?"
)


def is_hair_name(name: str) -> bool:
    """Whether a word of a name is one for hair: `Hair_Long`, `longhair01`, `eyelashes`; not `Chair`, `Skin_Brown`."""
    return any(_HAIR_WORD.fullmatch(word.lower()) for word in _WORD.findall(name))
