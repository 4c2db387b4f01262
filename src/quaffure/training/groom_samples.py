"""Grooms to learn a code from: the library under several seeds and draws from the continuous family, kept in a folder.

Making one takes 0.4 s, reading it back 3 ms, so every groom is made once and written; a stopped run carries on.
"""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from quaffure.body.body_model import BodyModel
from quaffure.config import TEXTURE_SIZE
from quaffure.errors import InputError
from quaffure.hair.groom import Groom
from quaffure.io.atomic import replacing
from quaffure.model.groom_texture import TEXTURE_CHANNELS, GroomSample, sample_of
from quaffure.npz import INTEGER, Spec, read_arrays
from quaffure.procedural.generator import make_groom
from quaffure.procedural.hair_style import STYLES, HairStyle
from quaffure.procedural.style_family import sample_style
from quaffure.training.run_folder import body_digest

SAMPLES_VERSION = 1
"""To be raised when the generator, or the features of its strands, changes what it makes of the same controls."""
SPEC: Spec = {"features": (("S", TEXTURE_CHANNELS), (np.float16,)), "texels": (("S",), INTEGER)}


@dataclass(frozen=True)
class ProceduralGroom:
    """A groom of the hairstyle generator."""

    name: str
    controls: HairStyle
    seed: int

    def groom(self, body: BodyModel) -> Groom:
        """The groom on a body."""
        return replace(make_groom(self.controls, body, self.seed), name=self.name)

    def file_name(self, body: str) -> str:
        """Name of the file of its sample, on a body of that digest."""
        origin = f"{self.controls}, body {body}, version {SAMPLES_VERSION}"
        return f"{self.name}-{self.seed}-{hashlib.sha256(origin.encode()).hexdigest()[:8]}.npz"


def library_grooms(names: Iterable[str], seeds: Iterable[int]) -> list[ProceduralGroom]:
    """Styles of the library, each once with every seed."""
    return [ProceduralGroom(name, STYLES[name], seed) for name in names for seed in seeds]


def family_grooms(indices: Iterable[int]) -> list[ProceduralGroom]:
    """Draws from the continuous family, each by a generator of its own."""
    return [
        ProceduralGroom(f"family_{index}", sample_style(torch.Generator().manual_seed(index)), index)
        for index in indices
    ]


def cached_samples(
    grooms: list[ProceduralGroom], body: BodyModel, folder: Path, on_groom: Callable[[int], None]
) -> list[GroomSample]:
    """Samples of the grooms, made where the folder does not hold them yet.

    Args:
        folder: existing.
        on_groom: called with the number of grooms that are ready.

    Raises:
        InputError: a file of the folder is damaged.
    """
    samples, digest = [], body_digest(body)
    for groom in grooms:
        path = folder / groom.file_name(digest)
        if not path.is_file():
            _write(path, sample_of(groom.groom(body), body, groom.name))
        samples.append(_read(path, groom.name))
        on_groom(len(samples))
    return samples


def _write(path: Path, sample: GroomSample) -> None:
    with replacing(path) as temporary:
        np.savez(temporary, features=sample.features.numpy(), texels=sample.texels.numpy().astype(np.int16))


def _read(path: Path, style: str) -> GroomSample:
    what = "a groom that this command wrote (delete the file to have it made again)"
    arrays, _ = read_arrays(path, SPEC, what)
    if ((arrays["texels"] < 0) | (arrays["texels"] >= TEXTURE_SIZE**2)).any():
        raise InputError(path, what, "texels outside of the texture")
    return GroomSample(style, torch.from_numpy(arrays["features"]), torch.from_numpy(arrays["texels"].astype(np.int64)))
