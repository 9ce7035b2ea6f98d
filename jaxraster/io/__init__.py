"""Files: the only place that touches them."""

from .environment import prepare_environment as prepare_environment
from .environment import read_environment as read_environment
from .exr import read_exr_light as read_exr_light
from .exr import write_exr as write_exr
from .gltf import read_gltf as read_gltf
from .image import check_writable as check_writable
from .image import read_image as read_image
from .image import srgb_to_linear as srgb_to_linear
from .image import write_image as write_image
from .light import read_light as read_light
from .load import load as load
from .load import save as save
from .mesh import read_mesh as read_mesh
from .radiance import read_hdr as read_hdr
from .radiance import write_hdr as write_hdr
from .reading import Limits as Limits
from .reading import Reading as Reading
