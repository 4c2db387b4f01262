"""Files in and out: grooms, strands, motion and drapes."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.io.amass import read_amass
    from quaffure.io.atomic import replacing
    from quaffure.io.bvh import read_bvh
    from quaffure.io.drape_file import read_drape, write_drape
    from quaffure.io.groom_file import read_groom, write_groom
    from quaffure.io.load_groom import load_source, read_head
    from quaffure.io.usd import write_usd
    from quaffure.io.usd_process import read_usd_strands

__all__, __getattr__, __dir__ = lazy_exports(__name__)
