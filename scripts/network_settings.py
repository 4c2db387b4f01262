"""What settings of the steps around a network do, without training: mean logarithm of the energy on validation bodies.

    python scripts/network_settings.py as-is initial_shape.passes=3 initial_shape.bend_relaxation=0,projection.most=0.02

Each argument is a variant of the network's configuration (`quaffure.model.network_config`), `as-is` the network as it
is. A training descends the same number (`quaffure.training.validation`); 0.01 of it is about 0.02 m g L a vertex.
"""

import argparse
from copy import copy
from dataclasses import replace

import quaffure as qf
from quaffure.body import load_body
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.hair_energy import HairEnergy
from quaffure.model import NetworkConfig, NeuralDraper
from quaffure.scene import BodyBatch, Scene
from quaffure.training import prior_validation
from quaffure.training.validation import energy_above_offset

GROOMS = (
    "long_straight", "bob", "slicked_back", "layered_shag", "short_waves", "curly_bob", "afro", "short_coils",
    "side_part_lob",
)  # fmt: skip
POSES = range(0, 16, 4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights")
    parser.add_argument("--groom", action="append", help="may be given several times")
    parser.add_argument(
        "--pose", action="append", type=int, help="a validation body, 0 to 15; may be given several times"
    )
    parser.add_argument("variants", nargs="+")
    options = parser.parse_args()
    body, validation, model = load_body(), prior_validation(), qf.load_model(options.weights)
    poses = options.pose or list(POSES)
    bodies = BodyBatch(body, validation.body_pose[poses], validation.body_shape[poses])
    drapers = [with_settings(model.draper, variant) for variant in options.variants]
    means = [0.0] * len(drapers)
    grooms = options.groom or GROOMS
    for name in grooms:
        groom = qf.load_groom(name, body)
        material, scene = model.draper.material, Scene(groom, bodies)
        energy = HairEnergy(groom, material, terms_of_design(groom, body, material))
        found = [
            float(energy_above_offset(energy.total(draper.drape(scene), scene), energy).log().mean())
            for draper in drapers
        ]
        print(f"{name:15}", *(f"{value:8.4f}" for value in found), flush=True)
        means = [mean + value / len(grooms) for mean, value in zip(means, found)]
    print(f"{'mean':15}", *(f"{mean:8.4f}" for mean in means))


def with_settings(draper: NeuralDraper, variant: str) -> NeuralDraper:
    """The same network with `part.name=value` or `name=value`, several of them apart by commas."""
    network = copy(draper.network)
    config: NetworkConfig = network.config
    for setting in () if variant == "as-is" else variant.split(","):
        path, value = setting.split("=")
        *part, name = path.split(".")
        whole = getattr(config, part[0]) if part else config
        changed = replace(whole, **{name: type(getattr(whole, name))(float(value))})
        config = replace(config, **{part[0]: changed}) if part else changed
    network.config = config
    return NeuralDraper(network, draper.material, draper.bf16)


if __name__ == "__main__":
    main()
