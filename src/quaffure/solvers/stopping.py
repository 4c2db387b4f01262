"""Where every solver stopped, by one measure; only `newton` stops by, and reports, one of its own.

The measure is the gradient of `HairEnergy` with respect to the vertices, roots held, without the part that tensions
along the edges could balance: what would still turn edges if none could change its length. At a minimum over vertices
it is zero, and at a minimum over directions too, though lengths are at rest there and the strand's weight pulls. What
it leaves out float32 would drown: a vertex 1.6 m from the origin is known to 0.1 um, which Eq. 7 turns into forces of
a tenth of a vertex's weight, along the edge. `length_error_percent` shows what is left there.

At a crease of the body the exact energy's gradient jumps and vanishes nowhere, and hair rests in creases. `newton`
takes the whole gradient of the energy with rounded creases instead, in double precision
(`quaffure.solvers.newton.rounded_contact`).
"""

import torch

from quaffure.config import STANDARD_GRAVITY
from quaffure.draper import StoppingReport
from quaffure.energies.elastic_model import Unknowns
from quaffure.energies.hair_energy import HairEnergy
from quaffure.scene import Scene
from quaffure.types import Float, Positions, Tensor


def stopping_report(
    energy: HairEnergy,
    scene: Scene,
    positions: Positions,
    iterations: int,
    seconds: float,
    unknowns: Unknowns | None = None,
) -> StoppingReport:
    """The report of a solver that ended at `positions` [m] after `seconds` of wall time."""
    total, gradient = energy_and_gradient(energy, scene, positions, unknowns)
    worst = float(relative_gradient(energy, positions, gradient).max())
    return StoppingReport(float(total.mean()), worst, iterations, seconds)


def energy_and_gradient(
    energy: HairEnergy, scene: Scene, positions: Positions, unknowns: Unknowns | None = None
) -> tuple[Float[Tensor, " b"], Positions]:
    """Energy of every sample [J] and its gradient [N], zero at the roots."""
    x = positions.detach().clone().requires_grad_()
    held = None if unknowns is None else unknowns.detach()
    total = energy.total(x, scene.director, scene.surface, held)
    (gradient,) = torch.autograd.grad(total.sum(), x)
    gradient[:, :, 0] = 0
    return total.detach(), gradient


def relative_gradient(energy: HairEnergy, positions: Positions, gradient: Positions) -> Float[Tensor, " b"]:
    """Norm of the gradient without what tensions balance, over the norm of gravity's whole gradient."""
    weights = STANDARD_GRAVITY * energy.rest.mass[:, 1:].norm()
    return without_tensions(positions, gradient).flatten(1).norm(dim=1) / weights


def without_tensions(positions: Positions, gradient: Positions) -> Positions:
    """The gradient [N], zero at the roots, less the part that tensions along the edges balance best.

    Tensions T give the vertices J^T T with (J g)_e = t_e (g_{e+1} - g_e), t the unit edges and the root held. The
    least squares problem J J^T T = J g is tridiagonal: 2 on its diagonal (1 at the root), -t_e t_{e+1} beside it.
    """
    tangent = torch.nn.functional.normalize(positions.diff(dim=2), dim=-1).double()
    free = gradient.double().clone()
    free[:, :, 0] = 0
    tension = _chain_solve((tangent * free.diff(dim=2)).sum(-1), -(tangent[:, :, 1:] * tangent[:, :, :-1]).sum(-1))
    pull = tension[..., None] * tangent
    free[:, :, 1:] -= pull
    free[:, :, 1:-1] += pull[:, :, 1:]
    return free.to(gradient.dtype)


def _chain_solve(right: Float[Tensor, "b s e"], beside: Float[Tensor, "b s m"]) -> Float[Tensor, "b s e"]:
    """Solve the symmetric tridiagonal systems with 1, 2, 2, ... on the diagonal (Thomas' algorithm)."""
    pivots, values = [torch.ones_like(right[..., 0])], [right[..., 0]]
    for edge in range(1, right.shape[-1]):
        share = beside[..., edge - 1] / pivots[-1]
        # Straight strands leave a last pivot of 1 or more; the floor keeps a folded one finite.
        pivots.append((2 - share * beside[..., edge - 1]).clamp(min=1e-12))
        values.append(right[..., edge] - share * values[-1])
    solved = [values[-1] / pivots[-1]]
    for edge in range(right.shape[-1] - 2, -1, -1):
        solved.append((values[edge] - beside[..., edge] * solved[-1]) / pivots[edge])
    return torch.stack(solved[::-1], dim=-1)
