"""The body: shape and pose to a surface, motion, retargeting and the pose prior."""

from typing import TYPE_CHECKING

from quaffure._kernel_cache import drop_own_kernels_of_other_types
from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.body.body_model import BodyModel, PosedBody, load_body
    from quaffure.body.bvh_clip import BvhClip
    from quaffure.body.character import AnimationChannel, Character, CharacterNodes, SkinnedMesh
    from quaffure.body.character_animation import frame_times, poses_at
    from quaffure.body.clips import CLIP_FPS, CLIP_NAMES, bundled_clip
    from quaffure.body.head_frame import HeadFrameBody, head_frame_body, head_frame_body_reference
    from quaffure.body.head_frame_kernels import FEATURE_COUNT
    from quaffure.body.joint_map import joint_map_text
    from quaffure.body.joint_names import automatic_joint_map
    from quaffure.body.mls_body import MlsBodyConfig
    from quaffure.body.motion import Motion, filter_flips, joint_matrices, resample, without_heading
    from quaffure.body.neck import head_rotation, neck_pose
    from quaffure.body.pose_prior import PRIOR_FILE, PosePrior, load_pose_prior
    from quaffure.body.retargeting import retarget_bvh
    from quaffure.body.scalp import ScalpChart

drop_own_kernels_of_other_types()

__all__, __getattr__, __dir__ = lazy_exports(__name__)
