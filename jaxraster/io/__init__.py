"""Files: the only place that touches them."""

from .gltf import read_gltf as read_gltf
from .image import check_writable as check_writable
from .image import read_image as read_image
from .image import srgb_to_linear as srgb_to_linear
from .image import write_image as write_image
from .load import load as load
from .load import save as save
from .mesh import read_mesh as read_mesh
