import pytest
import torch

from quaffure import InputError
from quaffure.training import AveragedAdam
from quaffure.training.averaged_adam import warm_cosine


def scalar() -> torch.nn.Linear:
    """A network of one number, which is zero."""
    layer = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.zeros_(layer.weight)
    return layer


def pulled(optimizer: AveragedAdam[torch.nn.Linear], gradient: float, share: float = 1.0) -> float:
    """The network's number after an update."""
    (gradient * optimizer.network(torch.ones(1))).sum().backward()
    optimizer.update(share)
    return optimizer.network.weight.item()


def test_a_gradient_that_is_not_finite_changes_no_weight() -> None:
    optimizer = AveragedAdam(scalar(), 0.1, 0.9)
    assert [pulled(optimizer, float("inf")) for _ in range(9)] == [0.0] * 9
    assert pulled(optimizer, 1.0) == pytest.approx(-0.1)
    assert optimizer.averaged.weight.item() == pytest.approx(-0.1)
    assert [pulled(optimizer, float("nan")) for _ in range(9)] == pytest.approx([-0.1] * 9)
    assert optimizer.skipped == 18
    with pytest.raises(InputError, match=r"learning-rate may help\), found nan for 10 steps in a row"):
        pulled(optimizer, float("nan"))


def test_the_average_of_the_weights() -> None:
    """Adam goes by its learning rate where the gradient is always the same: the number is 0, -1, -2, -3, ..."""
    optimizer = AveragedAdam(scalar(), 1.0, 0.3)
    first, second, third = (pulled(optimizer, 1.0) and optimizer.averaged.weight.item() for _ in range(3))
    assert optimizer.network.weight.item() == pytest.approx(-3, rel=1e-5)
    assert first == pytest.approx(-1, rel=1e-5)
    assert second == pytest.approx(-(1 * 2 + 2 * 9) / 11, rel=1e-5)  # nine elevenths of what is new
    assert third == pytest.approx((second * 3 - 3 * 9) / 12, rel=1e-5)
    pulled(optimizer, 1.0)  # nine thirteenths would be less than memory leaves for what is new
    assert optimizer.averaged.weight.item() == pytest.approx(0.3 * third - 0.7 * 4, rel=1e-5)


@pytest.mark.parametrize(
    ("step", "warmup", "share"),
    [(0, 10, 0.1), (4, 10, 0.5), (9, 10, 1), (10, 10, 1), (500, 10, 0.505), (1000, 10, 0.01), (0, 0, 1)],
)
def test_the_learning_rate_rises_and_falls(step: int, warmup: int, share: float) -> None:
    assert warm_cosine(step, warmup, 1000) == pytest.approx(share, abs=1e-3)
