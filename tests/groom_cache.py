"""Bundled grooms made once: half of all test files make some, and so does every command that they run."""

from functools import cache, wraps
from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from quaffure.body import BodyModel
    from quaffure.hair import Groom
    from quaffure.procedural import HairStyle


def install() -> None:
    """Let `make_groom` return copies of the bundled grooms that it has made on the shipped body.

    Before any module imports it by name. `make_groom.__wrapped__` is the function itself.
    """
    from quaffure.body import load_body
    from quaffure.procedural import generator

    make = generator.make_groom

    @cache
    def once(name: str, controls: "HairStyle", seed: int) -> "Groom":
        return make(name, load_body(), seed)

    @wraps(make)
    def copy_of(style: "str | HairStyle", body: "BodyModel", seed: int = 0) -> "Groom":
        if body is not load_body() or not isinstance(style, str) or style not in generator.STYLES:
            return make(style, body, seed)
        groom = once(style, generator.STYLES[style], seed)  # the controls, for some tests have other ones
        return groom.select(torch.arange(len(groom)))

    generator.make_groom = copy_of
