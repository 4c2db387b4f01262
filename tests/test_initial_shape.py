import torch
from torch.nn.functional import normalize

from quaffure.geometry import resolve_contact_reference
from quaffure.model import resolve_contact_twice
from quaffure.model.initial_shape import propagate_contact_force
from tests.test_mls_surface import ball

LENGTH = 0.05
OUT = torch.tensor([1.0, 0.0, 0.0])


def pushes(needs: list[float]) -> torch.Tensor:
    """Contact forces where each edge, pulled straight down, needs a force along x to stay out of the skin."""
    vectors = torch.tensor([0.0, 0.0, -2.0]).repeat(1, 1, len(needs), 1)
    needed = LENGTH * torch.tensor(needs)[:, None] * OUT
    # An edge of unit length has (u |w| - w) . x = need where its own x is need over |w|.
    across = needed / 2
    edges = across + torch.tensor([0.0, 0.0, -1.0]) * (1 - across.square().sum(-1, keepdim=True)).sqrt()
    normals = 0.3 * OUT.expand_as(vectors)
    return propagate_contact_force(vectors, edges[None, None], normals, torch.full((1, len(needs)), LENGTH))[0, 0]


def test_the_skin_at_the_tip_pushes_all_edges() -> None:
    torch.testing.assert_close(pushes([0.0, 0.0, 0.0, 7.0]), 7.0 * OUT.expand(4, 3))


def test_the_skin_only_pushes() -> None:
    torch.testing.assert_close(pushes([8.0, 5.0]), torch.tensor([8.0, 5.0])[:, None] * OUT)
    torch.testing.assert_close(pushes([5.0, 8.0]), torch.tensor([8.0, 8.0])[:, None] * OUT)
    assert pushes([0.0, 0.0]).abs().max() == 0


def test_pushes_from_two_sides_are_vectors() -> None:
    """Hair between two skins: the edge above is pushed back by its own as far as the one beyond pushes it too far."""
    vectors = torch.tensor([0.0, 0.0, -2.0]).repeat(1, 1, 2, 1)
    normals = torch.stack([-OUT, OUT])[None, None]
    across = LENGTH * torch.tensor([[-3.0], [5.0]]) * OUT / 2
    edges = across + torch.tensor([0.0, 0.0, -1.0]) * (1 - across.square().sum(-1, keepdim=True)).sqrt()
    pushed = propagate_contact_force(vectors, edges[None, None], normals, torch.full((1, 2), LENGTH))[0, 0]
    torch.testing.assert_close(pushed, torch.tensor([2.0, 5.0])[:, None] * OUT)


def test_a_push_counts_as_far_as_it_goes_the_normals_way() -> None:
    vectors = torch.tensor([0.0, 0.0, -2.0]).repeat(1, 1, 2, 1)
    aslant = normalize(torch.tensor([1.0, 1.0, 0.0]), dim=-1)
    normals = torch.stack([OUT, aslant])[None, None]
    across = LENGTH * torch.stack([6.0 * OUT, 4.0 * aslant]) / 2
    edges = across + torch.tensor([0.0, 0.0, -1.0]) * (1 - across.square().sum(-1, keepdim=True)).sqrt()
    above, tip = propagate_contact_force(vectors, edges[None, None], normals, torch.full((1, 2), LENGTH))[0, 0]
    torch.testing.assert_close(tip, 4.0 * aslant)
    torch.testing.assert_close(above, 4.0 * aslant + (6.0 - 4.0 * 0.5**0.5) * OUT)


def test_contact_resolved_twice_leaves_hair_on_a_shoulder_at_less_energy() -> None:
    """Next to a ball, edges above its rim are deflected too, where resolving once deflects those on it alone."""
    angle = torch.linspace(0, 6.28, 50)
    root = torch.stack([0.7 * angle.cos(), 0.7 * angle.sin(), torch.full((50,), 1.2)], dim=-1)[None]
    vectors = torch.tensor([0.0, 0.0, -1.5]).repeat(1, 50, 20, 1)
    vectors[..., :2] = 0.3 * normalize(root, dim=-1)[:, :, None, :2]
    lengths, margin = torch.full((50, 20), 0.05), torch.full((50, 21), 0.02)
    once, _ = resolve_contact_reference(root, vectors, lengths, margin, ball())
    twice, _ = resolve_contact_twice(root, vectors, lengths, margin, ball(), torch.arange(50), 0.3)
    ends = root[:, :, None] + (lengths[..., None] * twice).cumsum(2)
    assert ends.norm(dim=-1).min() > 0.99
    energy_once, energy_twice = (-(vectors * edges).sum((-1, -2)) for edges in (once, twice))
    assert (energy_twice < energy_once - 0.1).all()
