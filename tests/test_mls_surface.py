import torch
from torch.nn.functional import normalize

from quaffure.body import BodyModel, MlsBodyConfig
from quaffure.body.mls_body import mls_body
from quaffure.geometry import MlsSurface, posed_surface, resolve_contact_reference
from quaffure.geometry.mls_kernels import LEAF
from quaffure.geometry.mls_surface import local_features, local_features_reference
from quaffure.geometry.signed_distance import signed_distance

RADIUS = 0.3


def ball(count: int = 512) -> MlsSurface:
    """A unit ball of points spread along a spiral."""
    place = torch.arange(count) + 0.5
    height, turn = 1 - 2 * place / count, torch.pi * (1 + 5**0.5) * place
    rim = (1 - height.square()).sqrt()
    points = torch.stack([rim * turn.cos(), rim * turn.sin(), height], dim=-1)[None]
    return MlsSurface(points.unflatten(1, (-1, LEAF)), points.unflatten(1, (-1, LEAF)), RADIUS)


def strands(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Roots on the ball, edges that start outwards and then fall, and their lengths."""
    generator = torch.Generator().manual_seed(seed)
    root = normalize(torch.randn(1, count, 3, generator=generator), dim=-1)
    share = torch.linspace(0, 1, 12)[:, None]
    vectors = (1 - share) * root[:, :, None] + share * torch.tensor([0.0, 0.0, -2.0])
    return root, vectors, torch.full((count, 12), 0.08)


def test_views_tell_distance_and_normal_of_a_ball() -> None:
    directions = normalize(torch.randn(1, 200, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    for height in (-0.1, 0.0, 0.1):
        views = local_features_reference((1 + height) * directions, ball())
        known = views[..., 4]
        torch.testing.assert_close(RADIUS * views[..., 0] / known, torch.full((1, 200), height), atol=0.02, rtol=0)
        assert (normalize(views[..., 1:4], dim=-1) * directions).sum(-1).min() > 0.98
        assert known.min() > 0.9
    assert local_features_reference(1.5 * directions, ball()).abs().max() == 0


def test_views_change_without_jumps() -> None:
    """Along a line past the ball no step changes a view by much more than its neighbours do."""
    line = torch.linspace(-1.5, 1.5, 3001)[None, :, None] * torch.tensor([1.0, 0.3, 0.2]) + torch.tensor([0, 0.8, 0.3])
    views = local_features_reference(line, ball())
    assert views.diff(dim=1).abs().max() < 0.03
    assert views.abs().max() > 0.9


def test_compiled_views_are_those_of_the_twin() -> None:
    points = torch.randn(1, 2005, 3, generator=torch.Generator().manual_seed(0))
    points = points[:, points[0].norm(dim=-1).argsort()]
    views = local_features(points, ball())
    torch.testing.assert_close(views, local_features_reference(points, ball()), atol=1e-5, rtol=0)
    assert (views[..., 4] > 0.9).any()
    assert (views[..., 4] == 0).any()


def test_strands_leave_the_surface_and_change_nowhere_else() -> None:
    root, vectors, lengths = strands(300)
    margin = torch.full((300, 13), 0.02)
    edges, _ = resolve_contact_reference(root, vectors, lengths, margin, ball())
    ends = root[:, :, None] + (lengths[..., None] * edges).cumsum(2)
    merely = root[:, :, None] + (lengths[..., None] * normalize(vectors, dim=-1)).cumsum(2)
    assert (merely.norm(dim=-1) < 0.9).any()
    assert ends.norm(dim=-1).min() > 0.99
    free = merely.norm(dim=-1).amin(-1) > 1.05
    never = merely[..., 2].amin(-1) > 0
    assert (free & never).any()
    torch.testing.assert_close(ends[free & never], merely[free & never], atol=1e-5, rtol=0)


def test_a_contact_bends_a_strand_over_a_length() -> None:
    """Not to and fro at every vertex on the skin; and it returns to its own direction beyond."""
    root, lengths, margin = torch.tensor([[[0.05, 0.0, 1.12]]]), torch.full((1, 40), 0.02), torch.zeros(1, 41)
    down = torch.tensor([0.3, 0.0, -1.0]).expand(1, 1, 40, 3)
    bent = {}
    for decay_length in (0.0, 0.1):
        edges, _ = resolve_contact_reference(root, down, lengths, margin, ball(), decay_length)
        assert (root[:, :, None] + (lengths[..., None] * edges).cumsum(2)).norm(dim=-1).min() > 0.99
        bent[decay_length] = torch.acos((edges[:, :, 1:] * edges[:, :, :-1]).sum(-1).clamp(max=1)).square().sum()
    assert bent[0.1] < 0.3 * bent[0.0]

    past, down = torch.tensor([[[0.98, 0.0, 0.4]]]), torch.tensor([0.0, 0.0, -1.0])
    edges, _ = resolve_contact_reference(past, down.expand(1, 1, 40, 3), lengths, margin, ball(), 0.1)
    assert (edges[0, 0] - down).norm(dim=-1).max() > 0.1
    assert (edges[0, 0, -1] - down).norm() < 0.05


def test_the_point_sampled_body_is_the_body_to_a_centimetre(body: BodyModel) -> None:
    generator = torch.Generator().manual_seed(2)
    posed = body.pose(0.15 * torch.randn(1, 81, generator=generator), torch.randn(1, 10, generator=generator))
    surface = mls_body(body, posed, MlsBodyConfig())
    near = posed.vertices[:, ::7] + 0.01 * torch.randn(posed.vertices[:, ::7].shape, generator=generator)
    view = local_features_reference(near, surface)
    reached = view[..., 4] > 0.95
    assert reached.float().mean() > 0.3  # the rest are legs, and folds with few points
    exact = signed_distance(near, posed_surface(body.surface_topology, posed.vertices))
    gap = (surface.radius * view[..., 0] / view[..., 4] - exact)[reached].abs()
    assert gap.median() < 0.005
    assert gap.quantile(0.9) < 0.012
