"""`quaffure export-onnx`: the network for runtimes without torch."""

from dataclasses import dataclass
from pathlib import Path

from quaffure.apps.cli.console import console
from quaffure.extras import require_extra
from quaffure.io.output_path import check_output
from quaffure.model.quaffure_model import load_model


@dataclass(frozen=True)
class ExportOnnxCommand:
    """Write the network as ONNX, compared with torch."""

    out: Path
    """Where to write (.onnx)."""
    weights: Path | None = None
    """Weights of a training run instead of the shipped ones."""

    def run(self) -> None:
        check_output(self.out, ".onnx", inputs=(self.weights,))
        require_extra("onnx", self.out)
        from quaffure.model.onnx_network import write_onnx

        difference = write_onnx(self.out, load_model(self.weights).draper.network)
        console.print(f"written: {self.out}; results are within {difference:.1e} of torch's")
