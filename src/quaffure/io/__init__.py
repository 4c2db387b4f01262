"""Files in and out: grooms, strands, motion and drapes."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.io.amass import read_amass
    from quaffure.io.atomic import replacing
    from quaffure.io.bvh import read_bvh
    from quaffure.io.drape_file import read_drape, write_drape
    from quaffure.io.glb import write_glb
    from quaffure.io.groom_file import read_groom, read_source, write_groom
    from quaffure.io.hair_writer import write_hair
    from quaffure.io.load_groom import load_source, read_head
    from quaffure.io.output_path import check_output
    from quaffure.io.ply import write_ply
    from quaffure.io.read_motion import read_joint_map
    from quaffure.io.usd import write_usd
    from quaffure.io.usd_process import read_usd_strands

__all__, __getattr__, __dir__ = lazy_exports(__name__)
