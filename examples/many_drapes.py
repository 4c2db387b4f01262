"""Many characters in one process: a groom each, a pose each, one pass of the network after another.

    python examples/many_drapes.py

What is prepared for a groom takes about a kilobyte a strand, as long as the groom is kept. `len(groom)` guides decide
the time; strands between them are interpolated where they are drawn.
"""

import time
from collections.abc import Iterator

import torch

import quaffure as qf
from quaffure.procedural import make_groom, sample_style

GUIDES = 600


def grooms(count: int, guides: int) -> Iterator[qf.Groom]:
    """Random hairstyles, made one by one."""
    body = qf.load_body()
    for seed in range(count):
        begin, style = time.perf_counter(), sample_style(torch.Generator().manual_seed(seed))
        groom = make_groom(style, body).thinned(guides)
        print(f"hairstyle {seed + 1} of {count}: {len(groom)} guides, made in {time.perf_counter() - begin:.1f} s")
        yield groom


def main(count: int = 6, guides: int = GUIDES) -> dict[str, float]:
    """Characters draped and milliseconds for each."""
    model, generator = qf.load_model(), torch.Generator().manual_seed(0)
    hairstyles = list(grooms(count, guides))
    walk = qf.load_motion("walk").body_pose
    poses = walk[torch.randint(len(walk), (count,), generator=generator)]
    shapes = torch.randn(count, 10, generator=generator).clamp(-2, 2)
    list(model.drape_many(hairstyles, poses, shapes))  # prepares the grooms
    begin = time.perf_counter()
    drapes = list(model.drape_many(hairstyles, poses, shapes))
    milliseconds = 1000 * (time.perf_counter() - begin) / count
    print(f"{len(drapes)} characters, {milliseconds:.1f} ms each")
    return {"characters": len(drapes), "milliseconds": milliseconds}


if __name__ == "__main__":
    main()
