"""How far the programs' ends lie from each other: the second table of docs/peers.md, from what compare.py left.

python benchmarks/peers/distances.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

ENDS = {
    "neural": "ours_neural",
    "lbfgs": "ours_lbfgs",
    "lbfgs, cosserat": "ours_lbfgs_cosserat",
    "dismech": "dismech_100",
    "mujoco": "mujoco_100",
}


def main(folder: str = "runs/peers") -> None:
    ends = {}
    for name, stem in ENDS.items():
        with np.load(Path(folder) / f"{stem}.npz", allow_pickle=False) as file:
            ends[name] = file["positions"][-1]
    print(f"| | {' | '.join(ends)} |")
    print("|---" * (len(ends) + 1) + "|")
    for name, end in ends.items():
        apart = [1000 * float(np.linalg.norm(end - other, axis=-1).mean()) for other in ends.values()]
        print(f"| {name} | {' | '.join(f'{value:.2g}' if value else '' for value in apart)} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
