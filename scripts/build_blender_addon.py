"""Build the Blender add-on: `build_blender_addon.py [quaffure_hair.zip]`, to install from Blender's preferences."""

import sys
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

SOURCE = Path(__file__).parents[1] / "blender" / "quaffure_hair"


def build(path: Path) -> None:
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for file in sorted(SOURCE.iterdir()):
            if file.suffix in (".py", ".toml"):
                archive.write(file, file.name)


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "quaffure_hair.zip")
    build(target)
    print(f"written: {target}")
