import torch

from quaffure import HairMaterial
from quaffure.body import BodyModel
from quaffure.energies import sag_free_rest
from quaffure.hair.folds import without_folds
from quaffure.procedural import make_groom


def folded_strands() -> torch.Tensor:
    """Two strands; the first runs back on itself exactly from its third vertex on, the second zigzags by 90 degrees."""
    back = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 0, 0], [0, 0, 0]])
    zigzag = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0], [2, 2, 0]])
    return 0.01 * torch.stack([back, zigzag])


def test_folds_open_by_three_degrees_and_lengths_stay() -> None:
    strands = folded_strands()
    opened = without_folds(strands)
    assert torch.equal(opened[1], strands[1])
    lengths = opened.diff(dim=1).norm(dim=-1)
    torch.testing.assert_close(lengths, strands.diff(dim=1).norm(dim=-1))
    direction = opened[0].diff(dim=0) / lengths[0][:, None]
    bend = torch.rad2deg((direction[1:] * direction[:-1]).sum(-1).clamp(-1, 1).arccos())
    torch.testing.assert_close(bend, torch.tensor([0.0, 177.0, 3.0]), atol=0.1, rtol=0)
    assert (opened - strands).norm(dim=-1).max() < 2e-3


def test_strands_without_folds_are_returned_as_they_are() -> None:
    strands = folded_strands()[1:]
    assert without_folds(strands) is strands


def test_a_rod_rests_in_what_was_folded(body: BodyModel) -> None:
    groom = make_groom("bob", body).select(torch.arange(4))
    groom.rest_strands[0, 12:] = groom.rest_strands[0, 10:12].flip(0).repeat(6, 1)
    groom.rest_strands[:] = without_folds(groom.rest_strands)
    assert sag_free_rest(groom, body, HairMaterial()).rod.rest_direction.isfinite().all()
