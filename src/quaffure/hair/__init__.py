"""Hair at rest: grooms, strands, the scalp texture, posing, registration and interpolation between guides."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.hair.character_space import AnimatedSkin, CharacterSpace
    from quaffure.hair.clearance import distances_and_normals, inside_share, pushed_out
    from quaffure.hair.drape_sequence import DrapeSequence
    from quaffure.hair.export_clip import ExportClip, ExportSettings
    from quaffure.hair.file_frame import FileFrame
    from quaffure.hair.groom import Groom
    from quaffure.hair.guide_interpolation import GuideInterpolation, groom_of_drape, interpolation_of
    from quaffure.hair.posing import posed_strands, root_positions, root_rotations, triangle_frames
    from quaffure.hair.registration import HeadMesh, register_groom
    from quaffure.hair.registration_report import RegistrationReport
    from quaffure.hair.resample import concatenate_strands, polyline_lengths, resample_by_arc_length
    from quaffure.hair.scalp_roots import ScalpRoots, spread_roots
    from quaffure.hair.scalp_texture import select_guides
    from quaffure.hair.source_strands import OriginalStrands, PlacedStrands, original_strands, place_strands
    from quaffure.hair.strand_attributes import StrandAttributes
    from quaffure.hair.strands import Strands
    from quaffure.hair.tie_detection import FoundTie, find_ties

__all__, __getattr__, __dir__ = lazy_exports(__name__)
