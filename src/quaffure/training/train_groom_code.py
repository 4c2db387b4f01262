"""Training of the groom autoencoder, Sec. 3.2: grooms encoded from a part of their strands, and decoded."""

import hashlib
import math
from dataclasses import asdict, dataclass

import torch

from quaffure.errors import InputError
from quaffure.io.atomic import replacing_together
from quaffure.model.groom_autoencoder import GroomAutoencoder, Widths, relative_distance
from quaffure.model.groom_code import save_autoencoder, save_encoder
from quaffure.model.groom_texture import SHAPE_CHANNELS, GroomSample
from quaffure.model.weights_file import MAX_WIDTH
from quaffure.training.groom_batches import GroomBatch, batch_of, mean_strands, mirrored, part_of, patch_of, scaled
from quaffure.training.loop import Recipe, Training
from quaffure.training.train_config import refuse_impossible
from quaffure.types import Float, Tensor

ENCODER, AUTOENCODER = "groom_code.safetensors", "groom_autoencoder.safetensors"
"""Files of a finished run."""


@dataclass(frozen=True)
class GroomCodeConfig:
    """One training run of the groom autoencoder; saved in its folder."""

    steps: int = 5500
    """Optimizer steps in all."""
    batch: int = 16
    """Grooms in a step."""
    learning_rate: float = 1.5e-3
    """The learning rate at the start; falls to a hundredth along a cosine."""
    warmup: int = 50
    """Steps over which the learning rate rises from zero."""
    library_seeds: int = 6
    """Seeds of every named style that is not held out."""
    family: int = 1500
    """Draws from the continuous family."""
    library_share: float = 0.4
    """How many grooms of a step come from the library, and from the user's grooms."""
    widths: Widths = (256, 192, 128, 96)
    """Channels of the decoder at 4, 8, 16 and 32 texels a side."""
    code_noise: float = 0.03
    """Added to the codes, so that grooms nearby in code are alike [-]."""
    code_penalty: float = 1e-3
    """Weight of the mean square of the codes, which keeps them from outgrowing that noise."""
    bf16: bool = False
    """Run the network's layers in bfloat16."""
    seed: int = 0
    save_every_seconds: float = 60.0
    """Seconds between two checkpoints that the run can be resumed from."""

    def __post_init__(self) -> None:
        counts = {"steps": self.steps, "batch": self.batch, "library_seeds": self.library_seeds}
        refuse_impossible(counts, self.learning_rate, self.seed)
        if not all(0 < width <= MAX_WIDTH for width in self.widths):
            raise InputError("--widths", f"four from 1 to {MAX_WIDTH}", f"{self.widths}")
        if self.family < 0:
            raise InputError("--family", "0 or more", f"{self.family}")
        if not 0 <= self.library_share <= 1:
            raise InputError("--library-share", "0 to 1", f"{self.library_share}")


# Least part of a groom that is encoded [share of its strands].
LEAST_ENCODED = 0.3
# Share of a groom's strands that are decoded in one step; all of them improve little and cost twice.
DECODED = 0.5
# Share of pairs of which only a patch of the scalp is used: real grooms may be a crest, or one part of a hairdo.
PATCHES = 0.15
LEAST_PATCH = 50
# Grooms are made longer or shorter by up to this factor [natural logarithm].
LENGTHENING = 0.2
EMA_DECAY = 0.99
"""Decay of the weights' exponential average, which is what is kept."""


class GroomCodeRecipe(Recipe):
    """The groom autoencoder's training for the shared loop (`quaffure.training.loop`)."""

    ema_decay = EMA_DECAY
    config: GroomCodeConfig
    network: GroomAutoencoder
    generator: torch.Generator

    def __init__(
        self,
        config: GroomCodeConfig,
        library: list[GroomSample],
        family: list[GroomSample],
        begun: GroomAutoencoder | None = None,
    ) -> None:
        """
        Args:
            library: grooms; two of one style differ by their seed: one is encoded, the other is the target.
            family: grooms of one seed each; may be empty.
            begun: an autoencoder that is finished but for its decoder, which is trained on: codes stay what they are.

        Raises:
            InputError: `begun` is not of the configuration's widths.
        """
        torch.manual_seed(config.seed)
        self.config, self.library, self.family = config, library, family
        self.styles: dict[str, list[GroomSample]] = {}
        for groom in library:
            self.styles.setdefault(groom.style, []).append(groom)
        self.network = GroomAutoencoder(config.widths)
        self.network.decoder.mean.data = mean_strands(library + family)
        self.keeps_encoder = begun is not None
        if begun is not None:
            if begun.widths != config.widths:
                raise InputError("--widths", f"{begun.widths}, as the decoder to be trained on", f"{config.widths}")
            self.network.load_state_dict(begun.state_dict())
            self.network.encoder.requires_grad_(False)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.samples_per_step = config.batch
        self.generator = torch.Generator().manual_seed(config.seed)

    def backward(self, step: int) -> dict[str, float]:
        """The loss [strand lengths]."""
        config = self.config
        batch = self._draw()
        with torch.autocast("cpu", torch.bfloat16, enabled=config.bf16):
            code = self.network.encoder(batch.textures)
            noise = torch.randn(code.shape, generator=self.generator)
            decoded = self.network.decoder(code + config.code_noise * noise, batch.samples, batch.texels)
        loss = _loss(decoded, batch)
        (loss + config.code_penalty * code.float().square().mean()).backward()
        return {"loss": loss.item()}

    def _draw(self) -> GroomBatch:
        """Pairs of grooms of one style, mirrored and lengthened alike; the first of a pair loses strands."""
        inputs, targets = [], []
        for pair in (self._pair() for _ in range(self.config.batch)):
            flip, stretch, share = torch.rand(3, generator=self.generator).tolist()
            factor = math.exp(LENGTHENING * (2 * stretch - 1))
            # A fixed encoder gains nothing from missing strands, and its decoder's targets would be blurred.
            least = 1.0 if self.keeps_encoder else LEAST_ENCODED
            parts = zip(pair, (least + (1 - least) * share, DECODED))
            first, second = (scaled(part_of(groom, kept, self.generator), factor) for groom, kept in parts)
            inputs.append(mirrored(first) if flip < 0.5 else first)
            targets.append(mirrored(second) if flip < 0.5 else second)
        return batch_of(inputs, targets)

    def _pair(self) -> tuple[GroomSample, GroomSample]:
        of_library = float(torch.rand((), generator=self.generator)) < self.config.library_share
        if of_library or not self.family:
            of_style = list(self.styles.values())[self._index(len(self.styles))]
            first, second = (of_style[self._index(len(of_style))] for _ in range(2))
        else:
            first = second = self.family[self._index(len(self.family))]
        if float(torch.rand((), generator=self.generator)) < PATCHES:
            centre, half = torch.rand(2, 2, generator=self.generator)
            patches = [
                patch_of(groom, centre - 0.1 - 0.4 * half, centre + 0.1 + 0.4 * half) for groom in (first, second)
            ]
            if min(len(patch.texels) for patch in patches) >= LEAST_PATCH:
                return patches[0], patches[1]
        return first, second

    def _index(self, count: int) -> int:
        return int(torch.randint(count, (), generator=self.generator))

    def description(self) -> dict[str, object]:
        return {"config": asdict(self.config)}

    def identity(self) -> dict[str, str]:
        """Grooms, network and seed."""
        held = hashlib.sha256()
        for groom in self.library + self.family:
            held.update(groom.style.encode() + groom.texels.numpy().tobytes() + groom.features[:, 3].numpy().tobytes())
        count = len(self.library) + len(self.family)
        what = "decoder alone" if self.keeps_encoder else "decoder"
        identity = f"{count} grooms {held.hexdigest()[:8]}, {what} {self.config.widths}, seed {self.config.seed}"
        return {"identity": identity}


def finish(training: Training[GroomCodeRecipe]) -> GroomAutoencoder:
    """The averaged network, its codes standardised over the grooms; written to the run's folder."""
    recipe, folder = training.recipe, training.folder.path
    network: GroomAutoencoder = training.optimizer.averaged.eval()
    if not recipe.keeps_encoder:
        with torch.no_grad():
            codes = [network.encoder(batch_of([groom], [groom]).textures) for groom in recipe.library + recipe.family]
        network.standardise(torch.cat(codes))
    styles = ", ".join(recipe.styles)
    notes = {"step": str(training.step), "grooms": f"{styles}; {len(recipe.family)} of the family"}
    with replacing_together(folder / AUTOENCODER, folder / ENCODER) as (autoencoder, encoder):
        save_autoencoder(autoencoder, network, notes)
        save_encoder(encoder, network, notes)
    return network


def _loss(decoded: Float[Tensor, "s decoded"], batch: GroomBatch) -> Tensor:
    """Mean distance in strand lengths: half of it with equal weights, half weighted by length.

    Equal weights are fair to a groom of short hair, but in a groom of long and clipped hair it favours the clipped.
    """
    lengths = batch.features[:, SHAPE_CHANNELS].exp()
    counts = batch.samples.bincount().clamp(min=1)
    means = torch.zeros(len(counts)).index_add(0, batch.samples, lengths) / counts
    weights = 0.5 + 0.5 * lengths / means[batch.samples]
    return (weights * relative_distance(decoded, batch.features).mean(1)).mean()
