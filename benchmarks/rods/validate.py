"""Compare the elastic models with theory: `python -m benchmarks.rods.validate` writes docs/validation.md and its plots.

To be run from the root of the repository. Every number of the page comes from this run, about five minutes on one core.
Needs the `docs` extra (matplotlib).
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.rods.direction_rod import heavy_rod_table, settle_directions, spring_table
from benchmarks.rods.elastic_potentials import cosserat, mass_spring, modified_cosserat
from benchmarks.rods.heavy_rod import REAL_HAIR_WEIGHT, HeavyRod
from benchmarks.rods.rod_newton import Settled
from benchmarks.rods.rod_validation import (
    Case,
    Curl,
    Sphere,
    above_plane,
    best_k_cosserat,
    closed_form_difference_mm,
    depths_in_margin,
    helix_compliance,
    modified_error_mm,
    resting_depth,
    rms_mm,
    rod_errors,
    sagged_strand,
    settle_in_contact,
    settle_rod,
    settle_under_weight,
    stretch_percent,
)
from quaffure.config import HairMaterial
from quaffure.energies import RodStiffness
from quaffure.io import replacing

mpl.use("Agg")
N = 24
MATERIAL = HairMaterial()
CURL = Curl()
STRAIGHT, CURLY, HANGING_CURL = Case(0.25), Case(0.25, curl=CURL), Case(0.25, -90.0, CURL)
LENGTHS = (0.05, 0.10, 0.25, 0.40)
ROD = HeavyRod(1.0)

INTRODUCTION = f"""# How the elastic models compare with theory

Written by `python -m benchmarks.rods.validate`; do not edit. `tests/test_rod_validation.py` holds the same comparisons.

One hair, alone, clamped at its root: EI = {ROD.bend:.1e} N m^2, GJ = EI / {ROD.bend / ROD.twist:.2f}, weight
{REAL_HAIR_WEIGHT:.1e} N/m. Curls are helices of {1000 * CURL.radius:.0f} mm radius and
{1000 * CURL.pitch:.0f} mm pitch. Lengths are along the strand. "Horizontal" is how the strand, or the axis of the
curl, would leave the clamp without weight; positions are (x, y, z) with z up. N is the number of vertices, {N} where
none is given. Errors over a strand are root mean squares over its vertices. The truth is Kirchhoff's inextensible
rod, a boundary-value problem (`benchmarks.rods.heavy_rod`, scipy's `solve_bvp`), which shares no code with the
energies; a test holds to it what PyElastica found.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "docs")
    docs = parser.parse_args().out
    figures = docs / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    rods, forces = (convergence, helix_spring, direction_rod), (contact, deflection, stretch)
    sections = (*rods, closed_form, stick_out, situations, models, *forces)
    page = "\n".join([INTRODUCTION, *(section(figures) for section in sections)])
    with replacing(docs / "validation.md") as path:
        path.write_text(page, encoding="utf-8")


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines) + "\n"


def save(figure: Figure, path: Path, caption: str) -> str:
    """Write a small picture of 64 colours; returns the line of Markdown that shows it."""
    figure.tight_layout()
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
    plt.close(figure)
    with replacing(path) as temporary:
        Image.fromarray(pixels.copy()).quantize(64).save(temporary, optimize=True)
    return f"\n![{caption}](figures/{path.name})\n"


def point(strand: np.ndarray) -> str:
    x, y, z = 1000 * np.asarray(strand)[-1]
    return f"({x:.1f}, {y:.1f}, {z:.1f})"


def convergence(figures: Path) -> str:
    counts = (12, 24, 47, 93)
    figure, axes = plt.subplots(figsize=(5, 3.4), dpi=90)
    rows = []
    for name, case in (("straight", STRAIGHT), ("curl", CURLY), ("hanging curl", HANGING_CURL)):
        tips, worst = np.array([rod_errors(case, count) for count in counts]).T
        order = np.log2(worst[:-1] / worst[1:])
        axes.loglog(np.array(counts) - 1, worst, "o-", label=name)
        measured = [f"{t:.2f} / {w:.2f}" for t, w in zip(tips, worst)]
        rows.append([name, point(case.true_shape(2)), *measured, ", ".join(f"{o:.1f}" for o in order)])
    axes.loglog([11, 92], [10, 10 * (11 / 92) ** 2], "k:", label="second order")
    axes.set(xlabel="edges", ylabel="largest error [mm]")
    axes.legend()
    header = ["25 cm strand", "true tip [mm]", *(f"N = {count}" for count in counts), "order"]
    return (
        "## The full Cosserat rod (Eqs. 2-5) converges to the heavy rod\n\nErrors [mm] at the tip / at the worst"
        " vertex."
        " The scalp's frame clamps the first edge over half its length; order is that of the worst vertex.\n\n"
        + table(header, rows)
        + save(figure, figures / "convergence.png", "Error of the full Cosserat rod against the number of edges")
    )


def helix_spring(_: Path) -> str:
    rows = []
    for count in (12, 24, 47, 93):
        measured, theory = helix_compliance(count)
        rows.append([count, f"{measured:.1f}", f"{theory:.1f}", f"{100 * (measured / theory - 1):+.2f} %"])
    return (
        "## A helix under a force along its axis\n\nBending and twisting at once: Castigliano's radius^2 length"
        " (cos^2/GJ"
        " + sin^2/EI) for small forces, the length without the last half edge, which no pair bends.\n\n"
        + table(["N", "stretch per force [m/N]", "theory", "error"], rows)
    )


def direction_rod(_: Path) -> str:
    return (
        "## The rod in edge directions (`rod`) converges too\n\nThe elastic model `rod` (`quaffure.energies.rod`), with"
        " the same EI and GJ. Errors [mm] at the tip / at the worst vertex; order is that of the worst vertex. The last"
        " column is a rod whose frames can't twist. `python -m benchmarks.rods.direction_rod` prints both tables.\n\n"
        + "\n".join(heavy_rod_table())
        + "\n\nThe helix under a force along its axis: with few vertices the rod is too stiff a spring, and without"
        " twist it is at every number of vertices.\n\n" + "\n".join(spring_table()) + "\n"
    )


def closed_form(_: Path) -> str:
    cases = (("straight, 25 cm", STRAIGHT), ("curl, 25 cm", CURLY), ("straight, 40 cm, raised 60 deg", Case(0.4, 60.0)))
    rows = [[name, f"{closed_form_difference_mm(case, N, MATERIAL):.1e}"] for name, case in cases]
    return (
        "## The modified energy (Eqs. 6-8) settles into its closed form\n\nNewton's method against"
        " `quaffure.energies.closed_form`: the two derivations agree to what the solver leaves.\n\n"
        + table(["strand", "largest distance [mm]"], rows)
    )


def stick_out(figures: Path) -> str:
    cases = [Case(length) for length in LENGTHS]
    truths = [case.true_shape(N) for case in cases]
    rows, fits = [], [best_k_cosserat([case], N, [truth]) for case, truth in zip(cases, truths)]
    for case, truth, fit in zip(cases, truths, fits):
        row: list[object] = [f"{100 * case.length:.0f}", point(truth)]
        for k in (MATERIAL.k_cosserat, fit):
            strand = sagged_strand(case.strand(N), HairMaterial(k_cosserat=k)).numpy()
            row += [point(strand), f"{rms_mm(strand, truth):.1f}"]
        rows.append([*row, f"{fit:.1e}", f"{4 * ROD.bend / (case.length * (N - 1)):.1e}"])
    shared = best_k_cosserat(cases, N, truths)
    errors = [f"{modified_error_mm(case, shared, N, truth):.1f}" for case, truth in zip(cases, truths)]
    upright = (7.8373 * ROD.bend / REAL_HAIR_WEIGHT) ** (1 / 3)
    folds = math.sqrt(MATERIAL.k_cosserat * (N - 1) / REAL_HAIR_WEIGHT)
    header = ["length [cm]", "true tip [mm]", "default tip", "error [mm]", "tip at best k", "error [mm]"]
    return (
        "## The modified energy is no rod: stick-out of horizontal hair\n\nIts edges do not know of each other: at"
        " rest an"
        " edge leans by tan(angle) = (weight beyond it) l / k from its posed direction, wherever its neighbours point."
        f" Default k_Cosserat = {MATERIAL.k_cosserat:.1e} J.\n\n"
        + table([*header, "best k [J]", "stiff limit [J]"], rows)
        + f"\nOne k for all four: {shared:.2e} J, with errors of {', '.join(errors)} mm. The stiff limit 4 EI /"
        f" (length x"
        " edges) gives a short strand the small droop of a beam; a long one bends within a few centimetres of its"
        " root and"
        " hangs, which no k does. Eq. 6 as printed also depends on the edges: k / l is the force that turns an edge"
        " by 45"
        " degrees, so that with one k twice the vertices make hair twice as stiff.\n\n"
        f"Upright hair tips over at (7.84 EI / w)^(1/3) = {100 * upright:.1f} cm (Greenhill). With the default k and"
        f" {N}"
        f" vertices an edge of the modified energy folds over once more than k / l hangs on it: from"
        f" {100 * folds:.0f} cm on.\n" + _stick_out_figure(figures, cases, truths, fits)
    )


def _stick_out_figure(figures: Path, cases: list[Case], truths: list[np.ndarray], fits: list[float]) -> str:
    figure, (shapes, sweep) = plt.subplots(1, 2, figsize=(8.6, 4), dpi=80)
    ks = np.geomspace(2e-9, 1e-6, 40)
    for number, (case, truth, fit) in enumerate(zip(cases, truths, fits)):
        colour = f"C{number}"
        for k, style in ((None, "-"), (MATERIAL.k_cosserat, ":"), (fit, "--")):
            strand = truth if k is None else sagged_strand(case.strand(N), HairMaterial(k_cosserat=k)).numpy()
            shapes.plot(100 * strand[:, 0], 100 * strand[:, 2], style, color=colour)
        errors = [100 * modified_error_mm(case, k, N, truth) / (1000 * case.length) for k in ks]
        sweep.semilogx(ks, errors, color=colour, label=f"{100 * case.length:.0f} cm")
    shapes.set(
        xlabel="x [cm]", ylabel="z [cm]", title="rod (solid), default k (dotted), best k (dashed)", aspect="equal"
    )
    sweep.axvline(MATERIAL.k_cosserat, color="grey", linestyle=":")
    sweep.set(xlabel="k_Cosserat [J]", ylabel="error [% of length]")
    sweep.legend()
    return save(figure, figures / "stick_out.png", "Horizontal hair: true rod and modified energy")


def situations(figures: Path) -> str:
    figure, panels = plt.subplots(1, 3, figsize=(8.6, 3.8), dpi=80)
    shown = {("straight", 45.0): panels[0], ("curl", 0.0): panels[1], ("curl", -90.0): panels[2]}
    rows = []
    for name, curl, elevations in (
        ("straight", None, (80.0, 45.0, 0.0, -45.0)),
        ("curl", CURL, (45.0, 0.0, -45.0, -90.0)),
    ):
        for elevation in elevations:
            case = Case(0.25, elevation, curl)
            truth, default = case.true_shape(N), sagged_strand(case.strand(N), MATERIAL).numpy()
            fit = best_k_cosserat([case], N, [truth])
            errors = [f"{modified_error_mm(case, k, N, truth):.1f}" for k in (MATERIAL.k_cosserat, fit)]
            rows.append([name, f"{elevation:+.0f}", point(truth), point(default), errors[0], f"{fit:.1e}", errors[1]])
            if (name, elevation) in shown:
                fine = 100 * case.true_shape(200)
                axes = shown[name, elevation]
                axes.plot(fine[:, 0], fine[:, 2], label="rod")
                axes.plot(100 * default[:, 0], 100 * default[:, 2], ".:", label="modified")
                axes.set(aspect="equal", title=f"{name}, {elevation:+.0f} deg", xlabel="x [cm]", ylabel="z [cm]")
                axes.set_xlim(min(axes.get_xlim()[0], -4), max(axes.get_xlim()[1], 5))
    panels[0].legend(fontsize=7)
    header = ["25 cm", "elevation [deg]", "true tip [mm]", "default tip", "error [mm]", "best k [J]", "error [mm]"]
    return (
        "## In which situations it differs\n\n"
        + table(header, rows)
        + "\nThe shapes are of another kind. A rod holds its direction at the clamp and hangs beyond; the modified"
        " strand"
        " leans most at its root, where most weight pulls, and turns back to its posed direction towards the tip. A"
        " curl"
        " that hangs needs tens of times the k of straight hair that sticks out: its edges lean one by one and the coil"
        " opens, where a rod would have to twist. A k that keeps curls makes long straight hair stick out, and the"
        " reverse; any one k is a compromise. Straight hair that hangs is exact with any k.\n"
        + save(figure, figures / "situations.png", "True rod and modified energy in three situations")
    )


def models(_: Path) -> str:
    rows = []
    short = (("straight, 5 cm", Case(0.05)), ("straight, 10 cm", Case(0.10)))
    long = (("straight, 25 cm", STRAIGHT), ("curl, 25 cm", CURLY), ("hanging curl, 25 cm", HANGING_CURL))
    for name, case in (*short, *long):
        truth, strand = case.true_shape(N), case.strand(N)
        settled = (
            settle_rod(strand, RodStiffness()),
            settle_under_weight(modified_cosserat(MATERIAL), strand),
            settle_under_weight(mass_spring(), strand, reach=3),
        )
        shapes = (settled[0].positions, settle_directions(strand), *(s.positions for s in settled[1:]))
        cells = [f"{point(shape.numpy())}, {rms_mm(shape, truth):.1f}" for shape in shapes]
        rows.append([name, point(truth), *cells])
    header = ["strand", "truth", "`cosserat`", "`rod`", "`modified_cosserat`", "`mass_spring`"]
    return (
        "## The elastic models on the same strands\n\nTip [mm], error over the strand [mm]; each with its default"
        " stiffness. Springs resist the bending of straight hair with the cube of the angle only: short hair droops too"
        " much, long hair would hang anyway. Curls open.\n\n" + table(header, rows)
    )


def contact(figures: Path) -> str:
    ball, weight = Sphere((0.0, 0.0, -0.1), 0.1), REAL_HAIR_WEIGHT * STRAIGHT.length / (N - 1)
    rows, ks = [], np.geomspace(0.1, 1000, 5)
    for k in ks:
        material = HairMaterial(k_body_collision=k)
        theory = resting_depth(k, weight)
        strand = STRAIGHT.strand(N)
        strand[:, 2] += material.collision_margin - theory
        plane = float(depths_in_margin(strand, above_plane, material)[5])
        rows.append((k, 1000 * theory, 1000 * plane, 1000 * float(depths_in_margin(strand, ball, material).max())))
    figure, axes = plt.subplots(figsize=(5, 3.2), dpi=90)
    _, theory_mm, plane_mm, ball_mm = np.array(rows).T
    axes.loglog(ks, theory_mm, "k:", label="sqrt(w / 3k)")
    axes.loglog(ks, plane_mm, "o", label="plane")
    axes.loglog(ks, ball_mm, "s-", label="ball of 10 cm")
    axes.axhline(1000 * MATERIAL.collision_margin, color="grey", label="margin D")
    axes.set(xlabel="k_body_collision [J/m^3]", ylabel="depth in the margin [mm]")
    axes.legend(fontsize=8)
    header = ["k_body_collision [J/m^3]", "theory [mm]", "on a plane [mm]", "over a ball, deepest [mm]"]
    cells = [[f"{k:g}", *(f"{depth:.4f}" for depth in depths)] for k, *depths in rows]
    return (
        "## Contact stiffness and penetration (Eq. 10)\n\nHow deep vertices of a 25 cm strand lie in the margin D ="
        f" {1000 * MATERIAL.collision_margin:.0f} mm at rest. Where the body alone carries a vertex, 3 k (D - d)^2"
        f" is its"
        " weight. Over a ball of 10 cm radius the strand's end hangs free and pulls the contact tighter. The skin is"
        f" reached at D; the default k is {MATERIAL.k_body_collision:g}.\n\n"
        + table(header, cells)
        + save(figure, figures / "contact.png", "Depth in the margin against contact stiffness")
    )


def deflection(figures: Path) -> str:
    """A hanging strand pushed aside by a ball: what a shoulder does to hair."""
    hanging, ball = Case(0.25, -90.0), Sphere((-0.01, 0.0, -0.10), 0.03)
    strand = hanging.strand(N)
    settled: dict[str, Settled] = {
        name: settle_in_contact(model, strand, ball, MATERIAL)
        for name, model in (("cosserat", cosserat()), ("modified_cosserat", modified_cosserat(MATERIAL)))
    }
    figure, axes = plt.subplots(figsize=(3.2, 4), dpi=80)
    axes.add_patch(plt.Circle((100 * ball.centre[0], 100 * ball.centre[2]), 100 * ball.radius, color="lightgrey"))
    rows = []
    for name, rest in settled.items():
        x = 100 * rest.positions.numpy()
        axes.plot(x[:, 0], x[:, 2], ".-", label=name, markersize=3)
        lean = [math.degrees(math.atan2(dx, -dz)) for dx, _, dz in np.diff(x, axis=0)[[0, -1]]]
        rows.append(
            [
                f"`{name}`",
                f"{10 * x[:, 0].max():.1f}",
                f"{10 * x[-1, 0]:.1f}",
                *(f"{round(a, 1) + 0.0:.1f}" for a in lean),
            ]
        )
    axes.set(aspect="equal", xlabel="x [cm]", ylabel="z [cm]", xlim=(-6, 9))
    axes.legend(fontsize=7, loc="upper right")
    gap = rms_mm(settled["cosserat"].positions, settled["modified_cosserat"].positions)
    header = ["model", "furthest out [mm]", "tip x [mm]", "first edge leans [deg]", "last edge leans [deg]"]
    return (
        "## Hair pushed aside\n\nA hanging 25 cm strand and a ball of 3 cm radius that stands 2 cm in its way. The"
        " modified"
        f" energy lets hair turn sharply at the clamp and the contact; the two lie {gap:.1f} mm apart.\n\n"
        + table(header, rows)
        + save(figure, figures / "deflection.png", "A hanging strand pushed aside by a ball")
    )


def stretch(_: Path) -> str:
    rows = []
    for k in (0.1, 0.3, 1.0, 3.0, 10.0):
        material = HairMaterial(k_stretch=k)
        worst = [stretch_percent(length, N, material)[0] for length in LENGTHS]
        rows.append([f"{k:g}", f"{k * 0.25 / (N - 1):.2g}", *(f"{w:.3f}" for w in worst)])
    header = ["k_stretch [N/m]", "k l at 25 cm [N]", *(f"{100 * length:.0f} cm" for length in LENGTHS)]
    return (
        "## Stretch under its own weight (Eq. 7)\n\nLargest stretch [%] of an edge of hanging straight hair. Eq. 7"
        " counts"
        " metres, not shares: at N vertices an edge is stretched by about weight / (k l) = w (N - 1) / k, whatever the"
        f" length of the hair. A real hair's EA is some 20 N. The default is {MATERIAL.k_stretch:g} N/m.\n\n"
        + table(header, rows)
    )


if __name__ == "__main__":
    main()
