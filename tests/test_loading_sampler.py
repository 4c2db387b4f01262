import math

import torch

from quaffure.body import BodyModel, load_pose_prior
from quaffure.energies import STANDARD_LOADING, Loading
from quaffure.training import DecoderRecipe, GroomedBody, PoseSampler
from quaffure.training.loading_sampler import ACCELERATION_RANGE, MOST_TILT, STIFFNESS_RANGE, draw_loading
from tests.training_runs import TINY, tiny_groom, validation


def test_loadings_cover_their_ranges() -> None:
    generator = torch.Generator().manual_seed(0)
    drawn = [draw_loading(generator) for _ in range(2000)]
    others = [loading for loading in drawn if loading is not STANDARD_LOADING]
    assert 0.45 < len(others) / len(drawn) < 0.55
    stiffness = [float(loading.stiffness) for loading in others]
    size = [math.hypot(*loading.in_gravities) for loading in others]
    tilt = [math.acos(-loading.in_gravities[2] / pull) for loading, pull in zip(others, size)]
    for values, least, most in (
        (stiffness, 1 / STIFFNESS_RANGE, STIFFNESS_RANGE),
        (size, 1 / ACCELERATION_RANGE, ACCELERATION_RANGE),
        (tilt, 0.0, MOST_TILT),
    ):
        assert least - 1e-6 <= min(values) < least + 0.05 * most
        assert 0.95 * most < max(values) <= most + 1e-6
    # Uniform in the tilt, so that small ones are as frequent as large ones: down, not up.
    assert 0.4 < sum(angle < MOST_TILT / 2 for angle in tilt) / len(tilt) < 0.6


def test_the_energy_of_a_step_is_that_of_the_loading(body: BodyModel) -> None:
    groom = tiny_groom(body)
    recipe = DecoderRecipe(TINY, (GroomedBody(body, (groom,)),), PoseSampler(load_pose_prior()), validation())
    loaded = recipe._loaded(0, Loading(2.0, (1.0, 2.0, -3.0)))
    assert loaded.acceleration == (1.0, 2.0, -3.0)
    rod = next(term for term in loaded.terms if term.name == "elastic")
    assert rod.stiffness == 2.0  # type: ignore[attr-defined]
    assert recipe._loaded(0, STANDARD_LOADING) is recipe.energies[0]
