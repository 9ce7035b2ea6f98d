"""How far a picture is from a reference: a number, and a map of where.

All take `image` and `reference`, `[h w c]` of one size, and return a `Score`. `relative_mse` and `hdr_flip` are for
linear light; `psnr`, `ssim` and `flip` are for display-encoded pictures in [0, 1]. A batch is mapped by `jax.vmap`.

Pixels that are not finite in either picture are counted in `Score.undefined` and are in no mean. Filters that reach
over one see it as equal in both pictures, so that it spoils no neighbour.
"""

from .flip import flip as flip
from .hdr_flip import exposures as exposures
from .hdr_flip import hdr_flip as hdr_flip
from .heat import heat as heat
from .psnr import psnr as psnr
from .relative_mse import relative_mse as relative_mse
from .score import Score as Score
from .ssim import ssim as ssim
