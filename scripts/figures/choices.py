"""Energy above a solver's against the time of training: our network, ours without some of its choices, and the paper's.

Energies are in the unit of the loss.

Trains what `runs_folder` does not hold yet, all with the same samples, and continues stopped runs; then plots.
"""

from pathlib import Path

from short_training import GROOM, train_shortly
from tiles import FIGURES, run_figure
from training_curves import plot_curves, read_curve

from quaffure.body import load_body
from quaffure.config import HairMaterial
from quaffure.energies import HairEnergy, hair_terms
from quaffure.procedural import make_groom
from quaffure.scene import BodyBatch, Scene
from quaffure.solvers import solver
from quaffure.training import loss_unit, prior_validation, validation_metrics

PLOT = FIGURES / "choices.png"
CHOICES = {
    "ours": (),
    "without views of the skin": ("--no-views",),
    "without slides": ("--no-slides",),
    "the paper's": ("--output", "displacement", "--pose-features", "0"),
}
REFERENCE = "xpbd"


def main(runs_folder: Path = Path("runs/choices")) -> list[Path]:
    folders = {name: runs_folder / name.replace(" ", "_").replace("'", "") for name in CHOICES}
    for name, options in CHOICES.items():
        train_shortly(folders[name], options)
    curves = [read_curve(name, folder) for name, folder in folders.items()]
    solved = _solved()
    print(f"{REFERENCE}: {solved['energy']:.3g}, {solved['body_intersection_percent']:.2g} % inside the body")
    for name, seconds, energy, inside in curves:
        above = energy[-1] - solved["energy"]
        print(f"{name}: {above:.3g} above {REFERENCE}, {inside[-1]:.2g} % inside after {seconds[-1]:.0f} s")
    plot_curves(PLOT, curves, [solved["energy"]] * len(curves), REFERENCE)
    return [PLOT]


def _solved() -> dict[str, float]:
    """Metrics of a solver's drape of the same groom on the bodies that the trainings are validated on."""
    body, poses, material = load_body(), prior_validation(), HairMaterial()
    scene = Scene(make_groom(GROOM, body), BodyBatch(body, poses.body_pose, poses.body_shape))
    energy = HairEnergy(scene.groom, material)
    print(f"unit of the loss: {loss_unit(energy) / energy.per_vertex_unit:.3g} m g L a vertex")
    return validation_metrics(solver(REFERENCE, material, hair_terms()), [(scene, energy)])


if __name__ == "__main__":
    run_figure(main)
