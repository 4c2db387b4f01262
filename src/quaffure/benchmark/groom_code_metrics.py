"""Quality of a groom code: reconstruction, separation of styles, and interpolation between two codes."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from scipy.spatial import cKDTree

from quaffure.config import EDGES_PER_STRAND, TEXTURE_SIZE
from quaffure.model.groom_autoencoder import GroomAutoencoder, relative_distance
from quaffure.model.groom_encoder import GroomEncoder
from quaffure.model.groom_texture import SHAPE_CHANNELS, UNIT_LENGTH, GroomSample, texture_of
from quaffure.types import Float, Int, Tensor

MILLIMETRES = 1e3
# Of a strand, in grooms of the same style by other seeds.
NEIGHBOURS = 12


@dataclass(frozen=True)
class Reconstruction:
    """A groom after encoding and decoding; distances over all vertices but the roots.

    Attributes:
        mean_mm, p95_mm: mean and 95th percentile of the distance [mm].
        length_mm: mean length of the strands [mm].
        length_percent: mean distance over mean length [%].
        strand_percent: mean over strands of distance over own length [%]; very short hair weighs as much as long hair.
    """

    groom: str
    mean_mm: float
    p95_mm: float
    length_mm: float
    length_percent: float
    strand_percent: float


@torch.no_grad()
def reconstruction(network: GroomAutoencoder, groom: GroomSample) -> Reconstruction:
    """Encode a groom, decode it at its own texels, compare."""
    features = groom.features.float()
    code = _code(network.encoder, features, groom.texels)
    decoded = network.decoder(code, torch.zeros_like(groom.texels), groom.texels)
    relative = relative_distance(decoded, features)
    lengths = MILLIMETRES * UNIT_LENGTH * features[:, SHAPE_CHANNELS].exp()
    distances = relative * lengths[:, None]
    mean, length = float(distances.mean()), float(lengths.mean())
    return Reconstruction(
        groom=groom.style,
        mean_mm=mean,
        p95_mm=float(distances.flatten().quantile(0.95)),
        length_mm=length,
        length_percent=100 * mean / length,
        strand_percent=100 * float(relative.mean()),
    )


def style_scatter(groom: GroomSample, others: list[GroomSample]) -> float:
    """Distance of a groom from its prediction by grooms of the same style and other seeds, over the mean length [%].

    A strand is predicted by the medians of the vertices of the nearest strands of the others. The distance is that of
    chance (phases of curls, clumps, lengths): about what remains when a code holds all of the style and nothing else.
    """
    positions = [
        torch.stack([g.texels % TEXTURE_SIZE, g.texels // TEXTURE_SIZE], dim=1).numpy() for g in (groom, *others)
    ]
    nearest = cKDTree(np.concatenate(positions[1:])).query(positions[0], k=NEIGHBOURS)[1]
    predicted = torch.cat([_vertices(other) for other in others])[torch.from_numpy(nearest)].median(dim=1).values
    lengths = UNIT_LENGTH * groom.features[:, SHAPE_CHANNELS].float().exp()
    return 100 * float((predicted - _vertices(groom)).norm(dim=-1).mean() / lengths.mean())


def scatter_of_styles(grooms: list[GroomSample]) -> dict[str, float]:
    """`style_scatter` of the first groom of every style that has several."""
    styles: dict[str, list[GroomSample]] = {}
    for groom in grooms:
        styles.setdefault(groom.style, []).append(groom)
    return {style: style_scatter(of_style[0], of_style[1:]) for style, of_style in styles.items() if len(of_style) > 1}


def summary(rows: list[Reconstruction]) -> dict[str, float]:
    """Means over grooms, and the worst groom's mean distance over mean length."""
    names = ("mean_mm", "p95_mm", "length_mm", "length_percent", "strand_percent")
    means = {name: sum(getattr(row, name) for row in rows) / len(rows) for name in names}
    return {"grooms": len(rows)} | means | {"length_percent_worst": max(row.length_percent for row in rows)}


@torch.no_grad()
def codes_of(encoder: GroomEncoder, grooms: Iterable[GroomSample]) -> Float[Tensor, "g 16"]:
    return torch.cat([_code(encoder, groom.features.float(), groom.texels) for groom in grooms])


def code_metrics(
    encoder: GroomEncoder, reference: list[GroomSample], others: list[GroomSample]
) -> dict[str, dict[str, float]]:
    """How well codes separate styles, for grooms of other seeds and for grooms that lose every second strand.

    Args:
        reference: one groom of every style.
        others: grooms of the same styles by other seeds.

    Returns:
        For each of the two: `style_accuracy_percent`, and mean and largest `shift`.
    """
    changes = {
        "grown anew": others,
        "half the strands": [half_of(groom, seed) for seed, groom in enumerate(reference)],
        "grown anew, half the strands": [half_of(groom, seed) for seed, groom in enumerate(others)],
    }
    return {
        name: {"growings": len(changed)} | _shifts(encoder, reference, changed) for name, changed in changes.items()
    }


def _shifts(encoder: GroomEncoder, reference: list[GroomSample], changed: list[GroomSample]) -> dict[str, float]:
    """Share of the changed grooms whose nearest reference code is their own style's, and how far codes have moved.

    A shift is the distance from the own style's reference code, over that code's distance to the nearest other style.
    """
    codes, moved = codes_of(encoder, reference), codes_of(encoder, changed)
    styles = [groom.style for groom in reference]
    own = torch.tensor([styles.index(groom.style) for groom in changed])
    gaps = torch.cdist(moved, codes)
    apart = torch.cdist(codes, codes).fill_diagonal_(torch.inf).amin(1)
    shift = gaps.gather(1, own[:, None])[:, 0] / apart[own]
    return {
        "style_accuracy_percent": 100 * float((gaps.argmin(1) == own).float().mean()),
        "shift_mean": float(shift.mean()),
        "shift_largest": float(shift.max()),
    }


def half_of(groom: GroomSample, seed: int) -> GroomSample:
    """Half of the strands, by chance."""
    kept = torch.rand(len(groom.texels), generator=torch.Generator().manual_seed(seed)) < 0.5
    return GroomSample(groom.style, groom.features[kept], groom.texels[kept])


def interpolation_metrics(network: GroomAutoencoder, grooms: list[GroomSample]) -> dict[str, dict[str, float]]:
    """`betweenness` of all pairs: mean, least and largest."""
    rows = [betweenness(network, first, second) for first, second in combinations(grooms, 2)]
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    return {
        name: {"pairs": len(rows), "mean": sum(column) / len(rows), "least": min(column), "largest": max(column)}
        for name, column in columns.items()
    }


@torch.no_grad()
def betweenness(network: GroomAutoencoder, first: GroomSample, second: GroomSample) -> dict[str, float]:
    """What the code half-way between two grooms decodes to, against what the two codes decode to.

    Returns:
        share: its distance from the first groom over that of both, 0.5 in the middle.
        detour: distance over the first, by way of it, to the second, less the direct one, over the direct one.
        length_outside_mm: distance of its mean strand length from the range of theirs [mm].
    """
    codes = codes_of(network.encoder, (first, second))
    steps = (codes[:1], codes.mean(0, keepdim=True), codes[1:])
    (start, a), (half, middle), (stop, b) = (_decoded(network, step, first.texels) for step in steps)
    there, back, direct = _mean_gap(a, middle), _mean_gap(middle, b), _mean_gap(a, b)
    return {
        "share": there / (there + back),
        "detour": (there + back) / direct - 1,
        "length_outside_mm": MILLIMETRES * max(0.0, half - max(start, stop), min(start, stop) - half),
    }


def _vertices(groom: GroomSample) -> Float[Tensor, "s e 3"]:
    """Vertices but the root, from the root [m]."""
    features = groom.features.float()
    lengths = UNIT_LENGTH * features[:, SHAPE_CHANNELS].exp()
    return lengths[:, None, None] * features[:, 3:SHAPE_CHANNELS].unflatten(1, (EDGES_PER_STRAND, 3))


def _decoded(
    network: GroomAutoencoder, code: Float[Tensor, "1 16"], texels: Int[Tensor, " s"]
) -> tuple[float, Float[Tensor, "s e 3"]]:
    """Mean length of the strands, and their vertices from the root [m]."""
    decoded = network.decoder(code, torch.zeros_like(texels), texels)
    lengths = UNIT_LENGTH * decoded[:, SHAPE_CHANNELS].exp()
    shapes = decoded[:, 3:SHAPE_CHANNELS].unflatten(1, (EDGES_PER_STRAND, 3))
    return float(lengths.mean()), lengths[:, None, None] * shapes


def _mean_gap(first: Float[Tensor, "s e 3"], second: Float[Tensor, "s e 3"]) -> float:
    return float((first - second).norm(dim=-1).mean())


def _code(
    encoder: GroomEncoder, features: Float[Tensor, "s channels"], texels: Int[Tensor, " s"]
) -> Float[Tensor, "1 16"]:
    return encoder(texture_of(features, texels)[None])
