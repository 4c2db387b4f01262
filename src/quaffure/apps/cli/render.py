"""`quaffure render`: pictures, video and USD of a drape file."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import torch
import tyro

from quaffure.apps.cli.console import console
from quaffure.apps.cli.inputs import character_space_of
from quaffure.apps.cli.outputs import (
    check_frames,
    check_outputs,
    is_export,
    known_groom,
    write_output,
    writing_text,
    written_text,
)
from quaffure.apps.cli.shown_strands import (
    GUIDES,
    ORIGINAL,
    clip_of_pictures,
    shown_in,
    source_of_drape,
    strands_between,
)
from quaffure.body.body_model import BodyModel, load_body
from quaffure.errors import InputError
from quaffure.hair.export_clip import ExportClip, ExportSettings
from quaffure.hair.groom import Groom
from quaffure.hair.groom_binding import groom_binding
from quaffure.hair.guide_interpolation import groom_of_drape
from quaffure.hair.placed_clip import placed_clip
from quaffure.io.drape_file import read_drape


@dataclass(frozen=True)
class RenderCommand:
    """Draw a drape that `quaffure drape` wrote as .npz."""

    drape: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRAPE")]
    """A drape file (.npz)."""
    out: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Where to write; may be given several times. The suffix picks the format: .png (up to four frames, evenly spaced
    from the first to the last, each from four sides), .mp4 (every frame), .usd, .usda, .usdc, .glb, .hair, .ply, .data
    and .bin (of one frame), .abc (with its groom asset beside it: walk_groom.abc beside walk.abc)."""
    body: Path | None = None
    """A body of your own (.npz, from `quaffure body import`) that the drape is of."""
    motion: str = ""
    """The character's file that the drape is of, and its animation (FILE.glb#NAME): its skin then moves the roots."""
    strands: str | None = None
    """A number of strands to interpolate between the draped ones, 10,000 to 100,000 are a full head of hair; the
    word `original`, every strand of the groom file that was draped (--groom); or `guides`, the draped ones. Without it,
    files have the draped strands; pictures show 12,000 and videos 6,000 between them, unless as many are draped."""
    groom: Path | None = None
    """With --strands original: the groom file that was draped."""
    head: Path | None = None
    """The head mesh that the groom file was draped with."""
    export: ExportSettings = field(default_factory=ExportSettings)

    def run(self) -> None:
        inputs = self.drape, self.groom, self.head, self.body, self.motion
        check_outputs(self.out, inputs)
        for path in self.out:
            if path.suffix.lower() == ".npz":
                raise InputError(path, "a picture, a video or a file for another program", "a drape file")
        body, groom, interpolation, binding = load_body(self.body), None, None, None
        if self.motion and body.origin is None:
            expected = "the body of the character whose file it is, by --body"
            raise InputError("--motion", expected, f"{self.motion} on the shipped body")
        sequence = read_drape(self.drape)
        check_frames(self.out, range(0, len(sequence), self.export.every), self.export, inputs)
        if self.strands not in (None, GUIDES):
            groom, source = groom_of_drape(sequence, body, self.drape), str(self.drape)
            if self.strands == ORIGINAL:
                groom, source = source_of_drape(groom, self.groom, body, self.head), str(self.groom)
            interpolation = strands_between(self.strands, source, groom, body, self.head)
        if is_export(self.out) or body.origin is not None:
            groom = known_groom(sequence, body) if groom is None else groom
            if groom is not None:
                binding = groom_binding(groom, body, torch.from_numpy(sequence.body_shape))
        clip = ExportClip(sequence, interpolation, binding, self.export)
        space = character_space_of(self.motion, body, sequence.times, self.export)
        if space is not None:
            clip = placed_clip(clip, space)
        for path, shown in shown_in(self.out, clip, lambda in_video: self._pictured(clip, groom, body, in_video)):
            console.print(writing_text(path, len(sequence)))
            write_output(path, shown)
        console.print(f"written: {written_text(self.out, clip.frames, self.export)}")

    def _pictured(self, clip: ExportClip, groom: Groom | None, body: BodyModel, in_video: bool) -> ExportClip:
        """What pictures or videos show; a line is printed where it is the draped strands because of another body."""
        try:
            groom = groom or groom_of_drape(clip.sequence, body, self.drape)
        except InputError as error:
            if self.strands is None:
                console.print(f"drawing the draped strands alone, on the surface in the file: {error}")
        return clip_of_pictures(clip, self.strands, groom, body, in_video)
