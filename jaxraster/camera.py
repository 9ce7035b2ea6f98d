"""The camera: where it stands and how it projects, from this package's own parts or from other tools' cameras.

Gradient: exact in pose and projection, and through the adapters in all but sizes.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .math.transform import Length, Matrix, Pair, Vector, opencv_from_pytorch3d, parts_from_opencv
from .record import record


@record
class Camera:
    """A rigid pose and a projection with reversed depth.

    `world_from_view` places the camera (it looks down its -Z, +Y is up in the picture). `clip_from_view` is the
    projection for a square picture; `render` scales its first row by height/width, so that the vertical field of
    view stays and the picture's shape is the plan's alone. Clip z lies in [0, w]: w at the near plane, 0 at the far.
    """

    world_from_view: Float[Array, "*b 4 4"]
    clip_from_view: Float[Array, "*b 4 4"]

    @classmethod
    def from_opencv(
        cls,
        K: Matrix,
        R: Matrix,
        t: Vector,
        *,
        width: int,
        height: int,
        near: Length = 0.1,
        far: Length = jnp.inf,
        pixel_center: float = 0.0,
    ) -> "Camera":
        """A calibrated camera as OpenCV and COLMAP describe it: (u, v, 1) ~ K (R x + t), v down, z forward.

        `width` and `height` are those K was calibrated for; pictures have their shape, at any size. Skew and an
        off-centre principal point are kept; there is no distortion. `pixel_center` is the coordinate of the first
        pixel's centre: 0 in OpenCV, 0.5 in COLMAP. Batches are mapped with `jax.vmap`.

        Source: OpenCV, "Camera Calibration", https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html

        Example:
            >>> K = jnp.array([[500.0, 0, 319.5], [0, 500, 239.5], [0, 0, 1]])
            >>> camera = Camera.from_opencv(K, jnp.eye(3), (1, 2, 3), width=640, height=480)
            >>> camera.world_from_view[:3, 3].tolist()
            [-1.0, -2.0, -3.0]
        """
        size = {"width": width, "height": height}
        pose, lens = parts_from_opencv(K, R, t, **size, near=near, far=far, pixel_center=pixel_center)
        return cls(world_from_view=pose, clip_from_view=lens)

    @classmethod
    def from_pytorch3d(
        cls,
        R: Matrix,
        T: Vector,
        *,
        image_size: tuple[int, int],
        focal_length: Length | Pair = 1.0,
        principal_point: Pair = (0.0, 0.0),
        in_ndc: bool = True,
        near: Length = 0.1,
        far: Length = jnp.inf,
    ) -> "Camera":
        """One of PyTorch3D's `PerspectiveCameras`: rows X_view = X R + T, with +X left, +Y up and +Z forward.

        `image_size` is (height, width). With `in_ndc`, focal length and principal point count in halves of the
        shorter side, the latter from the picture's centre to the left and up; without, in pixels, from its top left
        corner to the right and down. `FoVPerspectiveCameras` are those with focal_length = 1 / tan(fov / 2).
        Batches are mapped with `jax.vmap`.

        Source: PyTorch3D, "Cameras", https://pytorch3d.org/docs/cameras

        Example:
            >>> camera = Camera.from_pytorch3d(jnp.eye(3), (1, 2, 3), focal_length=1.7, image_size=(480, 640))
            >>> camera.world_from_view[:3, 3].tolist()
            [-1.0, -2.0, -3.0]
        """
        lens = {"focal_length": focal_length, "principal_point": principal_point, "in_ndc": in_ndc}
        K, R, t = opencv_from_pytorch3d(R, T, image_size=image_size, **lens)
        height, width = image_size
        return cls.from_opencv(K, R, t, width=width, height=height, near=near, far=far, pixel_center=0.5)
