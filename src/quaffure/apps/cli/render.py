"""`quaffure render`: pictures, video and USD of a drape file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.cli.console import console
from quaffure.apps.cli.outputs import check_outputs, write_output
from quaffure.body.body_model import load_body
from quaffure.errors import InputError
from quaffure.hair.guide_interpolation import groom_of_drape, interpolation_of
from quaffure.io.drape_file import read_drape


@dataclass(frozen=True)
class RenderCommand:
    """Draw a drape that `quaffure drape` wrote as .npz."""

    drape: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRAPE")]
    """A drape file (.npz)."""
    out: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Where to write; may be given several times. The suffix picks the format: .png, .mp4, .usd, .usda, .usdc."""
    strands: int | None = None
    """Strands to interpolate between the draped ones: 10,000 to 100,000 are a full head of hair. Without it, the draped
    strands are drawn."""

    def run(self) -> None:
        check_outputs(self.out, (self.drape,))
        for path in self.out:
            if path.suffix.lower() == ".npz":
                raise InputError(path, "a picture, a video or USD", "a drape file")
        sequence = read_drape(self.drape)
        interpolation = None
        if self.strands is not None:
            body = load_body()
            interpolation = interpolation_of(groom_of_drape(sequence, body), body, self.strands)
        for path in self.out:
            console.print(f"writing {path}")
            write_output(path, sequence, interpolation)
