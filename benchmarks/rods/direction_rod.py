"""The rod in edge directions (`quaffure.energies.rod`) against the heavy rod and against the theory of springs.

`python -m benchmarks.rods.direction_rod` prints its two tables of `docs/validation.md`.
"""

import math

import torch

from benchmarks.rods.rod_validation import Case, Curl, Strand, distances_mm, lumped_mass
from quaffure.config import STANDARD_GRAVITY
from quaffure.energies import TWISTING_STIFFNESS, energy_at_twist, stress_free_rest
from quaffure.energies.rod import BENDING_STIFFNESS, transported_normals
from quaffure.geometry import matrix_from_axis_angle
from quaffure.types import Float, Tensor

CASES = {
    "straight": Case(0.25),
    "curl": Case(0.25, curl=Curl()),
    "hanging curl": Case(0.25, -90.0, Curl()),
    "curl raised by 45 deg": Case(0.25, 45.0, Curl()),
}
LOADS = (0.1, 0.3, 1.0)
"""Shares of the weight under which a strand settles one after the other, as the heavy rod is solved."""
RIGID = 1e3
"""Multiple of GJ that stands for frames that can't twist."""
MOST_STEPS = 200
TOLERANCE = 1e-16
"""Largest component of the gradient at rest [J]; an edge of a centimetre lifts itself for 6e-9 J."""


class RotatedRod:
    """A strand as rotations of its edges from some directions and as twist angles, with derivatives, in float64.

    Attributes:
        rest: the rod's rest shape.
        rest_length: of every edge [m].
        weight: of every vertex [N].
    """

    def __init__(self, strand: Strand, twisting_stiffness: float) -> None:
        edges = strand.diff(dim=0)
        self.rest = stress_free_rest(strand[None], twist=twisting_stiffness)
        self.rest_length = edges.norm(dim=-1)
        self.rest_direction = torch.nn.functional.normalize(edges, dim=-1)
        self.weight = STANDARD_GRAVITY * lumped_mass(self.rest_length[None])[0]
        self.count = len(edges)
        self._beyond = self.weight[1:].flip(0).cumsum(0).flip(0) * self.rest_length

    def shape(self, unknowns: Float[Tensor, "b u"], around: Float[Tensor, "e 3"]) -> tuple[Tensor, Tensor]:
        """Directions and twist angles: two angles of rotation across each direction in `around`, then the twist."""
        turn, twist = unknowns[:, : 2 * self.count].unflatten(1, (-1, 2)), unknowns[:, 2 * self.count :]
        axis_angle = torch.einsum("bec,eci->bei", turn, torch.linalg.svd(around[:, None]).Vh[:, 1:])
        return torch.einsum("beij,ej->bei", matrix_from_axis_angle(axis_angle), around), twist

    def energy(self, unknowns: Float[Tensor, "b u"], around: Float[Tensor, "e 3"], load: float) -> Float[Tensor, " b"]:
        """The rod's energy and that of a share of its weight [J]."""
        direction, twist = self.shape(unknowns, around)
        rotation = torch.eye(3, dtype=torch.float64).expand(len(unknowns), 1, 3, 3)
        bent = energy_at_twist(direction[:, None], twist[:, None], self.rest, rotation)
        return bent + load * (self._beyond * direction[..., 2]).sum(-1)

    def derivatives(
        self, unknowns: Float[Tensor, " u"], around: Float[Tensor, "e 3"], load: float
    ) -> tuple[Float[Tensor, " u"], Float[Tensor, "u u"]]:
        """Gradient and Hessian of the energy [J], all columns in one batch."""
        copies = unknowns.expand(len(unknowns), -1).clone().requires_grad_()
        (gradient,) = torch.autograd.grad(self.energy(copies, around, load).sum(), copies, create_graph=True)
        (hessian,) = torch.autograd.grad(gradient.diagonal().sum(), copies)
        return gradient[0].detach(), hessian


def settle_directions(strand: Strand, twisting_stiffness: float = TWISTING_STIFFNESS) -> Strand:
    """The rod at rest under its own weight [m], by Newton's method with twist among the unknowns.

    Args:
        strand: vertices of the rest shape [m].
        twisting_stiffness: GJ [N m^2].

    Raises:
        ArithmeticError: not at rest after `MOST_STEPS`.
    """
    rod = RotatedRod(strand, twisting_stiffness)
    direction, twist = rod.rest_direction, torch.zeros(rod.count, dtype=torch.float64)
    for load in LOADS:
        direction, twist = _settle_under(rod, direction, twist, load)
    steps = rod.rest_length[:, None] * direction
    return torch.cat([strand[:1], strand[0] + steps.cumsum(0)])


def _settle_under(rod: RotatedRod, direction: Tensor, twist: Tensor, load: float) -> tuple[Tensor, Tensor]:
    shift = 0.0
    for _ in range(MOST_STEPS):
        start = torch.cat([torch.zeros(2 * rod.count, dtype=torch.float64), twist])
        gradient, hessian = rod.derivatives(start, direction, load)
        if float(gradient.abs().max()) < TOLERANCE:
            return direction, twist
        energy = float(rod.energy(start[None], direction, load))
        while True:
            factor, failed = torch.linalg.cholesky_ex(hessian + shift * torch.eye(len(hessian), dtype=torch.float64))
            if not failed:
                step = torch.cholesky_solve(-gradient[:, None], factor)[:, 0]
                reached = float(rod.energy((start + step)[None], direction, load))
                if float(step.abs().max()) < 1 and reached <= energy + 1e-14 * abs(energy):
                    break
            shift = max(4 * shift, 1e-4 * float(hessian.diagonal().mean()))
        shapes = rod.shape((start + step)[None], direction)
        direction, twist = torch.nn.functional.normalize(shapes[0][0], dim=-1), shapes[1][0]
        shift = shift / 8 if shift > 1e-9 * float(hessian.diagonal().mean()) else 0.0
    raise ArithmeticError(f"not at rest after {MOST_STEPS} steps: gradient {float(gradient.abs().max()):.2g} J")


def errors_mm(case: Case, vertices: int, twisting_stiffness: float = TWISTING_STIFFNESS) -> tuple[float, float]:
    """Distance from the heavy rod at the tip, and the largest [mm]."""
    error = distances_mm(settle_directions(case.strand(vertices), twisting_stiffness), case.true_shape(vertices))
    return float(error[-1]), float(error.max())


def spring_compliance(
    vertices: int, twisting_stiffness: float = TWISTING_STIFFNESS, length: float = 0.25
) -> tuple[float, float]:
    """How far a helix stretches under a small force along its axis, per force [m/N]: the rod's, and theory's.

    The force acts on a rigid lever from the last edge's material frame to the axis, as in
    `rod_validation.helix_compliance`. To first order the answer is f^T H^-1 f, H the energy's second derivative by
    rotations of edges and twist angles at rest, f the derivative of the lever's end along the axis.
    """
    curl = Curl()
    strand = Case(length, curl=curl).strand(vertices)
    rod = RotatedRod(strand, twisting_stiffness)
    axis = strand.new_tensor([1.0, 0.0, 0.0])
    to_axis = strand.new_tensor([0.0, curl.radius, 0.0]) - strand[-1] + axis * strand[-1, 0]
    root_frame, start = rod.rest.root_frame[0], torch.zeros(3 * rod.count, dtype=torch.float64)
    lever = _last_frame(rod.rest_direction, start[2 * rod.count :], root_frame).mT @ to_axis

    def along_axis(unknowns: Float[Tensor, " u"]) -> Tensor:
        """Where the lever's end is along the axis [m]."""
        directions, twists = rod.shape(unknowns[None], rod.rest_direction)
        tip = (rod.rest_length[:, None] * directions[0]).sum(0)
        return (tip + _last_frame(directions[0], twists[0], root_frame) @ lever) @ axis

    _, hessian = rod.derivatives(start, rod.rest_direction, 0.0)
    slope = torch.autograd.functional.jacobian(along_axis, start)
    covered = length * (1 - 0.5 / (vertices - 1))
    sine = curl.rise
    theory = curl.radius**2 * covered * ((1 - sine**2) / TWISTING_STIFFNESS + sine**2 / BENDING_STIFFNESS)
    return float(slope @ torch.linalg.solve(hessian, slope)), theory


def _last_frame(
    direction: Float[Tensor, "e 3"], twist: Float[Tensor, " e"], root_frame: Float[Tensor, "2 3"]
) -> Float[Tensor, "3 3"]:
    """Normal, binormal and tangent of the last edge's material frame, in columns."""
    tangent = direction[-1]
    normal = transported_normals(root_frame[0], root_frame[1], direction)[-1]
    binormal = torch.linalg.cross(tangent, normal)
    cosine, sine = twist[-1].cos(), twist[-1].sin()
    return torch.stack([cosine * normal + sine * binormal, cosine * binormal - sine * normal, tangent], dim=1)


def heavy_rod_table(counts: tuple[int, ...] = (12, 24, 48, 96)) -> list[str]:
    """Markdown: errors at the tip / at the worst vertex, with twist and with frames that can't twist."""
    rows = ["| 25 cm strand | " + " | ".join(f"N = {n}" for n in counts) + " | order | without twist, N = 24 |"]
    rows.append("| --- |" + " --- |" * (len(counts) + 2))
    for name, case in CASES.items():
        errors = [errors_mm(case, n) for n in counts]
        orders = [
            math.log(coarse[1] / fine[1]) / math.log((b - 1) / (a - 1))
            for coarse, fine, a, b in zip(errors, errors[1:], counts, counts[1:])
        ]
        rigid = errors_mm(case, 24, RIGID * TWISTING_STIFFNESS)
        shown = " | ".join(f"{tip:.2f} / {worst:.2f}" for tip, worst in (*errors,))
        rows.append(
            f"| {name} | {shown} | {', '.join(f'{order:.1f}' for order in orders)} | {rigid[0]:.2f} / {rigid[1]:.2f} |"
        )
    return rows


def spring_table(counts: tuple[int, ...] = (12, 24, 48, 96)) -> list[str]:
    """Markdown: stretch of a helix per force, with twist and with frames that can't twist."""
    rows = ["| N | stretch per force [m/N] | theory | ratio | ratio without twist |", "| --- |" + " --- |" * 4]
    for count in counts:
        found, theory = spring_compliance(count)
        rigid = spring_compliance(count, RIGID * TWISTING_STIFFNESS)[0]
        rows.append(f"| {count} | {found:.1f} | {theory:.1f} | {found / theory:.3f} | {rigid / theory:.3f} |")
    return rows


if __name__ == "__main__":
    print("\n".join([*heavy_rod_table(), "", *spring_table()]))
