"""A clip and a picture: a bundled groom on a bundled motion.

    python examples/clip_and_picture.py

Writes out/nod.npz, which `quaffure render` and `quaffure view` read, out/nod.glb, which Blender opens, and a picture.
In a notebook the last line of a cell, `qf.draw(hair)`, shows it.
"""

from pathlib import Path

import quaffure as qf


def main(out: Path = Path("out"), frames: str = "0:60:2", guides: int = 2500) -> qf.DrapeSequence:
    """The drape, frame by frame."""
    out.mkdir(exist_ok=True)
    groom = qf.load_groom("bob").thinned(guides)
    motion = qf.load_motion("nod").frames(frames)
    hair = qf.drape_clip(groom, motion)
    qf.save_drape(hair, out / "nod.npz")
    qf.save_drape(hair, out / "nod.glb")
    qf.draw(hair, frame=-1, view="3/4").save(out / "nod.png")
    print(f"{len(hair)} frames of {len(groom)} strands; the last one is in {out / 'nod.png'}")
    return hair


if __name__ == "__main__":
    main()
