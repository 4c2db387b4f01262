"""How well ties are found in grooms that do not say them: the table in docs/grooms.md.

python scripts/tie_table.py [STYLE ...]; every style without its ties, registered as a foreign groom.
"""

import sys

import numpy as np
import torch

from quaffure.body import load_body
from quaffure.hair import Strands, find_ties, register_groom
from quaffure.procedural import STYLES, make_groom


def main(names: list[str]) -> None:
    body = load_body()
    print("| style | tied % | found % | free strands marked % | error of the vertex, edges |")
    print("|---|---|---|---|---|")
    for name in names:
        groom = make_groom(name, body)
        strands = 100 * groom.rest_strands.numpy()
        counts = np.full(len(strands), strands.shape[1])
        again, _ = register_groom(Strands(strands.reshape(-1, 3), counts, name), body, name)
        held_to, _ = find_ties(again)
        truth = torch.full((len(groom),), -1) if groom.tie_vertex is None else groom.tie_vertex
        tied, found = truth >= 0, held_to >= 0
        error = (held_to - truth)[tied & found].abs()
        columns = [f"{100 * float(tied.float().mean()):.1f}", _share(found[tied]), _share(found[~tied]), _mean(error)]
        print(f"| {name} | {' | '.join(columns)} |", flush=True)


def _share(marked: torch.Tensor) -> str:
    return f"{100 * float(marked.float().mean()):.2f}" if len(marked) else ""


def _mean(error: torch.Tensor) -> str:
    return f"{float(error.float().mean()):.2f}" if len(error) else ""


if __name__ == "__main__":
    main(sys.argv[1:] or list(STYLES))
