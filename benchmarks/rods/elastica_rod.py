"""A heavy rod that an independent engine swings to rest: `python -m benchmarks.rods.elastica_rod` prints its vertices.

Needs PyElastica (`pip install pyelastica`), which compiles for a minute. What it printed is kept here, and
tests/test_rod_validation.py compares that with `HeavyRod`.
"""

import math

import numpy as np

EDGES, LENGTH = 23, 0.1  # m
_CENTIMETRES = 100 * LENGTH
_RADIUS, _STEP, _DURATION = 0.1, 1.5e-5, 0.7  # cm, s, s

SETTLED = np.array([
    [435, 866, 1288, 1697, 2092, 2471, 2835, 3184, 3520, 3843, 4155, 4458,
     4753, 5041, 5324, 5602, 5876, 6149, 6419, 6689, 6957, 7226, 7494],
    [0, -56, -161, -307, -490, -703, -941, -1200, -1476, -1767, -2070, -2382,
     -2701, -3027, -3358, -3692, -4029, -4368, -4708, -5049, -5391, -5733, -6075],
])  # fmt: skip
"""x and z of the vertices but the root [0.01 mm], printed by this script with PyElastica 1.0.0."""


def swing_to_rest() -> np.ndarray:
    """Vertices [24, 3] of a rod of 10 cm that is clamped horizontally along x [m].

    The engine works in centimetres and milligrams: in SI units a hair's forces drown in its safeguards and it stays
    straight. Its clamp holds the whole first element, so its rod is half an element shorter. The section is thicker and
    softer than a hair's, of the same EI and weight, which allows longer steps.
    """
    import elastica

    class Simulator(
        elastica.BaseSystemCollection,  # type: ignore[name-defined]
        elastica.Constraints,  # type: ignore[name-defined]
        elastica.Forcing,  # type: ignore[name-defined]
        elastica.Damping,  # type: ignore[name-defined]
    ):
        pass

    area, moment_of_area = math.pi * _RADIUS**2, math.pi * _RADIUS**4 / 4
    stiffness = 8e3 / moment_of_area  # EI = 8e-9 N m^2 = 8e3 mg cm^3/s^2
    rod = elastica.CosseratRod.straight_rod(
        EDGES,
        np.zeros(3),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 0.0, 1.0]),
        _CENTIMETRES,
        _RADIUS,
        density=64.0 / 981.0 / area,  # 6.4e-5 N/m = 64 mg/s^2
        youngs_modulus=stiffness,
        shear_modulus=stiffness / (2 * 1.35),
    )
    simulator = Simulator()
    simulator.append(rod)
    clamp = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
    simulator.constrain(rod).using(elastica.OneEndFixedBC, **clamp)
    simulator.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -981.0]))
    simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, damping_constant=25.0, time_step=_STEP)
    simulator.finalize()
    elastica.integrate(elastica.PositionVerlet(), simulator, _DURATION, round(_DURATION / _STEP), progress_bar=False)
    return 0.01 * rod.position_collection.T


if __name__ == "__main__":
    print(np.round(1e5 * swing_to_rest()[1:, [0, 2]].T).astype(int).tolist())
