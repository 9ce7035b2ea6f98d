"""Mitsuba 3: a ray through every pixel's centre, giving face id, barycentrics and distance.

Needs the package mitsuba and an LLVM (Debian: libllvm15). Its tree is built before the clock starts, which a program
that takes new positions for each picture could not do.

Rays are cast in clip space itself. With x, y, w for axes a pixel at (X, Y) is the ray from the origin along (X, Y, 1):
it meets every triangle where the picture has it, after w lengths, and reversed depth z/w falls as w grows. Where w is 1
at every corner that says nothing, and rays run along -z from before the near plane.
"""

import numpy as np

from .clip import refuse_clipping


class Mitsuba:
    """A compiled frame of one workload and size."""

    def __init__(self, clip: np.ndarray, faces: np.ndarray, size: int):
        refuse_clipping(clip)
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        import drjit

        self.name, self.drjit, self.size = f"Mitsuba {mitsuba.__version__}", drjit, size
        parallel = bool(np.all(clip[:, 3] == 1.0))
        mesh = mitsuba.Mesh("mesh", vertex_count=len(clip), face_count=len(faces))
        arrays = mitsuba.traverse(mesh)
        arrays["vertex_positions"] = mitsuba.Float(clip[:, [0, 1, 2 if parallel else 3]].ravel().astype(np.float32))
        arrays["faces"] = mitsuba.UInt32(faces.ravel().astype(np.uint32))
        arrays.update()
        self.scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})
        centres = ((2.0 * np.arange(size) + 1.0) / size - 1.0).astype(np.float32)
        x, y = (mitsuba.Float(axis.ravel()) for axis in np.meshgrid(centres, -centres))
        if parallel:
            self.rays = mitsuba.Ray3f(mitsuba.Point3f(x, y, 2.0), mitsuba.Vector3f(0.0, 0.0, -1.0))
        else:
            self.rays = mitsuba.Ray3f(mitsuba.Point3f(0.0), mitsuba.Vector3f(x, y, 1.0))
        drjit.eval(self.rays)

    def draw(self) -> None:
        self.hit = self.scene.ray_intersect_preliminary(self.rays, coherent=True)
        self.drjit.eval(self.hit)
        self.drjit.sync_thread()

    def faces(self) -> np.ndarray:
        """Face id of every pixel, -1 for none, row 0 on top."""
        ids = np.where(np.array(self.hit.is_valid()), np.array(self.hit.prim_index).astype(np.int32), -1)
        return ids.reshape(self.size, self.size)

    def release(self) -> None:
        del self.scene, self.rays, self.hit
