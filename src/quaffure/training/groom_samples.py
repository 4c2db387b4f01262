"""Grooms to learn a code from: the library under several seeds and draws from the continuous family, kept in a folder.

Growing one takes 0.4 s, reading it back 3 ms, so every groom is grown once and written; a stopped run carries on.
"""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

import quaffure.procedural
from quaffure.body.body_model import BodyModel
from quaffure.config import TEXTURE_SIZE
from quaffure.errors import InputError
from quaffure.geometry.surface import Surface
from quaffure.hair.groom import Groom
from quaffure.io.atomic import replacing
from quaffure.model import groom_texture
from quaffure.model.groom_texture import TEXTURE_CHANNELS, GroomSample, sample_of
from quaffure.npz_file import read_npz
from quaffure.procedural.generator import make_groom
from quaffure.procedural.hair_style import STYLES, HairStyle
from quaffure.procedural.style_family import sample_style
from quaffure.training.run_folder import body_digest


@dataclass(frozen=True)
class Growing:
    """One groom to be grown."""

    name: str
    controls: HairStyle
    seed: int

    def grown(self, body: BodyModel, surface: Surface) -> Groom:
        """The groom on a body, whose surface at rest is given."""
        return replace(make_groom(self.controls, body, self.seed, surface), name=self.name)

    def file_on(self, body: str) -> str:
        """Name of the file of it on a body of that digest. Changes with the controls and with the code that grows and
        encodes: what was edited is grown anew.
        """
        origin = f"{self.controls}, body {body}, code {_digest_of_sources()}"
        return f"{self.name}-{self.seed}-{hashlib.sha256(origin.encode()).hexdigest()[:8]}.npz"


def library_growings(names: Iterable[str], seeds: Iterable[int]) -> list[Growing]:
    """Styles of the library, each once with every seed."""
    return [Growing(name, STYLES[name], seed) for name in names for seed in seeds]


def family_growings(indices: Iterable[int]) -> list[Growing]:
    """Draws from the continuous family, each by a generator of its own."""
    return [Growing(f"family_{index}", sample_style(torch.Generator().manual_seed(index)), index) for index in indices]


def grow_samples(
    growings: list[Growing], body: BodyModel, surface: Surface, folder: Path, on_groom: Callable[[int], None]
) -> list[GroomSample]:
    """The grooms, grown where the folder does not hold them yet.

    Args:
        surface: of the body at rest.
        folder: existing.
        on_groom: called with the number of grooms that are ready.

    Raises:
        InputError: a file of the folder is damaged.
    """
    samples, digest = [], body_digest(body)
    for growing in growings:
        path = folder / growing.file_on(digest)
        if not path.is_file():
            _write(path, sample_of(growing.grown(body, surface), body, growing.name))
        samples.append(_read(path, growing.name))
        on_groom(len(samples))
    return samples


@cache
def _digest_of_sources() -> str:
    (room,) = quaffure.procedural.__path__
    sources = [*sorted(Path(room).glob("*.py")), Path(groom_texture.__file__)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def _write(path: Path, sample: GroomSample) -> None:
    with replacing(path) as beside:
        np.savez(beside, features=sample.features.numpy(), texels=sample.texels.numpy().astype(np.int16))


def _read(path: Path, style: str) -> GroomSample:
    arrays = read_npz(path, ("features", "texels"))
    features, texels = arrays.get("features", np.empty(0)), arrays.get("texels", np.empty(0))
    whole = features.dtype == np.float16 and features.shape == (len(texels), TEXTURE_CHANNELS)
    if not whole or not np.isfinite(features).all() or ((texels < 0) | (texels >= TEXTURE_SIZE**2)).any():
        raise InputError(path, "a groom that this command wrote", "other arrays (delete it to have it grown anew)")
    return GroomSample(style, torch.from_numpy(features), torch.from_numpy(texels.astype(np.int64)))
