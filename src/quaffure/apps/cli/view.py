"""`quaffure view`: the live page in a browser."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from quaffure.apps.cli.console import console
from quaffure.apps.cli.inputs import motion_of
from quaffure.apps.cli.outputs import write_output
from quaffure.body.body_model import load_body
from quaffure.body.clips import CLIP_NAMES
from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.hair.drape_sequence import DrapeSequence
from quaffure.hair.export_clip import ExportClip
from quaffure.hair.guide_interpolation import GuideInterpolation
from quaffure.io.load_groom import load_groom
from quaffure.io.output_path import check_writable
from quaffure.model.quaffure_model import load_model
from quaffure.procedural.hair_style import STYLES

if TYPE_CHECKING:
    from quaffure.apps.viewer.page import Page


@dataclass(frozen=True)
class ViewCommand:
    """Show drapes live in a browser, with controls for groom, clip, pose, body shape and draper."""

    groom: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="GROOM")] = "long_straight"
    """A bundled groom (see `quaffure grooms`) or a file: .abc, .bin, .data, .hair, .npy, .npz, .ply, .tfx, .usd."""
    motion: str = "nod"
    """A bundled clip, `rest` for the rest pose, or a file: .bvh, .glb, .gltf, .fbx (FILE#NAME), .npz."""
    joints: Path | None = None
    """A joint map (.toml) for a motion whose joint names are not known; `quaffure inspect` writes one to edit."""
    in_place: bool = False
    """Leave out the path of the body through the world; it turns, but does not travel."""
    weights: Path | None = None
    """Weights of a training run instead of the shipped ones."""
    body: Path | None = None
    """A body of your own (.npz, from `quaffure body import`) instead of the shipped one."""
    port: int = 8080
    """The port of the page; 0 for any free one."""
    host: str = "127.0.0.1"
    """The address to listen at. 0.0.0.0 opens the page to the network: all who open it can change it and save files."""
    folder: Path = Path(".")
    """Folder that the page's save button writes to."""

    def run(self) -> None:
        page = self.open()
        console.print(f"quaffure: open {page.url} in a browser; Ctrl+C ends it")
        try:
            page.wait()
        finally:
            page.stop()

    def open(self) -> "Page":
        """The page, served.

        Raises:
            InputError: packages of the page are missing; a groom, a motion, weights, a folder or an address that cannot
                be used.
        """
        require_extra("view", "quaffure view")
        from quaffure.apps.viewer.catalogue import REST, Catalogue
        from quaffure.apps.viewer.page import Page
        from quaffure.apps.viewer.settings import Settings

        if not self.folder.is_dir():
            raise InputError("--folder", "an existing folder", f"{self.folder}")
        check_writable(self.folder, self.folder)
        model = load_model(self.weights).on(load_body(self.body))
        motion = (
            None
            if self.motion in (*CLIP_NAMES, REST)
            else motion_of(self.motion, model.body, self.in_place, self.joints)
        )
        console.print(f"reading the groom {self.groom}")
        groom = None if self.groom in STYLES else load_groom(self.groom, model.body)
        catalogue = Catalogue(model, groom, motion)
        start = Settings(
            self.groom if groom is None else catalogue.groom_names[0],
            self.motion if motion is None else catalogue.motion_names[0],
        )
        return Page(catalogue, start, (self.host, self.port), self.folder, _write_picture)


def _write_picture(path: Path, sequence: DrapeSequence, interpolation: GuideInterpolation | None) -> None:
    write_output(path, ExportClip(sequence, interpolation), shows_progress=False)
