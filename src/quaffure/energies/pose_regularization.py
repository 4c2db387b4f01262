"""Smoothness over consecutive frames, Eq. 14."""

from quaffure.types import Float, Tensor


def energy_pose_regularization(deformation: Float[Tensor, "b f s n 3"], k_pose_reg: float) -> Float[Tensor, " b"]:
    """Eq. 14: k_pr times the squared distance of every frame's deformation from the mean over the frames.

    Args:
        deformation: x_deformation = x_hair - x_posed of consecutive frames [m], in the head's frame, so that turning
            the head alone costs nothing (`docs/paper_notes.md`).
        k_pose_reg: k_pr [J/m^2].
    """
    mean = deformation.mean(dim=1, keepdim=True)
    return k_pose_reg * (deformation - mean).square().sum(dim=(1, 2, 3, 4))
