"""Reflectance: pure formulas on unit vectors and cosines.

| symbol | meaning |
|---|---|
| n, v, l, h | unit normal, direction to the viewer, to the light, and halfway between these two |
| n_dot_v … | their cosines |
| alpha | microfacet width, the square of glTF's perceptual roughness |
| f0 | reflectance at normal incidence, linear RGB |
| D, V, F | distribution of normals, visibility G/(4 (n·l)(n·v)), Fresnel reflectance |
"""
