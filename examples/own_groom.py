"""A groom of your own: strands from any program, as an array in a file, registered to the head and draped.

    python examples/own_groom.py

The array [strands, points, 3] is made here by a few lines of numpy: short hair that stands off a sphere, in centimetres
with y up. Alembic, USD, .hair, .ply and others are read the same way; `quaffure inspect FILE` says what a file holds.
"""

from pathlib import Path

import numpy as np

import quaffure as qf


def strands_on_a_sphere(count: int = 2000, points: int = 16) -> np.ndarray:
    """Strands of 8 cm on the upper half of a sphere of 10 cm [cm, y up]."""
    golden = np.pi * (3 - np.sqrt(5))
    height = np.linspace(0.15, 0.98, count)
    angle = golden * np.arange(count)
    ring = np.sqrt(1 - height**2)
    outwards = np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)
    along = np.linspace(0, 8, points)[None, :, None]
    return 10 * outwards[:, None] + along * outwards[:, None] - [0, 1, 0] * (along**2 / 20)


def main(out: Path = Path("out"), count: int = 2000) -> qf.Groom:
    """The groom as registered."""
    out.mkdir(exist_ok=True)
    path = out / "my_strands.npy"
    np.save(path, strands_on_a_sphere(count).astype(np.float32))
    groom = qf.load_groom(path)
    hair = qf.drape_clip(groom, qf.load_motion("bow").frames("0:60:10"))
    qf.save_drape(hair, out / "my_strands.npz")
    print(f"{len(groom)} strands of {100 * groom.strand_lengths.mean():.1f} cm, draped in {out / 'my_strands.npz'}")
    return groom


if __name__ == "__main__":
    main()
