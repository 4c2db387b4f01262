"""Where every solver stopped, by one measure.

The measure is the gradient of `HairEnergy` with respect to the vertices, roots fixed, without the part that tensions
along the edges could balance: what would still rotate edges if none could change its length. It is zero at a minimum
over vertices, and also at a minimum over directions, where lengths are at rest and the strand's weight pulls. The part
left out is below the precision of float32: a vertex 1.6 m from the origin is known to 0.1 um, for which Eq. 7 gives
forces of a tenth of a vertex's weight along the edge. `length_error_percent` shows that part.

At a concave edge of the body the energy's gradient jumps and vanishes nowhere. Hair rests in such edges, so the measure
does not fall to zero there.
"""

import torch

from quaffure.config import STANDARD_GRAVITY
from quaffure.draper import StoppingReport
from quaffure.energies.hair_energy import HairEnergy, Variables
from quaffure.scene import HairScene
from quaffure.types import Float, Positions, Tensor


def stopping_report(
    energy: HairEnergy,
    scene: HairScene,
    positions: Positions,
    iterations: int,
    seconds: float,
    variables: Variables | None = None,
) -> StoppingReport:
    """The report of a solver that ended at `positions` [m] after `seconds` of wall time."""
    total, gradient = energy_and_gradient(energy, scene, positions, variables)
    worst = float(relative_gradient(energy, positions, gradient).max())
    return StoppingReport(float(total.mean()), worst, iterations, seconds)


def energy_and_gradient(
    energy: HairEnergy, scene: HairScene, positions: Positions, variables: Variables | None = None
) -> tuple[Float[Tensor, " b"], Positions]:
    """Energy of every sample [J] and its gradient [N], zero at the roots."""
    x = positions.detach().clone().requires_grad_()
    total = energy.total(x, scene, variables)
    (gradient,) = torch.autograd.grad(total.sum(), x)
    gradient[:, :, 0] = 0
    return total.detach(), gradient


def relative_gradient(energy: HairEnergy, positions: Positions, gradient: Positions) -> Float[Tensor, " b"]:
    """Norm of the gradient without what tensions balance, over the norm of that of the weight on earth, which gravity
    that is tilted or missing leaves as it is."""
    weights = STANDARD_GRAVITY * energy.rest.mass[:, 1:].norm()
    return without_tensions(positions, gradient).flatten(1).norm(dim=1) / weights


def without_tensions(positions: Positions, gradient: Positions) -> Positions:
    """The gradient [N], zero at the roots, less the part that tensions along the edges balance best.

    Tensions T give the vertices J^T T with (J g)_e = t_e (g_{e+1} - g_e), t the unit edges and the root fixed. The
    least squares problem J J^T T = J g is tridiagonal: 2 on its diagonal (1 at the root), -t_e t_{e+1} off it. It is
    positive definite for any strand, folded ones too.
    """
    tangent = torch.nn.functional.normalize(positions.diff(dim=2), dim=-1).double()
    free = gradient.double().clone()
    free[:, :, 0] = 0
    off_diagonal = -(tangent[:, :, 1:] * tangent[:, :, :-1]).sum(-1)
    matrix = torch.diag_embed(off_diagonal, 1) + torch.diag_embed(off_diagonal, -1)
    matrix.diagonal(dim1=-2, dim2=-1).fill_(2)
    matrix[..., 0, 0] = 1
    tension = torch.linalg.solve(matrix, (tangent * free.diff(dim=2)).sum(-1))
    pull = tension[..., None] * tangent
    free[:, :, 1:] -= pull
    free[:, :, 1:-1] += pull[:, :, 1:]
    return free.to(gradient.dtype)
