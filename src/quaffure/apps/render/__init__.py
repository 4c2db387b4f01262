"""Pictures and video of draped hair, drawn offscreen by OpenGL."""

from typing import TYPE_CHECKING

from quaffure._lazy import lazy_exports

if TYPE_CHECKING:
    from quaffure.apps.render.camera import Camera
    from quaffure.apps.render.contact_sheet import write_contact_sheet
    from quaffure.apps.render.framing import facing_deg, frame_hair
    from quaffure.apps.render.pictures import write_picture
    from quaffure.apps.render.scene import StrandRenderer
    from quaffure.apps.render.video import encode_video, write_video

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "camera": ["Camera"],
        "contact_sheet": ["write_contact_sheet"],
        "framing": ["facing_deg", "frame_hair"],
        "pictures": ["write_picture"],
        "scene": ["StrandRenderer"],
        "video": ["encode_video", "write_video"],
    },
)
