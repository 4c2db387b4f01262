import torch

from quaffure.hair import Groom, select_guides


def scattered(count: int = 500, seed: int = 0) -> Groom:
    generator = torch.Generator().manual_seed(seed)
    return Groom(
        name="scattered",
        rest_strands=torch.rand(count, 24, 3, generator=generator),
        root_faces=torch.arange(count),
        root_barycentric=torch.full((count, 3), 1 / 3),
        root_uv=torch.rand(count, 2, generator=generator),
    )


def test_one_strand_a_texel_the_one_nearest_to_its_centre() -> None:
    groom, size = scattered(), 8
    guides = select_guides(groom, size)
    assert len(guides) == groom.texels(size).unique().numel() == guides.texels(size).unique().numel()
    for texel, uv in zip(guides.texels(size).tolist(), guides.root_uv):
        centre = (torch.tensor([texel % size, texel // size]) + 0.5) / size
        rivals = groom.root_uv[groom.texels(size) == texel]
        assert torch.isclose((uv - centre).norm(), (rivals - centre).norm(dim=1).min())


def test_choice_does_not_depend_on_the_order_even_in_ties() -> None:
    groom = scattered()
    # Two strands with one root in every place: only the tips differ.
    twins = groom.select(torch.arange(len(groom)).repeat(2))
    twins.rest_strands[len(groom) :, -1] += 0.01
    shuffled = twins.select(torch.randperm(len(twins), generator=torch.Generator().manual_seed(1)))
    first, second = select_guides(twins, 8), select_guides(shuffled, 8)
    assert torch.equal(first.rest_strands, second.rest_strands)
    assert torch.equal(first.root_faces, second.root_faces)
