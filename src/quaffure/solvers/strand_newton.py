"""Newton's method on single strands with contact: the draper for the rod, frame by frame.

Hair first falls without contact, is pushed out of the body and rests on it; only then do strands interact: while large
motion is still to come, hair against hair locks groups of strands.
"""

import time
from dataclasses import dataclass, field

import torch

from quaffure.body.body_model import BodyModel
from quaffure.config import HairMaterial
from quaffure.draper import Draper, LoadDependentDraper, StoppingReport
from quaffure.energies.by_name import ROD
from quaffure.energies.cohesion import Cohesion
from quaffure.energies.design_terms import terms_of_design
from quaffure.energies.energy_term import Terms
from quaffure.energies.hair_energy import HairEnergy
from quaffure.energies.loading import STANDARD_LOADING, Loading
from quaffure.errors import InputError
from quaffure.geometry.polyline import directors
from quaffure.hair.groom_cache import GroomCopy
from quaffure.scene import HairScene, Scene
from quaffure.solvers.step_control import StepControl
from quaffure.solvers.stopping import stopping_report
from quaffure.solvers.strand_descent import StrandDescent
from quaffure.solvers.supported_terms import refuse_other_terms
from quaffure.types import Positions

SETTLING_PASSES = 3
"""From the drape of another draper, where no number is given."""
FAR_FROM_REST = 3.0
"""Hair whose strands' largest displacements in the first pass are so many times `rest_distance` in the mean does not
rest: upright, they are less than that distance, and where hair must fall, centimetres."""


@dataclass(frozen=True)
class StrandNewtonSetting:
    """Numbers of passes, and what they may do.

    Attributes:
        passes: in all but those that tell whether hair rests; after the free ones and those with contact, all terms.
        free_passes: without contact.
        resolved_share: of their margins that vertices are pushed out to after the free passes.
        contact_passes: without other hair.
        rounds: in which the passes with all terms are done from there; hair is pushed out of the body between them.
        tied_factor: how many times as many passes with all terms, and rounds, tied hair takes.
        rest_distance: mean displacement of vertices from the posed groom, after `rest_passes`, up to which hair rests
            there [m].
        rest_passes: from the posed groom, the first without other hair, the others with all terms.
        control: of the steps.
    """

    passes: int = 20
    free_passes: int = 2
    resolved_share: float = 0.9
    contact_passes: int = 2
    rounds: int = 3
    tied_factor: int = 2
    rest_distance: float = 1e-3
    rest_passes: int = 6
    control: StepControl = field(default_factory=StepControl)

    def __post_init__(self) -> None:
        """Raises:
        ValueError: fewer passes in all than without contact and without other hair, no round or a factor below 1.
        """
        if min(self.rounds, self.tied_factor, self.rest_passes) < 1:
            found = f"{self.rounds}, {self.tied_factor} and {self.rest_passes}"
            raise ValueError(f"rounds, tied_factor, rest_passes: expected at least 1, found {found}")
        least = self.free_passes + self.contact_passes
        if self.passes < least:
            raise ValueError(f"passes: expected at least {least}, free and contact passes, found {self.passes}")


NEAR_REST = StrandNewtonSetting(control=StepControl(yield_distance=2.5e-3))
"""For hair that another draper has left near its rest: there strands go back and forth less in the first passes."""


class StrandNewtonDraper:
    """Minimizes the energy of the rod with Eqs. 9, 10 and 11 over directions; lengths are kept exactly.

    Attributes:
        setting: numbers of passes.
        loading: of the sag-free rod, where the draper has no terms; may be changed from one drape to the next.
    """

    name = "strand_newton"

    def __init__(
        self,
        material: HairMaterial | None = None,
        setting: StrandNewtonSetting | None = None,
        terms: Terms | None = None,
    ) -> None:
        """
        Args:
            terms: of the energy; where none are given, those of the sag-free rest shape of every groom (`design_of`).

        Raises:
            InputError: terms other than the rod, Eqs. 7, 9, 10 and 11, and the cohesion of tails.
        """
        refuse_other_terms(self.name, terms, ROD, optional=(Cohesion,))
        self.material = material or HairMaterial()
        self.setting = setting or StrandNewtonSetting()
        self.loading = STANDARD_LOADING
        self.terms = terms
        self._energy: tuple[GroomCopy, tuple[BodyModel | None, Loading], HairEnergy] | None = None

    def with_loading(self, loading: Loading) -> "StrandNewtonDraper":
        """The same solver under another loading.

        Raises:
            InputError: what no hair has (`Loading.check`), or the draper has terms of its own, which say what loads
                hair.
        """
        loading.check()
        if self.terms is not None:
            raise InputError(f"solver {self.name}", "no energy terms, to drape under another loading", "terms")
        other = StrandNewtonDraper(self.material, self.setting)
        other.loading = loading
        return other

    def drape(self, scene: HairScene) -> Positions:
        """Draped vertices of every sample [m, world]."""
        return self.solve(scene)[0]

    def energy_of(self, scene: HairScene) -> HairEnergy:
        """The energy that is minimized; the last one is kept while groom, its arrays, body and loading stay the same.

        Raises:
            InputError: the draper has no terms, and the scene no body on which hair was designed.
        """
        body = None if self.terms is not None else self._body_of(scene)
        of, kept = (body, self.loading), self._energy
        if kept is None or not kept[0].is_of(scene.groom) or kept[1] != of:
            terms = self.terms
            if body is not None:
                terms = terms_of_design(scene.groom, body, self.material, self.loading)
            kept = GroomCopy(scene.groom), of, HairEnergy(scene.groom, self.material, terms)
            self._energy = kept
        return kept[2]

    def _body_of(self, scene: HairScene) -> BodyModel:
        if not isinstance(scene, Scene):
            raise InputError(f"solver {self.name}", "energy terms for a scene without a body model", "none")
        return scene.bodies.body

    def solve(self, scene: HairScene) -> tuple[Positions, StoppingReport]:
        """Draped vertices [m] and where the solver stopped. Every sample is solved by itself."""
        begin = time.perf_counter()
        energy = self.energy_of(scene)
        descents = [self.descend(energy, scene.sample(index)) for index in range(len(scene.posed))]
        positions = torch.cat([descent.positions for descent in descents])
        seconds = time.perf_counter() - begin
        passes = max(descent.passes for descent in descents)
        return positions, stopping_report(energy, scene, positions, passes, seconds)

    def drape_from(self, scene: HairScene, start: Positions) -> Positions:
        """All passes of the setting, with all terms, from any drape [m]."""
        return self.settle(scene, start, self.setting.passes)

    def settle(self, scene: HairScene, start: Positions, passes: int) -> Positions:
        """More passes with all terms from any drape [m]; lengths become those at rest."""
        energy = self.energy_of(scene)
        settled = []
        for index, shape in enumerate(start):
            descent = StrandDescent(energy, scene.sample(index), self.setting.control, directors(shape))
            descent.settle(passes)
            settled.append(descent.positions)
        return torch.cat(settled)

    def descend(self, energy: HairEnergy, scene: HairScene) -> StrandDescent:
        """The strands of one sample at rest: where they were posed, or from the start that is lower.

        Hair that rests where it was posed stays there, as upright in its design: a lower minimum elsewhere is another
        hairstyle. Of other hair each strand starts where it falls to from the posed groom without contact, or where
        contact alone moves it from there, whichever has less energy. Falling, hair finds its side of a head that bows,
        but passes through heads that do not: there it is pushed out as loops on the crown and locks over the face, and
        a tail divides. If the posed groom, even without hair against hair, has less energy than the result, it is
        settled as well, and the lower is returned.
        """
        setting = self.setting
        posed = StrandDescent(energy, scene, setting.control)
        own_energy_posed = posed.own_energy
        if self._rests(posed, scene):
            return posed
        fallen, pushed = (StrandDescent(energy, scene, setting.control) for _ in range(2))
        fallen.run_free(setting.free_passes)
        fallen.resolve_contact(setting.resolved_share)
        fallen.run_with_contact(setting.contact_passes)
        pushed.resolve_contact(setting.resolved_share)
        pushed.run_with_contact(setting.contact_passes)
        pushed.take_lower(fallen)
        # Tails are so dense that after as many passes as other hair takes, no energy says where they end.
        factor = setting.tied_factor if pushed.has_goals else 1
        passes = factor * (setting.passes - setting.free_passes - setting.contact_passes)
        self._settle_in_rounds(pushed, passes, factor * setting.rounds)
        if own_energy_posed < pushed.lowest_energy:
            posed = StrandDescent(energy, scene, setting.control)
            posed.settle(passes)
            return min(posed, pushed, key=lambda descent: descent.lowest_energy)
        return pushed

    def _rests(self, posed: StrandDescent, scene: HairScene) -> bool:
        """Whether hair stays within `rest_distance` of the posed groom; if so, it is settled. One pass is enough to say
        no where strands move far."""
        setting = self.setting
        posed.run_with_contact(1)
        if posed.moved.mean() > FAR_FROM_REST * setting.rest_distance:
            return False
        posed.run(setting.rest_passes - 1)
        moved = (posed.positions - scene.posed)[:, :, 1:].norm(dim=-1).mean()
        if moved > setting.rest_distance:
            return False
        posed.settle(max(setting.passes - setting.rest_passes, 0))
        return True

    def gather_strays(self, descent: StrandDescent, rounds: int, passes: int) -> None:
        """Let strands that stand apart rejoin the others, up to so many times, and settle all of them after each."""
        for _ in range(rounds):
            if not descent.rejoin_strays():
                break
            descent.resolve_contact(self.setting.resolved_share)
            descent.settle(passes)

    def _settle_in_rounds(self, descent: StrandDescent, passes: int, rounds: int) -> None:
        # Hair that other hair has pressed into the body, as on the crown in a bow, would stay there: contact is weaker.
        for index in range(rounds - 1):
            descent.run((passes + index) // rounds)
            descent.rejoin_strays()
            descent.resolve_contact(self.setting.resolved_share)
        descent.settle((passes + rounds - 1) // rounds)


class SettledDraper:
    """Another draper, and passes of Newton's method from where it ends.

    Attributes:
        start: the other draper.
        newton: whose energy is minimized; with the setting `NEAR_REST` few passes end lowest.
        passes: with all terms.
    """

    def __init__(self, start: Draper, newton: StrandNewtonDraper, passes: int) -> None:
        self.start, self.newton, self.passes = start, newton, passes

    @property
    def name(self) -> str:
        return f"{self.start.name}_settled"

    @property
    def material(self) -> HairMaterial:
        return self.newton.material

    def with_loading(self, loading: Loading) -> "SettledDraper":
        """The same drapers under another loading.

        Raises:
            InputError: the first of them knows one loading.
        """
        if not isinstance(self.start, LoadDependentDraper):
            raise InputError("stiffness, gravity and wind", "a draper that reads them", self.start.name)
        return SettledDraper(self.start.with_loading(loading), self.newton.with_loading(loading), self.passes)

    def drape(self, scene: Scene) -> Positions:
        """Draped vertices of every sample [m, world]."""
        return self.newton.settle(scene, self.start.drape(scene), self.passes)


def with_settling(start: Draper, passes: int = SETTLING_PASSES, terms: Terms | None = None) -> SettledDraper:
    """Another draper, and passes for hair near its rest; `terms` as of `StrandNewtonDraper`.

    Raises:
        InputError: terms that `StrandNewtonDraper` does not minimize.
    """
    return SettledDraper(start, StrandNewtonDraper(start.material, NEAR_REST, terms), passes)
