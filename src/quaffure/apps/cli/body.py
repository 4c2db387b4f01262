"""`quaffure body`: a body of a character of another program."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from quaffure.apps.cli.console import console
from quaffure.apps.cli.outputs import check_packages
from quaffure.body.body_model import BodyModel, load_body
from quaffure.body.joint_map import joint_map_text
from quaffure.digest import file_digest
from quaffure.errors import InputError
from quaffure.extras import require_extra
from quaffure.io.body_file import write_body
from quaffure.io.output_path import check_output
from quaffure.io.read_character import read_character
from quaffure.io.read_motion import read_joint_map
from quaffure.io.read_strands import read_strands


@dataclass(frozen=True)
class ImportBody:
    """Make a body of a skinned character: joints, one closed surface to collide with, and a scalp."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CHARACTER")]
    """A character: .glb, .gltf or binary .fbx."""
    out: Path
    """Where to write (.npz), for --body of other commands."""
    joints: Path | None = None
    """A joint map (.toml) where names are not known; `quaffure inspect CHARACTER --save-joints` writes one to edit."""
    scalp: str = ""
    """Mesh or material that is the scalp, or attribute of vertices that is above 0.5 there (glTF: _NAME). Names may
    have * for any letters. Without --scalp, --hair-mesh and --groom it is what meshes called hair or wig cover, or the
    shipped body's, fitted to the head."""
    hair_mesh: str = ""
    """Mesh or material of hair: the scalp is what it covers."""
    groom: Path | None = None
    """Strands (.abc, .usd, ...) that were made on the character: the scalp is where their roots are."""
    collide: tyro.conf.UseAppendAction[tuple[str, ...]] = field(default=())
    """Mesh or material, clothes for instance, that hair collides with besides the skin; may be given several times."""
    picture: Path | None = None
    """A picture (.png) of the surface, the joints and the scalp."""

    def run(self) -> None:
        require_extra("character", "quaffure body import")
        from quaffure.character.import_body import ImportSettings, import_body

        inputs = (self.file, self.joints, self.groom)
        check_output(self.out, ".npz", inputs=inputs)
        if self.picture is not None:
            check_output(self.picture, ".png", inputs=(*inputs, self.out))
            check_packages(self.picture)
        options = ("--scalp", self.scalp), ("--hair-mesh", self.hair_mesh), ("--groom", self.groom)
        given = [option for option, value in options if value]
        if len(given) > 1:
            raise InputError(given[1], f"one source of the scalp, {given[0]} or it", "both")
        console.print(f"reading {self.file}")
        character = read_character(self.file)
        digest = file_digest(self.file)
        settings = ImportSettings(
            None if self.joints is None else read_joint_map(self.joints),
            self.scalp,
            self.hair_mesh,
            None if self.groom is None else (read_strands(self.groom).roots, str(self.groom)),
            self.collide,
        )
        imported = import_body(character, digest, load_body(), settings, console.print)
        write_body(self.out, imported.body)
        console.print(joint_map_text(imported.joint_map))
        for note in imported.notes:
            console.print(note)
        if self.picture is not None:
            _draw(self.picture, imported.body, imported.notes)
        console.print(f"written: {', '.join(str(path) for path in (self.out, self.picture) if path is not None)}")


@dataclass(frozen=True)
class ShowBody:
    """Draw a body file: its surface, joints and scalp."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="BODY")]
    """A body (.npz)."""
    picture: Path
    """Where to draw it (.png)."""

    def run(self) -> None:
        check_output(self.picture, ".png", inputs=(self.file,))
        check_packages(self.picture)
        body = load_body(self.file)
        _draw(self.picture, body, () if body.origin is None else (f"from {body.origin.source}",))
        console.print(f"written: {self.picture}")


@dataclass(frozen=True)
class BodyCommand:
    """Make a body file of a character, or draw one."""

    action: Annotated[ImportBody, tyro.conf.subcommand("import")] | Annotated[ShowBody, tyro.conf.subcommand("show")]

    def run(self) -> None:
        self.action.run()


def _draw(path: Path, body: BodyModel, notes: tuple[str, ...]) -> None:
    from quaffure.apps.render.body_picture import write_body_picture

    write_body_picture(path, body, notes)
