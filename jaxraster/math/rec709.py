"""Rec.709's primaries among the CIE's X, Y and Z, which are absolute here: white is that of D65, with Y = 1.

Source: ITU-R BT.709, table 1.
"""

import numpy as np

# x and y of red, green and blue, and of white.
_X, _Y = np.array([[0.64, 0.30, 0.15, 0.3127], [0.33, 0.60, 0.06, 0.3290]])
_XYZ = np.stack([_X / _Y, np.ones(4), (1.0 - _X - _Y) / _Y])
WHITE = _XYZ[:, 3]
XYZ_FROM_LINEAR = _XYZ[:, :3] * np.linalg.solve(_XYZ[:, :3], WHITE)
LINEAR_FROM_XYZ = np.linalg.inv(XYZ_FROM_LINEAR)
