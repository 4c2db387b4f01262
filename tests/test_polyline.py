import torch

from quaffure.geometry import integrate_directions, integrate_directions_reference


def test_edges_keep_their_lengths_and_kernel_agrees_with_its_twin() -> None:
    generator = torch.Generator().manual_seed(0)
    root, vectors = torch.randn(2, 5, 3, generator=generator), torch.randn(2, 5, 7, 3, generator=generator)
    length = torch.rand(5, 7, generator=generator) + 0.1
    upstream = torch.randn(2, 5, 8, 3, generator=generator)
    answers = []
    for integrate in (integrate_directions, integrate_directions_reference):
        free = vectors.clone().requires_grad_()
        positions = integrate(root, free, length)
        (gradient,) = torch.autograd.grad((positions * upstream).sum(), free)
        answers.append((positions.detach(), gradient))
    torch.testing.assert_close(answers[0], answers[1])
    torch.testing.assert_close(answers[0][0].diff(dim=2).norm(dim=-1), length.expand(2, -1, -1))
    torch.testing.assert_close(answers[0][0][:, :, 0], root)
