"""What no training ever sees, by name, in one file of the package."""

import json
from importlib.resources import files


def evaluation_motions() -> frozenset[str]:
    """Stems of the motion clips of the evaluation set."""
    return frozenset(json.loads((files("quaffure") / "assets" / "evaluation_set.json").read_text())["motions"])
