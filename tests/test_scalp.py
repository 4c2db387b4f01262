"""The scalp chart: a disc, unrolled one to one, symmetric, on the head where hair grows."""

import numpy as np
import pytest
import torch

from quaffure.body import BodyModel, ScalpChart, load_body
from quaffure.body.scalp import texel_index


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return load_body()


@pytest.fixture(scope="module")
def chart(body: BodyModel) -> ScalpChart:
    return body.scalp


def _signed_areas(uv: torch.Tensor) -> torch.Tensor:
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _rim_edges(triangles: torch.Tensor) -> np.ndarray:
    """Directed edges without their opposite, of triangles that share each directed edge never."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    present = {(a, b) for a, b in edges}
    assert len(present) == len(edges)
    return np.array([(a, b) for a, b in present if (b, a) not in present])


def _containing(chart: ScalpChart, points: torch.Tensor) -> torch.Tensor:
    """How many triangles hold each point strictly inside; the plain twin of `locate`."""
    a, b, c = chart.uv.double().unbind(1)
    points = points.double()[:, None]

    def side(start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
        edge, offset = end - start, points - start
        return edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0]

    return ((side(a, b) > 1e-9) & (side(b, c) > 1e-9) & (side(c, a) > 1e-9)).sum(1)


def test_scalp_is_a_disc(body: BodyModel, chart: ScalpChart) -> None:
    triangles = body.faces[chart.faces]
    assert len(chart.faces.unique()) == len(chart.faces)
    rim = _rim_edges(triangles)
    edges = (3 * len(triangles) + len(rim)) // 2
    assert len(triangles.unique()) - edges + len(triangles) == 1
    following = dict(rim.tolist())
    assert len(following) == len(rim)  # no vertex is passed twice
    vertex, steps = following[rim[0, 0]], 1
    while vertex != rim[0, 0]:
        vertex, steps = following[vertex], steps + 1
    assert steps == len(rim)  # one loop


def test_corners_of_one_vertex_share_their_uv(body: BodyModel, chart: ScalpChart) -> None:
    vertices, index = body.faces[chart.faces].unique(return_inverse=True)
    low = torch.full((len(vertices), 2), 2.0).scatter_reduce(
        0, index.reshape(-1, 1).expand(-1, 2), chart.uv.reshape(-1, 2), "amin"
    )
    torch.testing.assert_close(low[index], chart.uv)


def test_chart_is_injective(chart: ScalpChart) -> None:
    assert (_signed_areas(chart.uv) > 1e-6).all()
    points = torch.rand(20_000, 2, generator=torch.Generator().manual_seed(0))
    assert _containing(chart, points).max() == 1
    assert chart.uv.min() >= 0
    assert chart.uv.max() <= 1


def test_chart_covers_most_texels_evenly(body: BodyModel, chart: ScalpChart) -> None:
    centres = (torch.arange(64) + 0.5) / 64
    v, u = torch.meshgrid(centres, centres, indexing="ij")
    mask = chart.locate(torch.stack([u, v], dim=-1).flatten(0, 1))[0] >= 0
    assert mask.float().mean() >= 0.6
    a, b, c = body.rest_vertices[body.faces[chart.faces]].unbind(1)
    surface = 0.5 * torch.linalg.cross(b - a, c - a).norm(dim=-1)
    stretch = _signed_areas(chart.uv) / surface
    stretch = stretch / (stretch * surface).sum() * surface.sum()
    assert stretch.min() > 0.25
    assert stretch.max() < 4


def test_locate_agrees_with_the_plain_search(chart: ScalpChart) -> None:
    points = torch.rand(5_000, 2, generator=torch.Generator().manual_seed(1)) * 1.2 - 0.1
    face, barycentric = chart.locate(points)
    assert torch.equal(face >= 0, _containing(chart, points) > 0)
    found = face >= 0
    torch.testing.assert_close(chart.uv_at(face[found], barycentric[found]), points[found], atol=1e-5, rtol=0)
    assert (barycentric[~found] == 0).all()


def test_locate_undoes_uv_at(chart: ScalpChart) -> None:
    generator = torch.Generator().manual_seed(2)
    index = torch.randint(len(chart.faces), (2_000,), generator=generator)
    barycentric = torch.rand(2_000, 3, generator=generator) + 0.02
    barycentric = barycentric / barycentric.sum(-1, keepdim=True)
    face, found = chart.locate(chart.uv_at(chart.faces[index], barycentric))
    assert torch.equal(face, chart.faces[index])
    torch.testing.assert_close(found, barycentric, atol=2e-4, rtol=0)


def test_no_point_falls_between_triangles(chart: ScalpChart) -> None:
    """Corners and midpoints of edges, the rim's too, are on the chart."""
    midpoints = 0.5 * (chart.uv + chart.uv.roll(1, dims=1))
    assert (chart.locate(torch.cat([chart.uv, midpoints]).reshape(-1, 2))[0] >= 0).all()


def test_faces_off_the_scalp_have_no_uv(body: BodyModel, chart: ScalpChart) -> None:
    outside = torch.tensor([face for face in range(2_000) if face not in set(chart.faces.tolist())][:3])
    with pytest.raises(ValueError, match="3 of 3 off it"):
        chart.uv_at(outside, torch.full((3, 3), 1 / 3))


def test_u_runs_to_the_left_and_v_to_the_back_symmetrically(body: BodyModel, chart: ScalpChart) -> None:
    centre = body.rest_vertices[body.faces[chart.faces]].mean(1)
    uv = chart.uv.mean(1)
    assert torch.corrcoef(torch.stack([centre[:, 0], uv[:, 0]]))[0, 1] > 0.8
    assert torch.corrcoef(torch.stack([centre[:, 1], uv[:, 1]]))[0, 1] > 0.8
    corners = body.rest_vertices[body.faces[chart.faces]].reshape(-1, 3)
    distance = torch.cdist(corners * torch.tensor([-1.0, 1.0, 1.0]), corners)
    mirrored = chart.uv.reshape(-1, 2)[distance.argmin(1)] * torch.tensor([-1.0, 1.0]) + torch.tensor([1.0, 0.0])
    torch.testing.assert_close(mirrored, chart.uv.reshape(-1, 2), atol=1e-5, rtol=0)


def test_hair_grows_on_the_head_but_not_on_ears_or_face(body: BodyModel, chart: ScalpChart) -> None:
    vertices = body.faces[chart.faces].unique()
    assert not torch.isin(vertices, body.ear_vertices).any()
    points = body.rest_vertices[vertices]
    top = body.rest_vertices[:, 2].argmax()
    assert top in vertices
    head = body.rest_vertices[body.rest_vertices[:, 2] > points[:, 2].min()]
    front = points[points[:, 0].abs() < 0.03]
    forehead = front[front[:, 1] < -0.12][:, 2].min()
    assert body.rest_vertices[top, 2] - forehead < 0.05
    assert head[:, 1].min() < points[:, 1].min() - 0.02  # the nose lies well before the hairline


def test_texels_take_rows_from_v_and_columns_from_u() -> None:
    uv = torch.tensor([[0.0, 0.999], [1.0, 0.0], [0.51, 0.26]])
    assert texel_index(uv, size=4).tolist() == [4 * 3 + 0, 4 * 0 + 3, 4 * 1 + 2]
