"""jaxraster: a realistic rasterizer made of pure functions in JAX."""

from . import display as display
from . import errors as errors
from . import math as math
from . import planner as planner
from . import scenes as scenes
from .buffers import Frame as Frame
from .buffers import Radiance as Radiance
from .buffers import Stats as Stats
from .buffers import Surface as Surface
from .buffers import Visibility as Visibility
from .display.dither import Dither as Dither
from .io.load import load as load
from .io.load import save as save
from .light.ambient import Ambient as Ambient
from .light.background import Background as Background
from .light.emission import Emission as Emission
from .light.shadow_map import ShadowMap as ShadowMap
from .math.transform import from_opencv as from_opencv
from .math.transform import look_at as look_at
from .math.transform import orbit as orbit
from .math.transform import orthographic as orthographic
from .math.transform import perspective as perspective
from .parameters import parameters as parameters
from .plan import Plan as Plan
from .planner.needs import Reason as Reason
from .planner.needs import plan_for as plan_for
from .render import render as render
from .scene import Camera as Camera
from .scene import Directional as Directional
from .scene import Environment as Environment
from .scene import Lights as Lights
from .scene import Materials as Materials
from .scene import Mesh as Mesh
from .scene import Point as Point
from .scene import Scene as Scene
from .scene import Spot as Spot
from .scene import Textures as Textures
from .scene import pack_textures as pack_textures
from .surface.texture import texture as texture
from .visibility.barycentric import footprint as footprint
from .visibility.barycentric import interpolate as interpolate
from .visibility.project import project as project
from .visibility.raster import rasterize as rasterize

__version__ = "0.1.0"
