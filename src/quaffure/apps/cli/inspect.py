"""`quaffure inspect`: what a file holds, before anything is done with it."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from quaffure.apps.cli.console import console, print_json
from quaffure.apps.cli.file_summary import joint_map_of, summary_of
from quaffure.apps.cli.motion_summary import REFUSED
from quaffure.body.body_model import load_body
from quaffure.hair.file_frame import FileFrame
from quaffure.io.atomic import replacing
from quaffure.io.output_path import check_output


@dataclass(frozen=True)
class InspectCommand:
    """Say what a file of a groom, motion, character, body, drape, head or weights holds, or a bundled groom or motion;
    what is guessed about it, and what would be refused."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """Strands, a groom, a motion, a character (.glb, .gltf, .fbx), a body, a drape, a head mesh (.obj, .ply), or
    weights (.safetensors); or the name of a bundled groom or motion."""
    joints: Path | None = None
    """A joint map (.toml) for a .bvh file or a character, instead of the map by names."""
    save_joints: Path | None = None
    """Write the joint map of a .bvh file or a character by its names to this file (.toml), to edit and to give by
    option --joints."""
    up: str = ""
    """Axis of a strand file that points up, as in +y or z; guessed without it."""
    forward: str = ""
    """Axis of a strand file that the face is turned to; guessed without it."""
    units: str = ""
    """Unit of a strand file: m, cm, mm, inch, or the metres in one unit as a number; guessed without it."""
    mirror: bool = False
    """The strand file is left-handed, as those of Unreal and DirectX."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        console.quiet = self.json
        frame = FileFrame(self.up, self.forward, self.units, self.mirror)
        if self.save_joints is not None:
            check_output(self.save_joints, ".toml", inputs=(self.file, self.joints))
            text = joint_map_of(self.file)
            with replacing(self.save_joints) as temporary:
                temporary.write_text(text, encoding="utf-8")
        summary = {"file": str(self.file), **summary_of(self.file, load_body(), self.joints, frame)}
        if self.json:
            print_json(summary)
            return
        for key, value in summary.items():
            console.print(f"{_title(key)}: {_text(value)}")
        if REFUSED not in summary:
            console.print(f"can be used as {_use(summary)}")
        if self.save_joints is not None:
            console.print(f"written: {self.save_joints}")


def _title(key: str) -> str:
    name, _, unit = key.rpartition("_")
    return f"{name.replace('_', ' ')} [{unit}]" if unit in ("m", "mm", "units", "percent") else key.replace("_", " ")


def _text(value: Any) -> str:
    if isinstance(value, dict) and value and all(isinstance(item, float) for item in value.values()):
        return ", ".join(f"{key} {item:g}" for key, item in value.items())
    if isinstance(value, dict):
        return "".join(f"\n  {key}: {_text(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return " to ".join(f"({_text(corner)})" for corner in value)
    if isinstance(value, list):
        return ", ".join(map(_text, value)) or "none"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    return f"{value:g}" if isinstance(value, float) else value if isinstance(value, str) else json.dumps(value)


def _use(summary: dict[str, Any]) -> str:
    clip = " and --motion of quaffure drape (FILE#NAME)" if summary.get("animations") else ""
    return {
        "strands": "GROOM of quaffure drape, and by quaffure groom import",
        "groom": "GROOM of quaffure drape",
        "motion": "--motion of quaffure drape",
        "character": f"CHARACTER of quaffure body import{clip}",
        "body": "--body of quaffure drape, render, view, rig and groom import",
        "drape": "DRAPE of quaffure render and --reference of quaffure drape",
        "head": "--head of quaffure groom import",
        "weights": "--weights of quaffure drape",
    }[summary["kind"]]
