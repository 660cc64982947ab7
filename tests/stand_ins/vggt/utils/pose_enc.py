"""From nine numbers to camera-from-world matrices and K with the principal point at W / 2, H / 2."""

import torch
from scipy.spatial.transform import Rotation


def pose_encoding_to_extri_intri(
    pose_encoding, image_size_hw=None, pose_encoding_type="absT_quaR_FoV", build_intrinsics=True
):
    """Extrinsics (B, S, 3, 4) and intrinsics (B, S, 3, 3)."""
    assert pose_encoding.dim() == 3, pose_encoding.shape
    H, W = image_size_hw
    B, S = pose_encoding.shape[:2]
    R = Rotation.from_quat(pose_encoding[..., 3:7].reshape(-1, 4).numpy()).as_matrix()
    R = torch.from_numpy(R).float().reshape(B, S, 3, 3)
    K = torch.zeros(B, S, 3, 3)
    K[..., 0, 0] = W / 2 / torch.tan(pose_encoding[..., 8] / 2)
    K[..., 1, 1] = H / 2 / torch.tan(pose_encoding[..., 7] / 2)
    K[..., 0, 2], K[..., 1, 2], K[..., 2, 2] = W / 2, H / 2, 1
    return torch.cat([R, pose_encoding[..., :3, None]], dim=-1), K
