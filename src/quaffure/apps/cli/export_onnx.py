"""`quaffure export-onnx`: the network for runtimes without torch."""

from dataclasses import dataclass
from pathlib import Path

from quaffure.apps.cli.console import console
from quaffure.extras import require_extra
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_output
from quaffure.model.drape_constants import write_drape_constants
from quaffure.model.quaffure_model import load_model


@dataclass(frozen=True)
class ExportOnnxCommand:
    """Write the network as ONNX, compared with torch."""

    out: Path
    """Where to write (.onnx); a refinement of the network is a file of its own beside it (.refinement_1.onnx)."""
    weights: Path | None = None
    """Weights of a training run instead of the shipped ones."""
    groom: str = ""
    """A bundled style or a groom file, for which constants of a drape are written beside --out, as .npz: what a drape
    without torch needs (examples/drape_without_torch.py)."""

    def run(self) -> None:
        constants, inputs = self.out.with_suffix(".npz"), (self.weights, self.groom or None)
        check_output(self.out, ".onnx", inputs=inputs)
        if self.groom:
            check_output(constants, ".npz", inputs=inputs)
        require_extra("onnx", self.out)
        from quaffure.model.onnx_network import write_onnx

        model = load_model(self.weights)
        groom = load_groom(self.groom, model.body) if self.groom else None
        written, difference = write_onnx(self.out, model.draper.network)
        console.print(f"written: {', '.join(map(str, written))}; results are within {difference:.1e} of torch's")
        if groom is not None:
            write_drape_constants(constants, model.draper, groom, model.body)
            console.print(f"written: {constants}, the constants of a drape of {self.groom}")
