import torch

from benchmarks.rods.closed_form import equilibrium_edges
from quaffure import HairMaterial
from quaffure.energies import energy_gravity, energy_stretch, energy_stretch_shear, equilibrium_vectors
from quaffure.energies.rest_state import rest_state
from quaffure.geometry import directors
from tests.scenes import strands_round_sphere


def gradient_of_edges(edges: torch.Tensor, k_stretch: float) -> torch.Tensor:
    """Gradient of Eqs. 6, 7 and 9 with respect to the edges [N], and the scale of its terms."""
    material = HairMaterial()
    posed = strands_round_sphere().double()
    rest = rest_state(posed, material)
    edges = edges.detach().requires_grad_()
    x = torch.cat([posed[None, :, :1], posed[None, :, :1] + edges.cumsum(2)], dim=2)
    energy = energy_stretch_shear(x, directors(posed[None]), rest.rest_length, material.k_cosserat)
    energy = energy + energy_stretch(x, rest.rest_length, k_stretch) + energy_gravity(x, rest.mass)
    return torch.autograd.grad(energy.sum(), edges)[0]


def sagged(k_stretch: float) -> torch.Tensor:
    material = HairMaterial()
    posed = strands_round_sphere().double()
    rest = rest_state(posed, material)
    return equilibrium_edges(directors(posed[None]), rest.rest_length, rest.mass_beyond, material.k_cosserat, k_stretch)


def test_closed_form_has_no_gradient_and_its_neighbourhood_has() -> None:
    for k_stretch in (0.0, 1.0):
        edges = sagged(k_stretch)
        scale = gradient_of_edges(edges * 1.01, k_stretch).norm()
        assert scale > 1e-6
        assert gradient_of_edges(edges, k_stretch).norm() < 1e-9 * scale


def test_directions_of_the_closed_form_feel_only_a_force_along_themselves() -> None:
    material = HairMaterial()
    posed = strands_round_sphere().double()
    rest = rest_state(posed, material)
    vectors = equilibrium_vectors(directors(posed[None]), rest.rest_length, rest.mass_beyond, material.k_cosserat)
    along = torch.nn.functional.normalize(vectors, dim=-1)
    gradient = gradient_of_edges(rest.rest_length[..., None] * along, 1.0)
    across = gradient - (gradient * along).sum(-1, keepdim=True) * along
    assert gradient.norm() > 1e-6
    assert across.norm() < 1e-9 * gradient.norm()
