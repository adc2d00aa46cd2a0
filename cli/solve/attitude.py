"""Roll, pitch and yaw of whole tracks as rotations of SciPy, and back."""

from typing import TYPE_CHECKING

from shared.maths.earth import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def rotations(angles: FloatArray) -> "Rotation":
    """Rotations NED from body of roll, pitch and yaw [rad], shape (n, 3)."""
    from scipy.spatial.transform import Rotation  # which takes 0.1 s to import

    return Rotation.from_euler("ZYX", angles[..., ::-1])


def angles_of(rotation: "Rotation") -> FloatArray:
    """Roll, pitch and yaw [rad], shape (n, 3), or (3,) of a single rotation."""
    angles: FloatArray = rotation.as_euler("ZYX")[..., ::-1]
    return angles
